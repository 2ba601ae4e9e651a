"""A network made safe by as little as it takes: its own plan, else one convex solve, else a search.

Each rung is tried on the scenarios that the one before left without a proof of safety.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from pipeline.expert import FIRST_SAFE, Settings, all_within_risk, nominal_plans
from pipeline.plan import SOLVED, Plan, Requirements
from pipeline.planners.network import Flown
from pipeline.scenario import Scenario

ONE_SOLVE = replace(FIRST_SAFE, max_rounds=1, margin=0.3, beside=0.3, again=0)
"""The expert, held to one round of convex programs with half-spaces along the network's plan."""


@dataclass(frozen=True, eq=False)
class Ladder:
    """A network, the network and one solve, the expert: the first whose plan is proven safe.

    Attributes:
        network: the network's own plans.
        settings: of the expert where it comes to that.
    """

    network: Flown
    settings: Settings = FIRST_SAFE

    @property
    def name(self) -> str:
        """The network's; its plans say which rung they are from."""
        return self.network.name

    @property
    def requirements(self) -> Requirements:
        """What its plans must satisfy: as of the network."""
        return self.network.requirements

    def plan(self, scenarios: Sequence[Scenario]) -> list[Plan]:
        """One plan for each scenario, safe wherever the expert finds one.

        A plan is called by the network, by the network and "one solve", or by the expert.
        """
        asked = self.requirements
        plans = replace(self.network, requirements=asked.nominal).plan(scenarios)

        def one_solve(left: Sequence[Scenario], seeds: Sequence[Plan]) -> list[Plan]:
            return nominal_plans(left, [seed.states for seed in seeds], ONE_SOLVE, asked)

        def search(left: Sequence[Scenario], _: Sequence[Plan]) -> list[Plan]:
            return nominal_plans(left, None, self.settings, asked)

        plans = _where_unsafe(scenarios, plans, one_solve, f"{self.name} + one solve")
        plans = _where_unsafe(scenarios, plans, search, "expert")
        return all_within_risk(scenarios, plans, asked, self.settings)


def _where_unsafe(
    scenarios: Sequence[Scenario],
    plans: Sequence[Plan],
    rung: Callable[[Sequence[Scenario], Sequence[Plan]], list[Plan]],
    name: str,
) -> list[Plan]:
    """The plans, and another rung's where they are not proven safe, with the time of both."""
    left = [k for k, plan in enumerate(plans) if plan.status != SOLVED]
    found = list(plans)
    if left:
        tried = rung([scenarios[k] for k in left], [plans[k] for k in left])
        for k, plan in zip(left, tried, strict=True):
            before = plans[k]
            timing = {**plan.timing, "plan": before.timing["plan"] + plan.timing["plan"]}
            solves = before.convex_solves + plan.convex_solves
            # Where a craft's own optimum is not to be flown, the expert looks at no seed.
            who = name if plan.convex_solves else plan.planner
            found[k] = replace(plan, planner=who, timing=timing, convex_solves=solves)
    return found
