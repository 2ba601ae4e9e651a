"""Goal assignment: a planner whose craft may take each other's goals."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice

import numpy as np
from jaxtyping import Bool, Float

from pipeline.arrays import Array
from pipeline.orbit.infeasibility import forced_goals
from pipeline.plan import INFEASIBLE, SOLVED, UNSOLVED, Assignment, Plan, Requirements, gap_of
from pipeline.planners.assignment import DecoupledCosts, Slots, decoupled_costs, ranked
from pipeline.planners.planner import Planner
from pipeline.scenario import Scenario

MOST = 16
"""Assignments that are planned at most, besides the given order.

On 100 crowded validation scenarios of ten craft (family dense) the best of 1, 4, 8 and 16 is 1.51,
1.19, 1.18 and 1.18 % above the bound, on 50 of thirty craft 1.02, 0.94, 0.81 and 0.77 %.
"""

# Gap from which the plan of the cheapest assignment is so dear that others are looked at
DEAR = 1e-2
# How the bound of all assignments is proven
PROOF = "the linear assignment problem of all craft and goals, each pair's fuel by"

IMPOSSIBLE = (
    "whichever goals they take, some craft cannot reach its own within max_acceleration, which is "
    "proven"
)

ADRIFT = (
    "whichever goals they take, a craft adrift comes within collision_radius of another after the "
    "plan, which is proven"
)

# Stages whose seconds are summed over all assignments that are tried
TIMES = ("plan", "certificate")


@dataclass(frozen=True, eq=False)
class GoalAssignment:
    """A planner whose craft may take each other's goals.

    It plans the assignment of least decoupled cost. Where that plan is not safe, or dear because
    craft must keep apart, it plans the next best assignments too, and the given order, as far as
    their decoupled costs are less than that plan's, and keeps the cheapest safe one.
    """

    planner: Planner
    most: int = MOST  # assignments that are planned at most, besides the given order

    @property
    def name(self) -> str:
        """The planner's; its plans hold the assignment."""
        return self.planner.name

    @property
    def requirements(self) -> Requirements:
        """The planner's."""
        return self.planner.requirements

    def plan(self, scenarios: Sequence[Scenario]) -> list[Plan]:
        """One plan for each scenario, its goals in the order of ``Plan.assignment``.

        The certificate's lower bound on the fuel is that of all assignments. Where it is proven
        that every assignment asks more of some craft than its thrust limit, the plan is
        INFEASIBLE, and of the given order.
        """
        if not scenarios:
            return []
        started = time.perf_counter()
        candidates = [_Candidates(one, decoupled_costs(one), self.most) for one in scenarios]
        asked = [[one.first or one.given] for one in candidates]
        found = time.perf_counter()
        tried = self._plans(scenarios, asked)
        planned = time.perf_counter()
        candidates = [
            one.narrowed(*plans.values()) for one, plans in zip(candidates, tried, strict=True)
        ]
        again = [
            [] if one.first is None or one.first in plans else [one.first]
            for one, plans in zip(candidates, tried, strict=True)
        ]
        for plans, other in zip(tried, self._plans(scenarios, again), strict=True):
            plans.update(other)
        others = [
            one.others(plans[one.first]) if one.first in plans else []
            for one, plans in zip(candidates, tried, strict=True)
        ]
        seconds = (time.perf_counter() - planned + found - started) / len(scenarios)
        for plans, further in zip(tried, self._plans(scenarios, others), strict=True):
            plans.update(further)
        return [one.best(plans, seconds) for one, plans in zip(candidates, tried, strict=True)]

    def _plans(
        self, scenarios: Sequence[Scenario], asked: Sequence[Sequence[Slots]]
    ) -> list[dict[Slots, Plan]]:
        """The plans of some assignments of each scenario, all made at once."""
        both = zip(scenarios, asked, strict=True)
        plans = iter(self.planner.plan([one.taking(slots) for one, some in both for slots in some]))
        return [{slots: next(plans) for slots in some} for some in asked]


@dataclass(frozen=True, eq=False)
class _Candidates:
    """The assignments of a scenario that are looked at."""

    scenario: Scenario  # as it was given
    costs: DecoupledCosts  # of every craft and goal
    most: int  # how many of the best assignments
    # goals that craft may take, where it is proven that others are of no use, or None
    allowed: Bool[Array, "n n"] | None = None

    @property
    def given(self) -> Slots:
        """The order in which the goals were given."""
        return tuple(range(self.scenario.n))

    @cached_property
    def cheapest(self) -> Slots | None:
        """The assignment of least cost, or None where it is proven that none can be flown."""
        return next(ranked(self.costs.fuel), None)

    @cached_property
    def first(self) -> Slots | None:
        """The one of least cost among those that are allowed."""
        return self.cheapest if self.allowed is None else next(ranked(self._costs), None)

    @cached_property
    def ranking(self) -> list[Slots]:
        """The assignments of least cost, the least first; found only where they are asked for."""
        return list(islice(ranked(self._costs), self.most))

    @property
    def _costs(self) -> Float[Array, "n n"]:
        fuel = self.costs.fuel
        return fuel if self.allowed is None else np.where(self.allowed, fuel, np.inf)

    def _gap(self, fuel: float, bound: float) -> float:
        return gap_of(fuel, bound, self.scenario.problem)

    def narrowed(self, plan: Plan) -> "_Candidates":
        """Without assignments that cannot be passively safe, where that refutes the first.

        What refutes one assignment says little of the others: craft may drift into one goal each,
        their own.
        """
        asked, problem = plan.certificate.passive_safety, self.scenario.problem
        if self.first is None or plan.status != INFEASIBLE or asked is None:
            return self
        ends = self.scenario.initial, self.scenario.goal
        return replace(self, allowed=forced_goals(*ends, problem, asked.orbits))

    def others(self, plan: Plan) -> list[Slots]:
        """Assignments that may be better than the first's plan: the next best, and the given order.

        None where that plan is safe and not dear, and none whose decoupled costs are more.
        """
        least = plan.certificate.fuel if plan.status == SOLVED else np.inf
        if self.first is None or self._gap(least, self.costs.of(self.first)) <= DEAR:
            return []
        costs, craft = self._costs, range(self.scenario.n)
        asked = dict.fromkeys([*self.ranking[1:], self.given])
        return [one for one in asked if one != self.first and costs[craft, one].sum() < least]

    def best(self, tried: Mapping[Slots, Plan], seconds: float) -> Plan:
        """The cheapest safe plan, or else the first tried, with what is known of all assignments.

        It took so many seconds to find the assignments.
        """
        slots = min(tried, key=lambda one: _worth(tried[one]))
        timing = {**tried[slots].timing, "assignment": seconds}
        for name in TIMES:
            timing[name] = sum(plan.timing.get(name, 0.0) for plan in tried.values())
        timing["plan"] += seconds
        solves = sum(plan.convex_solves for plan in tried.values())
        plan = replace(tried[slots], timing=timing, convex_solves=solves)
        if self.cheapest is None:
            return replace(plan, status=INFEASIBLE, message=IMPOSSIBLE)
        if self.first is None:
            plan = replace(plan, message=ADRIFT)
        elif plan.status == INFEASIBLE and not self._all_infeasible(tried):
            reason = f"no plan found for {len(tried)} assignments; for this one, {plan.message}"
            plan = replace(plan, status=UNSOLVED, message=reason)
        bound = self.costs.of(self.cheapest)
        certificate = replace(
            plan.certificate,
            fuel_lower_bound=bound,
            optimality_gap=self._gap(plan.certificate.fuel, bound),
            fuel_lower_bound_proof=f"{PROOF}: {self.costs.proof}",
        )
        chosen = self._assignment(slots, len(tried), plan)
        return replace(plan, certificate=certificate, assignment=chosen)

    def _all_infeasible(self, tried: Mapping[Slots, Plan]) -> bool:
        """Whether it is proven of every assignment that there is no plan for it."""
        proven = all(plan.status == INFEASIBLE for plan in tried.values())
        return len(self.ranking) < self.most and proven

    def _assignment(self, slots: Slots, tried: int, plan: Plan) -> Assignment:
        given, fuel = self.costs.of(self.given), plan.certificate.fuel
        known = np.isfinite(given) and given > self.scenario.problem.negligible_fuel
        ranks = [self.first] if slots == self.first else self.ranking
        return Assignment(
            slots=slots,
            rank=ranks.index(slots) + 1 if slots in ranks else None,
            tried=tried,
            given_fuel_lower_bound=given if np.isfinite(given) else None,
            saving=1 - fuel / given if known and plan.status == SOLVED else None,
        )


def _worth(plan: Plan) -> float:
    """Fuel of a safe plan, m/s²; of equals the first tried is kept."""
    return plan.certificate.fuel if plan.status == SOLVED else np.inf
