"""Scenarios side by side, as one swarm whose parts know nothing of each other."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Shaped

from pipeline.arrays import Array
from pipeline.expert.own import control_units, goal_miss
from pipeline.orbit.approaches import Swarms, side_by_side
from pipeline.orbit.problem import Problem
from pipeline.scenario import Scenario, shared_problem


@dataclass(frozen=True, eq=False)
class Batch:
    """Scenarios of one problem, and their craft one after the other.

    Attributes:
        scenarios: at least one.
    """

    scenarios: Sequence[Scenario]

    @cached_property
    def problem(self) -> Problem:
        """The problem that they share; refused where they do not."""
        return shared_problem(self.scenarios)

    @cached_property
    def swarms(self) -> Swarms:
        """Which craft belong together."""
        return side_by_side(tuple(scenario.n for scenario in self.scenarios))

    @cached_property
    def initial(self) -> Float[Array, "n 6"]:
        """Initial states, m and m/s."""
        return np.concatenate([scenario.initial for scenario in self.scenarios])

    @cached_property
    def goal(self) -> Float[Array, "n 6"]:
        """Goal states, m and m/s."""
        return np.concatenate([scenario.goal for scenario in self.scenarios])

    @cached_property
    def miss(self) -> Float[Array, "n 6"]:
        """Change of final state that controls must bring about."""
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
        """Some of the scenarios."""
        return Batch([self.scenarios[k] for k in which])

    def split(self, rows: Shaped[Array, "n *rest"]) -> list[Shaped[Array, "_ *rest"]]:
        """What is given for all craft, by scenario."""
        return np.split(rows, self.swarms.starts[1:])
