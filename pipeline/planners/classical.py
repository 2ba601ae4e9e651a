"""Planners without a network: the expert, and baselines that plan each craft without the others."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.expert import Settings, decoupled_optima, solve_many
from pipeline.expert.batch import Batch
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import minimum_energy, project_to_flyable, straight_line
from pipeline.plan import AT_ALL_TIMES, Plan, Requirements
from pipeline.planners.planner import certified
from pipeline.scenario import Scenario

States = Float[Array, "n 6"]
Controls = Float[Array, "n intervals 3"]


@dataclass(frozen=True)
class Expert:
    """Sequential convex programming on all scenarios at once."""

    settings: Settings = field(default_factory=Settings)  # how to work
    name: str = "expert"  # what tables call it
    requirements: Requirements = AT_ALL_TIMES  # what its plans must satisfy

    def plan(self, scenarios: Sequence[Scenario]) -> list[Plan]:
        """One plan for each scenario."""
        plans = solve_many(scenarios, settings=self.settings, requirements=self.requirements)
        return [replace(plan, planner=self.name) for plan in plans]


@dataclass(frozen=True)
class Baseline:
    """A planner that plans each craft without the others."""

    name: str  # what tables call it
    # from initial and goal states to controls in m/s² that meet the goal
    controls: Callable[[States, States, Problem], Controls]
    requirements: Requirements = AT_ALL_TIMES  # what its plans are judged by

    def plan(self, scenarios: Sequence[Scenario]) -> list[Plan]:
        """One plan for each scenario."""

        def answer(batch: Batch) -> Controls:
            return self.controls(batch.initial, batch.goal, batch.problem)

        return certified(self.name, scenarios, answer, self.requirements)


def _line(initial: States, goal: States, problem: Problem) -> Controls:
    states = straight_line(initial, goal, problem.nodes)
    return project_to_flyable(states, initial, goal, problem)


def _decoupled(initial: States, goal: States, problem: Problem) -> Controls:
    return decoupled_optima(initial, goal, problem).controls


BASELINES = (
    Baseline("straight line", _line),
    Baseline("minimum energy", minimum_energy),
    Baseline("own LP", _decoupled),
)
"""The straight line made flyable, the closed-form minimum-energy transfer, decoupled optima: they
belong in every table."""
