"""A network made safe by as little as it takes: its own plan, else one convex solve, else a search.

Each rung is tried on the scenarios that the one before left without a proof of safety.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from pipeline.expert import FIRST_SAFE, Settings, solve_many
from pipeline.plan import SOLVED, Plan
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

    def plan(self, scenarios: Sequence[Scenario]) -> list[Plan]:
        """One plan for each scenario, safe wherever the expert finds one.

        A plan is called by the network, by the network and "one solve", or by the expert.
        """
        plans = self.network.plan(scenarios)
        at: Literal["nodes", "continuous"] = "nodes" if self.network.at_nodes else "continuous"
        orbits = self.network.passive_safety

        def one_solve(left: Sequence[Scenario], seeds: Sequence[Plan]) -> list[Plan]:
            settings = replace(ONE_SOLVE, separation=at, passive_safety=orbits)
            return solve_many(left, [seed.states for seed in seeds], settings)

        def search(left: Sequence[Scenario], _: Sequence[Plan]) -> list[Plan]:
            settings = replace(self.settings, separation=at, passive_safety=orbits)
            return solve_many(left, settings=settings)

        plans = _where_unsafe(scenarios, plans, one_solve, f"{self.name} + one solve")
        return _where_unsafe(scenarios, plans, search, "expert")


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
