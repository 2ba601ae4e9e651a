"""Independent scenarios stacked along the craft axis."""

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from jaxtyping import Shaped

from pipeline.arrays import Array
from pipeline.expert.decoupled import DecoupledOptima, control_units, decoupled_optima, goal_miss
from pipeline.orbit.arrays import Formation
from pipeline.orbit.participants import Participants
from pipeline.orbit.separation import swarm_node_collisions
from pipeline.scenario import Scenario, participants, shared_problem

NAMES = {"initial": "start", "goal": "goal"}  # of ends, in words


class Batch:
    """Scenarios of one problem, at least one, and the craft of all of them one after the other."""

    def __init__(self, scenarios: Sequence[Scenario]) -> None:
        self.scenarios, self.problem = scenarios, shared_problem(scenarios)
        self.swarms = participants(scenarios)
        self.initial: Formation = np.concatenate([scenario.initial for scenario in scenarios])
        self.goal: Formation = np.concatenate([scenario.goal for scenario in scenarios])
        # Change of final state that the controls of each craft must bring about, m and m/s.
        self.miss = goal_miss(self.initial, self.goal, self.problem)
        starts = self.swarms.starts
        # Size of a typical control of each scenario, m/s².
        self.unit = np.maximum.reduceat(control_units(self.miss, self.problem), starts)
        ends = [*starts[1:].tolist(), None]
        self.craft = [slice(*both) for both in zip(starts.tolist(), ends, strict=True)]

    @cached_property
    def optima(self) -> DecoupledOptima:
        """Decoupled optimum of every craft."""
        return decoupled_optima(self.initial, self.goal, self.problem)

    def bound(self, k: int) -> tuple[float, str]:
        """Lower bound on the fuel of a scenario, m/s², and how it is proven."""
        bound, proof = self.optima.bound(self.craft[k])
        left_out = ", obstacles and corridors left out" if self.scenarios[k].unlike else ""
        return bound, proof + left_out

    @property
    def unlike(self) -> bool:
        """Whether sizes of participants differ from the collision radius."""
        return isinstance(self.swarms, Participants)

    def part(self, which: Sequence[int]) -> "Batch":
        """Some of the scenarios; their decoupled optima are not computed again."""
        part = Batch([self.scenarios[k] for k in which])
        part.optima = self.optima[np.isin(self.swarms.label, which)]
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
        last = self.problem.intervals
        within = self.problem.collision_radius, self.swarms, slice(None, None, last)
        close = swarm_node_collisions(ends, *within)
        impossible = self.split(self.optima.impossible)
        limited = self.problem.max_acceleration is not None
        given = "within max_acceleration" if limited else "with any thrust, however large"
        reasons = []
        for scenario, craft, collisions in zip(self.scenarios, impossible, close, strict=True):
            reason = _too_close(scenario) if collisions else _outside(scenario)
            if craft.any():
                k = int(craft.argmax())
                reason = f"craft {k} cannot reach its goal {given}, which is proven"
            reasons.append(reason)
        return reasons


def _outside(scenario: Scenario) -> str:
    """Which craft is outside a corridor at an end, if any."""
    for end, craft, corridor, margin in scenario.outside():
        inside = f"corridors[{corridor}], {scenario.corridors[corridor].inside}"
        return f"craft {craft} is {-margin:.6g} m outside {inside} at the {NAMES[end]}"
    return ""


def _too_close(scenario: Scenario) -> str:
    """Which pair is too close at an end."""
    near, last = [], scenario.problem.intervals
    swarms = participants([scenario])
    i, j = swarms.pairs
    for end, states, node in (("start", scenario.initial, 0), ("goal", scenario.goal, last)):
        there = swarms.beside(states[:, None], slice(node, node + 1))
        gap = there[i, 0, :3] - there[j, 0, :3]
        apart = swarms.apart(gap, i, j)
        k = int(apart.argmin())
        near.append((float(apart[k]), float(np.linalg.norm(gap[k])), k, end))
    _, distance, pair, end = min(near)
    who = scenario.named(int(i[pair]), int(j[pair]))
    return (
        f"{who} are {distance:.6g} m apart at the {end}, whatever is planned; "
        f"{scenario.wanted(int(i[pair]), int(j[pair]))}"
    )
