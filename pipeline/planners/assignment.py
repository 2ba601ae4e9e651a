"""The linear assignment problem of craft and goals: costs, best assignment, ranking."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from heapq import heappop, heappush
from itertools import count

import numpy as np

from pipeline.arrays import Array, Float
from pipeline.expert.batch import Batch
from pipeline.expert.decoupled import PROGRAM, TABLE, control_limit, decoupled_optima, goal_miss
from pipeline.orbit.arrays import PerCraft
from pipeline.orbit.decoupled import minimum_fuel
from pipeline.scenario import Scenario

# Proof of costs some of which need a linear program
BOTH = f"{TABLE}, or {PROGRAM} where that breaks the thrust limit"
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

    A table gives all at once. Where its optimum breaks the thrust limit, its fuel is still a lower
    bound, and a linear program finds the exact cost, or that there is none: for the given order,
    and for the best assignment by the costs so far, until all costs of the best one are exact. So
    only few of the n² programs are solved.
    """
    n, problem = scenario.n, scenario.problem
    initial, goal = np.repeat(scenario.initial, n, axis=0), np.tile(scenario.goal, (n, 1))
    if scenario.limits is not None:
        return DecoupledCosts(_limited_costs(scenario), PROGRAM)
    found = minimum_fuel(goal_miss(initial, goal, problem), problem)
    if found is None:  # no table
        optima = decoupled_optima(initial, goal, problem)
        bounds = np.where(optima.impossible, np.inf, optima.lower_bound)
        return DecoupledCosts(bounds.reshape(n, n), PROGRAM)
    within = np.abs(found.controls).max(axis=(1, 2)) <= control_limit(problem)
    fuel, exact = found.bound.reshape(n, n), (found.exact & within).reshape(n, n)
    proof, asked = TABLE, tuple(range(n))
    while asked:
        craft = np.flatnonzero(~exact[range(n), asked])
        if len(craft):
            goals = np.array(asked)[craft]
            optima = decoupled_optima(scenario.initial[craft], scenario.goal[goals], problem)
            fuel[craft, goals] = np.where(optima.impossible, np.inf, optima.lower_bound)
            exact[craft, goals], proof = True, BOTH
        best = next(ranked(fuel), ())
        asked = () if exact[range(len(best)), best].all() else best
    return DecoupledCosts(fuel, proof)


def _limited_costs(scenario: Scenario) -> Float[Array, "n n"]:
    """The costs with further limits of thrust than max_acceleration, or with waypoints."""
    n, craft = scenario.n, np.arange(scenario.n)
    fuel = np.zeros((n, n))
    for shift in range(n):
        slots = (craft + shift) % n
        optima = Batch([scenario.taking(slots.tolist())]).optima
        fuel[craft, slots] = np.where(optima.impossible, np.inf, optima.lower_bound)
    return fuel


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
    """A subset of the assignments, as Murty's method partitions them: a node of its search."""

    slots: Slots  # the best of the part, or of the one that it was split from
    kept: int  # craft before this one keep their goals of ``slots``
    # goals that some of the others do not take, by craft and goal
    forbidden: tuple[tuple[int, int], ...]

    def costs(self, costs: Float[Array, "n n"]) -> Float[Array, "_ _"]:
        """Costs of craft that are not kept, by goal; infinite where it is taken or forbidden."""
        left = costs[self.kept :].copy()
        left[:, list(self.slots[: self.kept])] = np.inf
        for craft, goal in self.forbidden:
            left[craft - self.kept, goal] = np.inf
        return left

    def best(self, costs: Float[Array, "n n"]) -> Slots | None:
        """The assignment of least cost, or None where every one is infinite."""
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
