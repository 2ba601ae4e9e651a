"""The one thing all planners have in common: scenarios in, plans out."""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from pipeline.plan import Plan, Requirements
from pipeline.scenario import Scenario


@runtime_checkable
class Planner(Protocol):
    """Whatever turns scenarios into plans: the expert, a baseline, a network."""

    @property
    def name(self) -> str:
        """What tables and plans call it."""
        ...

    @property
    def requirements(self) -> Requirements:
        """What its plans must satisfy, and are judged by."""
        ...

    def plan(self, scenarios: Sequence[Scenario]) -> list[Plan]:
        """One plan for each scenario, in order; the scenarios share one problem and one n."""
        ...
