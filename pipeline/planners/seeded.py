"""A planner made safe: its plans seed the expert, which stops at the first safe plan."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from pipeline.expert import Settings, all_within_risk, nominal_plans
from pipeline.plan import Plan, Requirements
from pipeline.planners.planner import Planner
from pipeline.scenario import Scenario


@dataclass(frozen=True)
class Seeded:
    """Another planner followed by certified convex solves.

    Attributes:
        planner: where the seeds come from.
        settings: of the expert.
    """

    planner: Planner
    settings: Settings = field(default_factory=lambda: Settings(stop="first-safe"))

    @property
    def name(self) -> str:
        """Both planners."""
        return f"{self.planner.name} + expert"

    @property
    def requirements(self) -> Requirements:
        """What its plans must satisfy: as of the planner that the seeds come from."""
        return self.planner.requirements

    def plan(self, scenarios: Sequence[Scenario]) -> list[Plan]:
        """One plan for each scenario, safe wherever the expert finds one.

        A plan is called by both planners, and by the expert alone where no craft were in conflict
        on their own optima: then the seed was not looked at.
        """
        seeds = self.planner.plan(scenarios)
        aims, asked = [seed.states for seed in seeds], self.requirements
        plans = nominal_plans(scenarios, aims, self.settings, asked)
        plans = [self._both(*pair) for pair in zip(seeds, plans, strict=True)]
        return all_within_risk(scenarios, plans, asked, self.settings)

    def _both(self, seed: Plan, plan: Plan) -> Plan:
        stages = {f"seed_{stage}": seconds for stage, seconds in seed.timing.items()}
        total = seed.timing["plan"] + plan.timing["plan"]
        who = self.name if plan.convex_solves else plan.planner
        return replace(plan, planner=who, timing={**stages, **plan.timing, "plan": total})
