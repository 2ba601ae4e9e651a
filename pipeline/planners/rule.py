"""The refiner's rounds as a planner without learning: message passing by dual variables alone."""

from collections.abc import Sequence
from dataclasses import dataclass

from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.expert.batch import Batch
from pipeline.networks.refiner.ablations import NULL_SPACE, RULE
from pipeline.networks.refiner.null_space import LEAST_CHANGE
from pipeline.networks.refiner.other_rounds import by_rule
from pipeline.networks.refiner.program import LEAST_FUEL
from pipeline.orbit.transfer import meet_goal
from pipeline.plan import AT_ALL_TIMES, Plan, Requirements
from pipeline.planners.planner import certified, stacked_ends
from pipeline.scenario import Scenario


@dataclass(frozen=True)
class Rule:
    """The untrained refiner: the cheapest safe iterate of some rounds, or else the last."""

    rounds: int  # how many
    null_space: bool = False  # whether steps lie in the null space, instead of each craft's program
    requirements: Requirements = AT_ALL_TIMES  # what its plans are judged by

    @property
    def name(self) -> str:
        """What tables call it."""
        return NULL_SPACE if self.null_space else RULE

    def plan(self, scenarios: Sequence[Scenario]) -> list[Plan]:
        """One plan for each scenario, in order; the scenarios share one problem and one n."""
        program = LEAST_CHANGE if self.null_space else LEAST_FUEL

        def answer(batch: Batch) -> Float[Array, "n _ 3"]:
            (initial, goal), problem = stacked_ends(batch), batch.problem
            controls = by_rule(initial, goal, problem, self.rounds, program)
            exact = meet_goal(initial, controls, goal, problem)
            return exact.reshape(-1, problem.intervals, 3)

        return certified(self.name, scenarios, answer, self.requirements)
