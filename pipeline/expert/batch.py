"""Independent scenarios stacked along the craft axis."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Shaped

from pipeline.arrays import Array
from pipeline.expert.arrivals import Arrivals
from pipeline.expert.conic import FUEL_SHARE
from pipeline.expert.decoupled import DecoupledOptima, control_units, decoupled_optima, goal_miss
from pipeline.expert.waypoints import arrivals_at_least_fuel
from pipeline.orbit.approaches import pairs, side_by_side
from pipeline.orbit.arrays import Controls, Formation, Indices, Values
from pipeline.orbit.separation import swarm_node_collisions
from pipeline.orbit.thrust import Limits
from pipeline.orbit.thrust_cost import cost
from pipeline.scenario import Scenario, shared_problem
from pipeline.scenario.spacecraft import limits_of
from pipeline.scenario.waypoint import closest_pair


class Batch:
    """Scenarios of one problem, at least one, and the craft of all of them one after the other."""

    def __init__(
        self,
        scenarios: Sequence[Scenario],
        limits: Limits | None = None,
        arrivals: Arrivals | None = None,
    ) -> None:
        self.scenarios, self.problem = scenarios, shared_problem(scenarios)
        self.swarms = side_by_side(tuple(scenario.n for scenario in scenarios))
        self.initial: Formation = np.concatenate([scenario.initial for scenario in scenarios])
        self.goal: Formation = np.concatenate([scenario.goal for scenario in scenarios])
        # Change of final state that the controls of each craft must bring about, m and m/s.
        self.miss = goal_miss(self.initial, self.goal, self.problem)
        starts = self.swarms.starts
        # Size of a typical control of each scenario, m/s².
        self.unit = np.maximum.reduceat(control_units(self.miss, self.problem), starts)
        ends = [*starts[1:].tolist(), None]
        self.craft = [slice(*both) for both in zip(starts.tolist(), ends, strict=True)]
        # What the thrusters of each craft can do; None where max_acceleration is all of it.
        self.limits = _limits(scenarios) if limits is None else limits
        # Where each craft must be, and a lower bound that holds for every choice of open times.
        self.arrivals, self.open_bound = arrivals, np.full(len(self.initial), np.inf)
        if self.limits is not None and arrivals is None:
            self.arrivals, self.open_bound = self._arrivals(self.limits)

    @cached_property
    def optima(self) -> DecoupledOptima:
        """Decoupled optimum of every craft."""
        ends = self.initial, self.goal, self.problem
        optima = decoupled_optima(*ends, self.limits, self.arrivals)
        return replace(optima, lower_bound=np.minimum(optima.lower_bound, self.open_bound))

    def _arrivals(self, limits: Limits) -> tuple[Arrivals, Float[Array, "n"]]:
        """Goals and waypoints, at the nodes where they cost least, and a bound over all others."""
        waypoints = [
            replace(one, craft=one.craft + start)
            for scenario, start in zip(self.scenarios, self.swarms.starts.tolist(), strict=True)
            for one in scenario.waypoints
        ]
        return arrivals_at_least_fuel(self.initial, self.goal, self.problem, limits, waypoints)

    @cached_property
    def weight(self) -> Float[Array, "n"] | None:
        """Weight of each craft's fuel in its scenario's largest share; None where all counts."""
        if self.problem.thrust.objective == "total":
            return None
        assert self.limits is not None
        left = self.limits.delta_v
        mean = [left[craft].mean() for craft in self.craft]
        return np.repeat(mean, self.swarms.sizes) / left

    def objective(self, controls: Controls, craft: Indices | slice) -> float:
        """What is to be least, m/s², of some craft with such controls."""
        if self.limits is None:
            return float(np.abs(controls).sum())
        return self.objective_of(cost(controls, self.problem.thrust).sum(axis=1), craft)

    def objective_of(self, used: Values, craft: Indices | slice) -> float:
        """What is to be least, m/s², of some craft that burn so much each."""
        if self.weight is None:
            return float(used.sum())
        return float((self.weight[craft] * used).max() + FUEL_SHARE * used.sum())

    def least_share(self, craft: slice) -> float:
        """Lower bound on the largest share of its Δv that one of some craft burns; 0 without."""
        if self.weight is None or self.limits is None:
            return 0.0
        least = self.optima.lower_bound[craft] * self.problem.time_step
        return float((least / self.limits.delta_v[craft]).max())

    def part(self, which: Sequence[int]) -> "Batch":
        """Some of the scenarios; their decoupled optima are not computed again."""
        craft = np.isin(self.swarms.label, which)
        limits = None if self.limits is None else self.limits[craft]
        arrivals = None if self.arrivals is None else self.arrivals[craft]
        part = Batch([self.scenarios[k] for k in which], limits, arrivals)
        part.optima = self.optima[craft]
        return part

    def split(self, rows: Shaped[Array, "n *rest"]) -> list[Shaped[Array, "_ *rest"]]:
        """Rows of all craft, by scenario."""
        return np.split(rows, self.swarms.starts[1:])

    def infeasible(self) -> list[str]:
        """Why it is proven that each scenario has no plan; nothing where that is not known.

        A craft on its own cannot make its transfer, or a pair is within the collision radius at
        one of its ends, where no control can move it.
        """
        ends = np.stack([self.initial, self.goal], axis=1)
        close = swarm_node_collisions(ends, self.problem.collision_radius, self.swarms)
        impossible = self.split(self.optima.impossible)
        given = "with any thrust, however large"
        if self.problem.max_acceleration is not None:
            given = "within max_acceleration"
        if self.limits is not None:
            given = "within its limits of thrust and delta_v, in the intervals in which it may burn"
        reasons = []
        for scenario, craft, collisions in zip(self.scenarios, impossible, close, strict=True):
            reason = _too_close(scenario) if collisions else _meeting(scenario)
            if craft.any():
                k = int(craft.argmax())
                way = " by its waypoints" if scenario.waypoints else ""
                reason = f"craft {k} cannot reach its goal{way} {given}, which is proven"
            reasons.append(reason)
        return reasons


def _limits(scenarios: Sequence[Scenario]) -> Limits | None:
    parts = [scenario.limits for scenario in scenarios]
    if all(part is None for part in parts):
        return None
    both = zip(scenarios, parts, strict=True)
    return Limits.concatenated([part or limits_of(s.craft, s.n, s.problem) for s, part in both])


def _meeting(scenario: Scenario) -> str:
    """Which pair must be too close at a waypoint, or nothing."""
    radius = scenario.problem.collision_radius
    closest = closest_pair(scenario.waypoints, scenario.problem)
    if closest is None or closest[0] > radius:
        return ""
    distance, i, j, time = closest
    return (
        f"craft {i} and {j} must be {distance:.6g} m apart at {time:g} s, by their waypoints; "
        f"collision_radius is {radius:g} m"
    )


def _too_close(scenario: Scenario) -> str:
    """Which pair is too close at an end."""
    near = []
    i, j = pairs(scenario.n)
    for end, states in (("start", scenario.initial), ("goal", scenario.goal)):
        apart = np.linalg.norm(states[i, :3] - states[j, :3], axis=1)
        near.append((float(apart.min()), int(apart.argmin()), end))
    distance, pair, end = min(near)
    return (
        f"craft {i[pair]} and {j[pair]} are {distance:.6g} m apart at the {end}, whatever is "
        f"planned; collision_radius is {scenario.problem.collision_radius:g} m"
    )
