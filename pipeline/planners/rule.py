"""The refiner's rule as a planner: rounds of giving way by prices alone, with nothing learned."""

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.networks.refiner.ablations import NULL_SPACE, RULE
from pipeline.networks.refiner.null_space import LEAST_CHANGE
from pipeline.networks.refiner.other_rounds import by_rule
from pipeline.networks.refiner.program import LEAST_FUEL
from pipeline.orbit.transfer import meet_goal
from pipeline.plan import Plan
from pipeline.planners.certified import certified
from pipeline.scenario import Scenario


@dataclass(frozen=True)
class Rule:
    """What the refiner does untrained: the cheapest safe iterate of some rounds, or else the last.

    Attributes:
        rounds: how many.
        null_space: whether steps lie in the null space, instead of each craft's program.
    """

    rounds: int
    null_space: bool = False

    @property
    def name(self) -> str:
        """What tables call it."""
        return NULL_SPACE if self.null_space else RULE

    def plan(self, scenarios: Sequence[Scenario]) -> list[Plan]:
        """One plan for each scenario, in order; the scenarios share one problem and one n."""
        if not scenarios:
            return []
        problem, started = scenarios[0].problem, time.perf_counter()
        initial = np.stack([scenario.initial for scenario in scenarios])
        goal = np.stack([scenario.goal for scenario in scenarios])
        program = LEAST_CHANGE if self.null_space else LEAST_FUEL
        answer = by_rule(initial, goal, problem, self.rounds, program)
        controls = meet_goal(initial, answer, goal, problem)
        seconds = time.perf_counter() - started
        flat = controls.reshape(-1, *controls.shape[2:])
        return certified(self.name, scenarios, flat, seconds, at_nodes=False)
