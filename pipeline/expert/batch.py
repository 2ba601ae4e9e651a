"""Independent scenarios stacked along the craft axis."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Shaped

from pipeline.arrays import Array
from pipeline.expert.decoupled import DecoupledOptima, control_units, decoupled_optima, goal_miss
from pipeline.orbit.approaches import Swarms, pairs, side_by_side
from pipeline.orbit.arrays import Formation
from pipeline.orbit.problem import Problem
from pipeline.orbit.separation import swarm_node_collisions
from pipeline.scenario import Scenario, shared_problem


@dataclass(frozen=True, eq=False)
class Batch:
    """Scenarios of one problem, and the craft of all of them one after the other."""

    scenarios: Sequence[Scenario]  # at least one

    @cached_property
    def problem(self) -> Problem:
        """The problem that they share; refused where they do not."""
        return shared_problem(self.scenarios)

    @cached_property
    def swarms(self) -> Swarms:
        """Which craft belong together."""
        return side_by_side(tuple(scenario.n for scenario in self.scenarios))

    @cached_property
    def initial(self) -> Formation:
        """Initial states, m and m/s."""
        return np.concatenate([scenario.initial for scenario in self.scenarios])

    @cached_property
    def goal(self) -> Formation:
        """Goal states, m and m/s."""
        return np.concatenate([scenario.goal for scenario in self.scenarios])

    @cached_property
    def optima(self) -> DecoupledOptima:
        """Decoupled optimum of every craft."""
        return decoupled_optima(self.initial, self.goal, self.problem)

    @cached_property
    def miss(self) -> Formation:
        """Change of final state that controls must bring about, m and m/s."""
        return goal_miss(self.initial, self.goal, self.problem)

    @cached_property
    def unit(self) -> Float[Array, "swarms"]:
        """Size of a typical control of each scenario, m/s²."""
        return np.maximum.reduceat(control_units(self.miss, self.problem), self.swarms.starts)

    @cached_property
    def craft(self) -> list[slice]:
        """Where the craft of each scenario are."""
        starts = self.swarms.starts.tolist()
        return [slice(*both) for both in zip(starts, [*starts[1:], None], strict=True)]

    def part(self, which: Sequence[int]) -> "Batch":
        """Some of the scenarios; their decoupled optima are not computed again."""
        part = Batch([self.scenarios[k] for k in which])
        # A cached property is set as any attribute of an instance is.
        part.__dict__["optima"] = self.optima[np.isin(self.swarms.label, which)]
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
        limited = self.problem.max_acceleration is not None
        given = "within max_acceleration" if limited else "with any thrust, however large"
        reasons = []
        for scenario, craft, collisions in zip(self.scenarios, impossible, close, strict=True):
            reason = _too_close(scenario) if collisions else ""
            if craft.any():
                k = int(craft.argmax())
                reason = f"craft {k} cannot reach its goal {given}, which is proven"
            reasons.append(reason)
        return reasons


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
