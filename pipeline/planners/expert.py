"""The expert as a planner."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from pipeline.expert import Settings, solve_many
from pipeline.plan import AT_ALL_TIMES, Plan, Requirements
from pipeline.scenario import Scenario


@dataclass(frozen=True)
class Expert:
    """Sequential convex programming on all scenarios at once.

    Attributes:
        settings: how to work.
        name: what tables call it.
        requirements: what its plans must satisfy.
    """

    settings: Settings = field(default_factory=Settings)
    name: str = "expert"
    requirements: Requirements = AT_ALL_TIMES

    def plan(self, scenarios: Sequence[Scenario]) -> list[Plan]:
        """One plan for each scenario."""
        plans = solve_many(scenarios, settings=self.settings, requirements=self.requirements)
        return [replace(plan, planner=self.name) for plan in plans]
