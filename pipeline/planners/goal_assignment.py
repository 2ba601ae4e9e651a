"""Goal assignment: a planner whose craft may take each other's goals."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice

import numpy as np

from pipeline.errors import InputError
from pipeline.orbit.passive_safety import allowed_goals
from pipeline.plan import INFEASIBLE, SOLVED, UNSOLVED, Assignment, Plan, gap_of
from pipeline.planners.assignment import DecoupledCosts, Slots, decoupled_costs, ranked
from pipeline.planners.planner import PlannerWrapper
from pipeline.scenario import Scenario

# Largest number of assignments planned besides the given order. On 100 crowded scenarios of ten
# craft (family dense) the best of 1, 4, 8 and 16 is 1.51, 1.19, 1.18 and 1.18 % above the bound, on
# 50 of thirty craft 1.02, 0.94, 0.81 and 0.77 %.
MOST_PLANNED = 16
LARGE_GAP = 1e-2  # optimality gap beyond which further assignments are planned
PROVEN = "whichever goals they take, {}, which is proven"


@dataclass(frozen=True, eq=False)
class GoalAssignment(PlannerWrapper):
    """A planner whose craft may take each other's goals.

    It plans the assignment of least decoupled cost. Where that plan is not safe, or its gap to
    that cost is large, it plans the next best assignments too, and the given order, if their
    decoupled costs are below that plan's fuel, and keeps the cheapest safe plan.
    """

    most: int = MOST_PLANNED  # largest number of assignments planned besides the given order

    def plan(self, scenarios: Sequence[Scenario]) -> list[Plan]:
        """One plan for each scenario, its goals in the order of ``Plan.assignment``.

        The certificate's lower bound on the fuel holds for all assignments. Where in each a craft
        provably cannot reach its goal, the plan is INFEASIBLE, with the given order.
        """
        if not scenarios:
            return []
        if any(one.problem.thrust.objective == "fair" for one in scenarios):
            raise InputError(
                "objective is fair and craft may take each other's goals, which are assigned by "
                "the fuel of all; expected one of the two: leave the assignment out."
            )
        started = time.perf_counter()
        candidates = [_Candidates(one, decoupled_costs(one), self.most) for one in scenarios]
        asked = [[one.first or one.given] for one in candidates]
        found = time.perf_counter()
        self._try(candidates, asked)
        planned = time.perf_counter()
        for one in candidates:
            one.narrow()
        self._try(candidates, [[] if one.first is None else [one.first] for one in candidates])
        others = [one.others() for one in candidates]
        seconds = (time.perf_counter() - planned + found - started) / len(scenarios)
        self._try(candidates, others)
        return [one.best(seconds) for one in candidates]

    def _try(self, candidates: Sequence["_Candidates"], asked: Sequence[Sequence[Slots]]) -> None:
        """Plan, all at once, the assignments asked for that are not tried yet."""
        both = zip(candidates, asked, strict=True)
        new = [(one, slots) for one, some in both for slots in some if slots not in one.tried]
        plans = self.planner.plan([one.scenario.taking(slots) for one, slots in new])
        for (one, slots), plan in zip(new, plans, strict=True):
            one.tried[slots] = plan


class _Candidates:
    """Candidate assignments of a scenario, and the plans of those that were tried."""

    def __init__(self, scenario: Scenario, costs: DecoupledCosts, most: int) -> None:
        self.scenario, self.costs, self.most = scenario, costs, most
        self.given: Slots = tuple(range(scenario.n))  # the order in which the goals were given
        # The assignment of least cost, or None where it is proven that none can be flown.
        self.cheapest = next(ranked(costs.fuel), None)
        # Costs, and the assignment of least, without goals that are proven to be of no use.
        self.allowed, self.first = costs.fuel, self.cheapest
        self.tried: dict[Slots, Plan] = {}

    @cached_property
    def ranking(self) -> list[Slots]:
        """The assignments of least cost, in ascending order, computed on first use."""
        return list(islice(ranked(self.allowed), self.most))

    def narrow(self) -> None:
        """Exclude assignments that cannot be passively safe, where the first is infeasible."""
        (plan,), scenario = self.tried.values(), self.scenario
        asked = plan.certificate.passive_safety
        if scenario.unlike:  # with sizes, which goals are too close depends on the assignment
            return
        if self.first is not None and plan.status == INFEASIBLE and asked is not None:
            ends, problem = (scenario.initial, scenario.goal), scenario.problem
            of_use = allowed_goals(*ends, problem, asked.orbits)
            self.allowed = np.where(of_use, self.costs.fuel, np.inf)
            self.first = next(ranked(self.allowed), None)

    def others(self) -> list[Slots]:
        """Assignments that may be better than the first: the next best, and the given order.

        Only those with decoupled costs below its plan's fuel; none where its gap is small.
        """
        if self.first is None:
            return []
        craft, least = range(self.scenario.n), _fuel(self.tried[self.first])
        if gap_of(least, self.costs.of(self.first), self.scenario.problem) <= LARGE_GAP:
            return []
        asked = dict.fromkeys([*self.ranking[1:], self.given])
        return [
            one for one in asked if one != self.first and self.allowed[craft, one].sum() < least
        ]

    def best(self, seconds: float) -> Plan:
        """The cheapest safe plan, or else the first tried; the search took ``seconds``."""
        tried = self.tried
        slots = min(tried, key=lambda one: _fuel(tried[one]))  # of equals the first tried
        timing = {**tried[slots].timing, "assignment": seconds}
        for name in ("plan", "certificate"):  # of all that are tried
            timing[name] = sum(plan.timing.get(name, 0.0) for plan in tried.values())
        timing["plan"] += seconds
        solves = sum(plan.convex_solves for plan in tried.values())
        plan = replace(tried[slots], timing=timing, convex_solves=solves)
        if self.cheapest is None:
            plain = self.scenario.limits is None
            limits = "max_acceleration" if plain else "its limits of thrust and delta_v"
            way = " by its waypoints" if self.scenario.waypoints else ""
            message = PROVEN.format(f"some craft cannot reach its own{way} within {limits}")
            return replace(plan, status=INFEASIBLE, message=message)
        if self.first is None:
            unsafe = "a craft adrift comes within collision_radius of another after the plan"
            plan = replace(plan, message=PROVEN.format(unsafe))
        elif plan.status == INFEASIBLE and not self._all_infeasible():
            reason = f"no plan found for {len(tried)} assignments; for this one, {plan.message}"
            plan = replace(plan, status=UNSOLVED, message=reason)
        bound = self.costs.of(self.cheapest)
        proof = "the linear assignment problem of all craft and goals, each pair's fuel by"
        certificate = replace(
            plan.certificate,
            fuel_lower_bound=bound,
            optimality_gap=gap_of(plan.certificate.fuel, bound, self.scenario.problem),
            fuel_lower_bound_proof=f"{proof}: {self.costs.proof}",
        )
        return replace(plan, certificate=certificate, assignment=self._assignment(slots, plan))

    def _all_infeasible(self) -> bool:
        """Whether every assignment is proven infeasible."""
        proven = all(plan.status == INFEASIBLE for plan in self.tried.values())
        return len(self.ranking) < self.most and proven

    def _assignment(self, slots: Slots, plan: Plan) -> Assignment:
        given, fuel = self.costs.of(self.given), plan.certificate.fuel
        known = np.isfinite(given) and given > self.scenario.problem.negligible_fuel
        ranks = [self.first] if slots == self.first else self.ranking
        return Assignment(
            slots=slots,
            rank=ranks.index(slots) + 1 if slots in ranks else None,
            tried=len(self.tried),
            given_fuel_lower_bound=given if np.isfinite(given) else None,
            saving=1 - fuel / given if known and plan.status == SOLVED else None,
        )


def _fuel(plan: Plan) -> float:
    """Fuel of a plan, m/s²; infinite where it is not SOLVED."""
    return plan.certificate.fuel if plan.status == SOLVED else np.inf
