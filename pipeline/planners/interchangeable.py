"""Interchangeable craft: another planner, asked for the assignment of goals that costs least."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice

import numpy as np

from pipeline.plan import INFEASIBLE, SOLVED, Assignment, Certificate, Plan, gap_of
from pipeline.planners.assignment import OwnCosts, Slots, own_costs, ranked
from pipeline.planners.planner import Planner
from pipeline.scenario import Scenario

MOST = 16
"""Assignments that are planned at most, besides the given order.

On 100 crowded validation scenarios of ten craft (family dense) the best of 1, 4, 8 and 16 is 1.51,
1.19, 1.18 and 1.18 % above the bound, on 50 of thirty craft 1.02, 0.94, 0.81 and 0.77 %.
"""

DEAR = 1e-2
"""Gap from which the plan of the cheapest assignment is so dear that others are looked at."""

PROOF = "the linear assignment problem of all craft and goals, each pair's fuel by"
"""How the bound of all assignments is proven."""

IMPOSSIBLE = (
    "whichever goals they take, some craft cannot reach its own within max_acceleration, which is "
    "proven"
)

TIMES = ("plan", "certificate")
"""Stages that are timed of every assignment that is tried, s."""


@dataclass(frozen=True, eq=False)
class Considered:
    """The assignments of a scenario that are looked at.

    Attributes:
        scenario: as it was given.
        costs: of every craft and goal.
        most: how many of the best assignments.
    """

    scenario: Scenario
    costs: OwnCosts
    most: int

    @property
    def given(self) -> Slots:
        """The order in which the goals were given."""
        return tuple(range(self.scenario.n))

    @cached_property
    def first(self) -> Slots | None:
        """The assignment of least cost, or None where it is proven that none can be flown."""
        return next(ranked(self.costs.fuel), None)

    @cached_property
    def best(self) -> list[Slots]:
        """The assignments of least cost, the least first; found only where they are asked for."""
        return list(islice(ranked(self.costs.fuel), self.most))

    def others(self, plan: Plan) -> list[Slots]:
        """What may be better than the plan of the first: the next best, and the given order.

        None where that plan is safe and not dear, and none whose own optima cost more than it.
        """
        least = plan.certificate.fuel if plan.status == SOLVED else np.inf
        if self.first is None or self._gap(least, self.costs.of(self.first)) <= DEAR:
            return []
        asked = dict.fromkeys([*self.best[1:], self.given])
        return [slots for slots in asked if slots != self.first and self.costs.of(slots) < least]

    def kept(self, tried: Mapping[Slots, Plan], seconds: float) -> Plan:
        """The cheapest safe plan, or else the first, with what is known of all assignments.

        Args:
            tried: plans by assignment, the first one first.
            seconds: that it took to find the assignments.
        """
        slots = min(tried, key=lambda one: _worth(tried[one]))
        timing = {**tried[slots].timing, "assignment": seconds}
        for name in TIMES:
            timing[name] = sum(plan.timing.get(name, 0.0) for plan in tried.values())
        timing["plan"] += seconds
        solves = sum(plan.convex_solves for plan in tried.values())
        plan = replace(tried[slots], timing=timing, convex_solves=solves)
        if self.first is None:
            return replace(plan, status=INFEASIBLE, message=IMPOSSIBLE)
        certificate = self._bounded(plan.certificate, self.costs.of(self.first))
        chosen = self._assignment(slots, len(tried), plan)
        return replace(plan, certificate=certificate, assignment=chosen)

    def _bounded(self, certificate: Certificate, bound: float) -> Certificate:
        """The certificate with the bound of all assignments, m/s²."""
        return replace(
            certificate,
            fuel_lower_bound=bound,
            optimality_gap=self._gap(certificate.fuel, bound),
            fuel_lower_bound_proof=f"{PROOF}: {self.costs.proof}",
        )

    def _gap(self, fuel: float, bound: float) -> float:
        return gap_of(fuel, bound, self.scenario.problem)

    def _assignment(self, slots: Slots, tried: int, plan: Plan) -> Assignment:
        given, fuel = self.costs.of(self.given), plan.certificate.fuel
        known = np.isfinite(given) and given > self.scenario.problem.negligible_fuel
        ranks = [self.first] if slots == self.first else self.best
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


@dataclass(frozen=True, eq=False)
class Interchangeable:
    """A planner whose craft may take each other's goals.

    It plans the assignment whose own optima cost least. Where that plan is not safe, or dear
    because craft must keep apart, it plans the next best assignments too, and the given order, as
    far as their own optima cost less than that plan, and keeps the cheapest safe one.

    Attributes:
        planner: who plans.
        most: assignments that are planned at most, besides the given order.
    """

    planner: Planner
    most: int = MOST

    @property
    def name(self) -> str:
        """The planner's; its plans hold the assignment."""
        return self.planner.name

    def plan(self, scenarios: Sequence[Scenario]) -> list[Plan]:
        """One plan for each scenario, its goals in the order of ``Plan.assignment``.

        The certificate's lower bound on the fuel is that of all assignments. Where it is proven
        that every assignment asks more of some craft than its thrust limit, the plan is
        INFEASIBLE, and of the given order.
        """
        if not scenarios:
            return []
        started = time.perf_counter()
        looked = [Considered(one, own_costs(one), self.most) for one in scenarios]
        asked = [[one.given if one.first is None else one.first] for one in looked]
        found = time.perf_counter()
        firsts = self._plans(looked, asked)
        planned = time.perf_counter()
        others = [one.others(*plan.values()) for one, plan in zip(looked, firsts, strict=True)]
        seconds = (time.perf_counter() - planned + found - started) / len(scenarios)
        further = self._plans(looked, others)
        both = zip(looked, firsts, further, strict=True)
        return [one.kept({**first, **other}, seconds) for one, first, other in both]

    def _plans(
        self, looked: Sequence[Considered], asked: Sequence[Sequence[Slots]]
    ) -> list[dict[Slots, Plan]]:
        """The plans of some assignments of each scenario, all made at once."""
        orders = [(one, slots) for one, some in zip(looked, asked, strict=True) for slots in some]
        plans = iter(self.planner.plan([one.scenario.taking(slots) for one, slots in orders]))
        return [{slots: next(plans) for slots in some} for some in asked]
