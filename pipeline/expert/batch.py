"""Independent scenarios stacked along the craft axis."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from pipeline.arrays import Array, Float, Int
from pipeline.expert.conic import FUEL_SHARE
from pipeline.expert.decoupled import (
    INTEGERS,
    CraftInCorridors,
    DecoupledOptima,
    cheapest_constraints,
    control_units,
    decoupled_optima,
    goal_miss,
)
from pipeline.orbit.arrays import Controls, Formation, Indices, PerCraft, Values
from pipeline.orbit.corridors import Faces
from pipeline.orbit.participants import Participants
from pipeline.orbit.partition import SwarmPartition
from pipeline.orbit.problem import Problem
from pipeline.orbit.separation import swarm_node_collisions
from pipeline.orbit.thrust import Limits
from pipeline.orbit.thrust_cost import cost
from pipeline.plan.plan import Plan
from pipeline.scenario import Scenario, participants, shared_problem
from pipeline.scenario.spacecraft import limits_of
from pipeline.scenario.state_constraints import StateConstraints, state_constraints
from pipeline.scenario.waypoint import closest_pair

NAMES = {"initial": "start", "goal": "goal"}  # of ends, in words


class Batch:
    """Scenarios of one problem, at least one, and the craft of all of them one after the other."""

    def __init__(
        self,
        scenarios: Sequence[Scenario],
        limits: Limits | None = None,
        constraints: StateConstraints | None = None,
    ) -> None:
        self.scenarios, self.problem = scenarios, shared_problem(scenarios)
        self.swarms = participants(scenarios)
        self.initial: Formation = np.concatenate([scenario.initial for scenario in scenarios])
        self.goal: Formation = np.concatenate([scenario.goal for scenario in scenarios])
        # Change of final state that the controls of each craft must bring about, m and m/s.
        self.miss = goal_miss(self.initial, self.goal, self.problem)
        # Size of a typical control of each scenario, m/s², and its craft.
        units = control_units(self.miss, self.problem)
        self.unit = np.maximum.reduceat(units, self.swarms.starts)
        self.craft = self.swarms.slices
        # Limits of each craft; None where max_acceleration is the only one.
        self.limits = _limits(scenarios) if limits is None else limits
        # Required states of each craft, and a fuel bound for every choice of open waypoint times.
        self.constraints, self.open_bound = constraints, np.full(len(self.initial), np.inf)
        if self.limits is not None and constraints is None:
            waypoints = [
                replace(one, craft=one.craft + start)
                for scenario, start in zip(scenarios, self.swarms.starts.tolist(), strict=True)
                for one in scenario.waypoints
            ]
            ends = self.initial, self.goal, self.problem
            self.constraints, self.open_bound = cheapest_constraints(
                *ends, self.limits, waypoints, self.swarms.faces
            )

    @cached_property
    def optima(self) -> DecoupledOptima:
        """The decoupled optima of all craft, with bounds and proofs for those in corridors."""
        ends = self.initial, self.goal, self.problem
        optima = decoupled_optima(*ends, self.limits, self.constraints)
        if self.swarms.faces is not None:
            optima = self.inside(self.swarms.faces, optima)
        fixed = np.isinf(self.open_bound)
        return replace(optima, lower_bound=np.where(fixed, optima.lower_bound, self.open_bound))

    def inside(self, faces: Faces, optima: DecoupledOptima) -> DecoupledOptima:
        """Decoupled optima with bounds and proofs for craft inside faces of corridors.

        Not of craft with waypoints at open times, whose bound is that of all choices.
        """
        fixed = optima.feasible & np.isinf(self.open_bound)
        limits = self.limits or limits_of((), len(self.miss), self.problem)
        at = self.constraints
        if at is None:
            at = state_constraints(self.initial, self.goal, self.problem, {})
        its = faces[fixed[faces.craft]]
        craft = CraftInCorridors(self.initial, at, limits, its, self.problem)
        return optima.at_least(*craft.bounds(optima.controls))

    @cached_property
    def weight(self) -> Float[Array, "n"] | None:
        """Weight of each craft's fuel in the largest share; None where total fuel is minimized."""
        if self.problem.thrust.objective == "total":
            return None
        assert self.limits is not None
        left = self.limits.delta_v
        mean = [left[craft].mean() for craft in self.craft]
        return np.repeat(mean, self.swarms.sizes) / left

    def objective(self, controls: Controls, craft: Indices | slice) -> float:
        """The objective, m/s², of some craft with their controls."""
        if self.limits is None:
            return float(np.abs(controls).sum())
        return self.objective_of(cost(controls, self.problem.thrust).sum(axis=1), craft)

    def objective_of(self, used: Values, craft: Indices | slice) -> float:
        """The objective, m/s², of some craft with their fuels."""
        if self.weight is None:
            return float(used.sum())
        return float((self.weight[craft] * used).max() + FUEL_SHARE * used.sum())

    def least_share(self, k: int) -> float:
        """Lower bound on the largest share of its Δv that a craft of a scenario burns, or 0."""
        if self.weight is None or self.limits is None:
            return 0.0
        least, left = (one[self.craft[k]] for one in (self.optima.lower_bound, self.limits.delta_v))
        return float((least * self.problem.time_step / left).max())

    def bound(self, k: int) -> tuple[float, str]:
        """Lower bound on the fuel of a scenario, m/s², and how it is proven."""
        bound, proof = self.optima.bound(self.craft[k])
        return bound, f"{proof}, obstacles left out" if self.scenarios[k].obstacles else proof

    @property
    def unlike(self) -> bool:
        """Whether craft have sizes of their own, or there are obstacles or corridors."""
        return isinstance(self.swarms, Participants)

    def part(self, which: Sequence[int]) -> "Batch":
        """A batch of some of the scenarios, with the decoupled optima already computed."""
        craft = np.isin(self.swarms.label, which)
        limits = None if self.limits is None else self.limits[craft]
        constraints = None if self.constraints is None else self.constraints[craft]
        part = Batch([self.scenarios[k] for k in which], limits, constraints)
        part.open_bound, part.optima = self.open_bound[craft], self.optima[craft]
        return part

    def raise_bounds(self, k: int, bound: PerCraft) -> None:
        """Raise a scenario's lower bounds on fuel to those that branch and bound proved, m/s².

        Not with waypoints at open times, of which mixed-integer programs have one choice.
        """
        least, craft = np.zeros(len(self.initial)), self.craft[k]
        if np.isinf(self.open_bound[craft]).all():
            least[craft] = bound
            self.optima = self.optima.at_least(least, np.zeros(len(least), dtype=bool), INTEGERS)

    def infeasible(self) -> list[str]:
        """For each scenario, the reason why it provably has no plan, or an empty string.

        A craft on its own cannot make its transfer in its corridors, or a pair is within the
        collision radius at one of its ends, where no control can move it.
        """
        close = _end_collisions(self.initial, self.goal, self.problem, self.swarms)
        reasons = []
        for scenario, craft, collisions in zip(self.scenarios, self.craft, close, strict=True):
            reason = _state_conflict(scenario, int(collisions))
            impossible = self.optima.impossible[craft]
            alone = impossible & ~self.optima.feasible[craft]  # without corridors, too
            if alone.any() or (impossible.any() and not reason):
                k = int((alone if alone.any() else impossible).argmax())
                way = " by its waypoints" if scenario.waypoints else ""
                inside = "" if alone[k] else " inside its corridors"
                given = f"{way}{inside} {allowed_thrust(scenario)}"
                reason = f"craft {k} cannot reach its goal{given}, which is proven"
                reason += self._drift_miss(craft.start + k)
            reasons.append(reason)
        return reasons

    def _drift_miss(self, k: int) -> str:
        """A clause on how far craft k drifts from its goal, if ``no_burn`` alone is the cause."""
        limits, at = self.limits, self.constraints
        if limits is None or at is None or limits.burns[k].any(axis=1).all():
            return ""
        one, unlimited = slice(k, k + 1), np.full(1, np.inf)
        free = replace(limits[one], component=unlimited, norm=unlimited, delta_v=unlimited)
        ends = self.initial[one], self.goal[one], self.problem
        held = decoupled_optima(*ends, free, at[one]).impossible[0]
        return f"; {at.missed_by_drift(k)[1]}" if held else ""


def in_batches(
    scenarios: Sequence[Scenario], plan: Callable[[Sequence[int]], list[Plan]]
) -> list[Plan]:
    """Plans of scenarios, made in batches such that no plan depends on others in its batch.

    ``plan`` makes those of a batch, given by indices. With limits of each craft a scenario is a
    batch, since an interior-point method stops at controls that depend in their last digits on all
    craft of its program.
    """
    batches: dict[int | None, list[int]] = {}
    for k, scenario in enumerate(scenarios):
        batches.setdefault(None if scenario.limits is None else k, []).append(k)
    made: dict[int, Plan] = {}
    for some in batches.values():
        made |= zip(some, plan(some), strict=True)
    return [made[k] for k in range(len(scenarios))]


def allowed_thrust(scenario: Scenario) -> str:
    """The limits of thrust within which craft are to reach their goals, in words."""
    limits, given = scenario.limits, "with any thrust, however large"
    if scenario.problem.max_acceleration is not None:
        given = "within max_acceleration"
    if limits is not None and limits.bounded:
        given = "within its limits of thrust and delta_v"
    if limits is not None and not limits.burns.all():
        given += ", in the intervals in which it may burn"
    return given


def impossible_states(scenario: Scenario) -> str:
    """Why the required states alone leave no plan, whatever the motion, or an empty string.

    Of craft and corridors; obstacles, which drift by that motion, do not count.
    """
    alone = replace(scenario, obstacles=())
    ends = scenario.initial, scenario.goal, scenario.problem
    return _state_conflict(alone, int(_end_collisions(*ends, participants([alone])).sum()))


def impossible_for_any_goals(scenario: Scenario) -> bool:
    """Whether required states are too close, also to obstacles, whichever goals the craft take.

    Goals are held apart by the least of the radii.
    """
    problem, least = scenario.problem, scenario.radii.min()
    small = replace(scenario, craft=tuple(replace(one, radius=least) for one in scenario.craft))
    start, end = slice(0, 1), slice(problem.intervals, problem.nodes)
    for one, states, node in ((scenario, scenario.initial, start), (small, scenario.goal, end)):
        radius, swarm = problem.collision_radius, participants([one])
        if swarm_node_collisions(states[:, None], radius, swarm, node).any():
            return True
    return bool(_meeting(scenario))


def _end_collisions(
    initial: Formation, goal: Formation, problem: Problem, swarms: SwarmPartition
) -> Int[Array, "swarms"]:
    """Collisions (Eq. 5) of each swarm at the start and at the goal."""
    ends, nodes = np.stack([initial, goal], axis=1), slice(None, None, problem.intervals)
    return swarm_node_collisions(ends, problem.collision_radius, swarms, nodes)


def _state_conflict(scenario: Scenario, collisions: int) -> str:
    """Reason why no plan can meet the required states; an empty string where none is known."""
    return _too_close(scenario) if collisions else _outside(scenario) or _meeting(scenario)


def _outside(scenario: Scenario) -> str:
    """Which craft is outside a corridor at an end, if any."""
    for end, craft, corridor, margin in scenario.outside():
        inside = f"corridors[{corridor}], {scenario.corridors[corridor].inside}"
        return f"craft {craft} is {-margin:.6g} m outside {inside} at the {NAMES[end]}"
    return ""


def _limits(scenarios: Sequence[Scenario]) -> Limits | None:
    parts = [scenario.limits for scenario in scenarios]
    if all(part is None for part in parts):
        return None
    both = zip(scenarios, parts, strict=True)
    return Limits.concatenated([part or limits_of(s.craft, s.n, s.problem) for s, part in both])


def _meeting(scenario: Scenario) -> str:
    """Why the waypoints themselves bring two craft too close, or an empty string."""
    closest = closest_pair(scenario.waypoints, scenario.problem, scenario.radii)
    if closest is None:
        return ""
    distance, i, j, time = closest
    if distance > scenario.radii[[i, j]].sum():
        return ""
    return (
        f"craft {i} and {j} must be {distance:.6g} m apart at {time:g} s, by their waypoints; "
        f"{scenario.required_separation(i, j)}"
    )


def _too_close(scenario: Scenario) -> str:
    """Which pair is too close at an end."""
    near, last = [], scenario.problem.intervals
    swarms = participants([scenario])
    i, j = swarms.pairs
    for end, states, node in (("start", scenario.initial, 0), ("goal", scenario.goal, last)):
        there = swarms.all_states(states[:, None], slice(node, node + 1))[..., :3]
        apart = swarms.separations(there, there, i, j)
        k = int(apart.argmin())
        distance = float(np.linalg.norm(there[i[k], 0] - there[j[k], 0]))
        near.append((float(apart[k, 0]), distance, k, end))
    _, distance, pair, end = min(near)
    who = scenario.named(int(i[pair]), int(j[pair]))
    return (
        f"{who} are {distance:.6g} m apart at the {end}, whatever is planned; "
        f"{scenario.required_separation(int(i[pair]), int(j[pair]))}"
    )
