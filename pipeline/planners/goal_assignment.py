"""Goal assignment: a planner whose craft may take each other's goals.

The linear assignment problem of craft and goals has lower bounds on fuel as costs. It gives the
best assignment by these, the next best ones, and a bound for all of them.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from heapq import heappop, heappush
from itertools import count, islice

import numpy as np

from pipeline.arrays import Array, Bool, Float
from pipeline.errors import InputError
from pipeline.expert.batch import Batch, allowed_thrust, impossible_for_any_goals
from pipeline.expert.decoupled import (
    PROGRAM,
    TABLE,
    control_limit,
    goal_miss,
    minimum_fuel,
)
from pipeline.orbit.arrays import PerCraft
from pipeline.orbit.corridors import Faces
from pipeline.orbit.passive_safety import Ends, allowed_goals
from pipeline.plan.certificate import gap_of
from pipeline.plan.plan import INFEASIBLE, SOLVED, UNSOLVED, Assignment, Plan
from pipeline.planners.planner import PlannerWrapper
from pipeline.scenario import Scenario, scenario_list

# Largest number of assignments planned besides the given order. On 100 crowded scenarios of ten
# craft (family dense) the best of 1, 4, 8 and 16 is 1.51, 1.19, 1.18 and 1.18 % above the bound, on
# 50 of thirty craft 1.02, 0.94, 0.81 and 0.77 %.
MOST_PLANNED = 16
LARGE_GAP = 1e-2  # optimality gap beyond which further assignments are planned
PROVEN = "whichever goals they take, {}, which is proven"
# Proof of costs some of which need a linear program
BOTH = f"{TABLE}, or {PROGRAM} where that breaks the thrust limit or leaves a corridor"
ROUNDING = 1e-12  # share of a cost by which its bound may be off

Slots = tuple[int, ...]  # of each craft, the goal that it takes


@dataclass(frozen=True, eq=False)
class DecoupledCosts:
    """Lower bounds on the fuel of each craft to each goal, without the other craft."""

    # proven lower bounds, craft by goal, m/s²; infinite where it is proven that the craft cannot
    # reach the goal within the thrust limit. They are attained by the decoupled optima of the given
    # order and of the assignment of least cost
    fuel: Float[Array, "n n"]
    proof: str  # of the bounds, in words

    def of(self, slots: Slots) -> float:
        """Cost of an assignment, m/s²."""
        return float(self.fuel[range(len(slots)), slots].sum())


def decoupled_costs(scenario: Scenario) -> DecoupledCosts:
    """The costs of all craft and goals of a scenario.

    All at once without corridors and, where ``minimum_fuel`` serves, without the thrust limit. A
    program of its own gives the exact cost, or proves that there is none, of the pairs that this
    leaves out: for the given order, and for the best assignment by the costs so far, until all
    costs of the best one are exact. So only few of the n² programs are solved.
    """
    n = scenario.n
    fuel, exact, proof = _costs_at_once(scenario)
    exact[Faces.of(scenario.corridors, n).craft] = False
    asked: Slots = tuple(range(n))
    while asked:
        craft = np.flatnonzero(~exact[range(n), asked])
        if len(craft):
            goals = np.array(asked)[craft]
            optima = Batch([scenario.taking(asked).only(craft.tolist())]).optima
            fuel[craft, goals] = np.where(optima.impossible, np.inf, optima.lower_bound)
            exact[craft, goals], proof = True, PROGRAM if proof == PROGRAM else BOTH
        best = next(ranked(fuel), ())
        asked = () if exact[range(len(best)), best].all() else best
    return DecoupledCosts(fuel, proof)


def _costs_at_once(scenario: Scenario) -> tuple[Float[Array, "n n"], Bool[Array, "n n"], str]:
    """Lower bounds on all costs, whether each is exact without corridors, and their proof."""
    n, problem = scenario.n, scenario.problem
    if scenario.limits is None:
        initial, goal = np.repeat(scenario.initial, n, axis=0), np.tile(scenario.goal, (n, 1))
        found = minimum_fuel(goal_miss(initial, goal, problem), problem)
        if found is not None:
            within = np.abs(found.controls).max(axis=(1, 2)) <= control_limit(problem)
            exact = (found.exact & within).reshape(n, n)
            return found.bound.reshape(n, n), exact, TABLE if found.tabled else PROGRAM
    # Of one goal for each craft at a time, as craft have limits of their own, or waypoints.
    craft, fuel = np.arange(n), np.zeros((n, n))
    for shift in range(n):
        slots = (craft + shift) % n
        free = replace(scenario.taking(slots.tolist()), corridors=())
        optima = Batch([free]).optima
        fuel[craft, slots] = np.where(optima.impossible, np.inf, optima.lower_bound)
    return fuel, np.ones((n, n), dtype=bool), PROGRAM


def _unreachable(scenario: Scenario) -> str:
    """Why, whichever goals they take, some craft cannot reach its own, in words."""
    craft = np.arange(scenario.n)
    inside = np.zeros((scenario.n, scenario.n))  # infinite where a craft and its goal are not
    for shift in craft if scenario.corridors else ():
        slots = (craft + shift) % scenario.n
        for _, k, _, _ in scenario.taking(slots.tolist()).outside():
            inside[k, slots[k]] = np.inf
    if next(ranked(inside), None) is None:
        return "some craft is outside of a corridor at an end"
    way = " by its waypoints" if scenario.waypoints else ""
    way += " inside its corridors" if scenario.corridors else ""
    return f"some craft cannot reach its own{way} {allowed_thrust(scenario)}"


def ranked(costs: Float[Array, "n n"]) -> Iterator[Slots]:
    """Assignments by their cost, the least first; none where every one is infinite.

    After each, the remaining assignments are split: the k-th part keeps the goals of the craft
    before k and forbids that of craft k, and the best of each part is a linear assignment problem
    (K. G. Murty, "An Algorithm for Ranking all the Assignments in Order of Increasing Cost",
    Operations Research 16(3), 1968). A part is solved only once no other can hold a cheaper
    assignment, by a bound on its cost from the dual variables of the assignment that it was split
    from.
    """
    number = count()  # breaks ties: the first found comes first
    waiting = [(-np.inf, False, next(number), _Subproblem((), 0, ()))]
    while waiting:
        _, solved, place, part = heappop(waiting)
        if not solved:
            best = part.best(costs)
            if best is not None:
                cost = float(costs[range(len(best)), best].sum())
                heappush(waiting, (cost, True, place, replace(part, slots=best)))
            continue
        yield part.slots
        bounds = part.bounds_without(costs)
        for craft in range(part.kept, len(costs)):
            if np.isfinite(bounds[craft]):
                forbidden = tuple(one for one in part.forbidden if one[0] >= craft)
                forbidden += ((craft, part.slots[craft]),)
                left = _Subproblem(part.slots, craft, forbidden)
                heappush(waiting, (bounds[craft], False, next(number), left))


@dataclass(frozen=True, eq=False)
class _Subproblem:
    """A node of Murty's search: a subset of the assignments."""

    slots: Slots  # the best of the part, or of the one that it was split from
    kept: int  # craft before this one keep their goals of ``slots``
    # goals that some of the others do not take, by craft and goal
    forbidden: tuple[tuple[int, int], ...]

    def costs(self, costs: Float[Array, "n n"]) -> Float[Array, "_ _"]:
        """Cost matrix of the free craft by goal; infinite for goals that are taken or forbidden."""
        left = costs[self.kept :].copy()
        left[:, list(self.slots[: self.kept])] = np.inf
        for craft, goal in self.forbidden:
            left[craft - self.kept, goal] = np.inf
        return left

    def best(self, costs: Float[Array, "n n"]) -> Slots | None:
        """Assignment of least total cost; None where every assignment has infinite cost."""
        from scipy.optimize import linear_sum_assignment  # slow to import, and few plans need it

        try:
            _, slots = linear_sum_assignment(self.costs(costs))
        except ValueError:
            return None
        return (*self.slots[: self.kept], *slots.tolist())

    def bounds_without(self, costs: Float[Array, "n n"]) -> PerCraft:
        """For each craft, a lower bound on the cost of the part where it takes another goal."""
        # The craft needs another goal, and its goal another craft; by the reduced costs, none of
        # which is negative, either adds the least that is left to it. Kept craft have no bound.
        left, slots = self.costs(costs), np.array(self.slots[self.kept :])
        own = np.arange(len(slots))
        chosen = left[own, slots]
        goal, step = np.zeros(left.shape[1]), left - chosen[:, None]
        for _ in own:  # Bellman and Ford's method: dual variables of goals
            lower = np.minimum(goal, (goal[slots, None] + step).min(axis=0))
            if (lower >= goal).all():
                break
            goal = lower
        reduced = step + (goal[slots, None] - goal)
        reduced[own, slots] = np.inf
        # A craft that is looked at may not use the goals of those before it, nor they its goal.
        later = own[:, None] < own
        among = np.maximum(reduced[:, slots], 0.0)
        other_goal = np.where(later, among, np.inf).min(axis=1, initial=np.inf)
        other_craft = np.where(later.T, among, np.inf).min(axis=0, initial=np.inf)
        whole = float(costs[range(len(self.slots)), self.slots].sum())
        bounds = np.full(len(self.slots), np.inf)
        bounds[self.kept :] = (whole + other_goal + other_craft) * (1 - ROUNDING)
        return bounds


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
        if not (scenarios := scenario_list(scenarios)):
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
        self.allowed, self.forbidden = costs.fuel, ""  # and why not in the others
        if impossible_for_any_goals(scenario):
            self.allowed = np.full_like(costs.fuel, np.inf)
            self.forbidden = "states that they must have are too close"
        self.first = next(ranked(self.allowed), None)
        self.tried: dict[Slots, Plan] = {}

    @cached_property
    def ranking(self) -> list[Slots]:
        """The assignments of least cost, in ascending order, computed on first use."""
        return list(islice(ranked(self.allowed), self.most))

    def narrow(self) -> None:
        """Exclude assignments that cannot be passively safe, where the first is infeasible."""
        (plan,), scenario = self.tried.values(), self.scenario
        asked = plan.certificate.passive_safety
        if self.first is not None and plan.status == INFEASIBLE and asked is not None:
            ends, problem = (scenario.initial, scenario.goal), scenario.problem
            radii = scenario.radii if scenario.sized else None
            of_use = allowed_goals(Ends(*ends, problem, asked.orbits, radii, scenario.obstacles))
            self.allowed = np.where(of_use, self.allowed, np.inf)
            self.first = next(ranked(self.allowed), None)
            adrift = "a craft adrift comes within collision_radius of another after the plan"
            if scenario.sized:
                adrift = "a craft adrift comes too close to another or to an obstacle"
            some = np.isinf(self.costs.fuel).any()
            self.forbidden = f"{_unreachable(scenario)}, or {adrift}" if some else adrift

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
            message = PROVEN.format(_unreachable(self.scenario))
            return replace(plan, status=INFEASIBLE, message=message)
        if self.first is None:
            forbidden = PROVEN.format(self.forbidden)
            plan = replace(plan, message=f"{forbidden}; in this assignment, {plan.message}")
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
        ranks = [self.first] if slots == self.first else self.ranking
        rank = ranks.index(slots) + 1 if slots in ranks else None
        chosen = Assignment(slots, rank, len(self.tried), None, None)
        return with_saving(chosen, self.costs.of(self.given), plan)


def with_saving(chosen: Assignment, given: float, plan: Plan) -> Assignment:
    """An assignment with the bound for the given order, infinite without a plan, and its saving."""
    known = np.isfinite(given) and given > plan.scenario.problem.negligible_fuel
    return replace(
        chosen,
        given_fuel_lower_bound=given if np.isfinite(given) else None,
        saving=1 - plan.certificate.fuel / given if known and plan.status == SOLVED else None,
    )


def _fuel(plan: Plan) -> float:
    """Fuel of a plan, m/s²; infinite where it is not SOLVED."""
    return plan.certificate.fuel if plan.status == SOLVED else np.inf
