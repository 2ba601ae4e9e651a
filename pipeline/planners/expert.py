"""The expert as a planner."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from pipeline.expert import Settings, solve
from pipeline.plan import Plan
from pipeline.scenario import Scenario


@dataclass(frozen=True)
class Expert:
    """Sequential convex programming on each scenario.

    Attributes:
        settings: how to work.
        name: what tables call it.
    """

    settings: Settings = field(default_factory=Settings)
    name: str = "expert"

    def plan(self, scenarios: Sequence[Scenario]) -> list[Plan]:
        """One plan for each scenario."""
        return [replace(solve(s, settings=self.settings), planner=self.name) for s in scenarios]
