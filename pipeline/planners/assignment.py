"""The linear assignment problem of craft and goals: what each choice costs, the best, the next.

A craft's own optimum, the others ignored, bounds what it burns. So the least sum of own optima
over all assignments bounds the fuel of every plan, whoever goes where.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import count

import numpy as np
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment

from pipeline.arrays import Array
from pipeline.expert import own_optima
from pipeline.expert.own import PROGRAM, TABLE, control_limit, goal_miss
from pipeline.orbit.least_fuel import least_fuel
from pipeline.scenario import Scenario

BOTH = f"{TABLE}, or {PROGRAM} where that breaks the thrust limit"
"""How costs are proven of which some need a program."""

Slots = tuple[int, ...]
"""Of each craft, the goal that it takes."""


@dataclass(frozen=True, eq=False)
class OwnCosts:
    """What every craft needs at least for every goal.

    Attributes:
        fuel: proven lower bounds, craft by goal, m/s²; infinite where it is proven that the craft
            cannot reach the goal within the thrust limit. They are attained by the own optima of
            the given order and of the assignment of least cost.
        proof: of the bounds, in words.
    """

    fuel: Float[Array, "n n"]
    proof: str

    def of(self, slots: Slots) -> float:
        """Sum of the own optima of an assignment, m/s²."""
        return float(self.fuel[range(len(slots)), slots].sum())


def own_costs(scenario: Scenario) -> OwnCosts:
    """The costs of all craft and goals of a scenario.

    All come from the table at once. Where its optimum breaks the thrust limit, what it needs is
    still a lower bound, and a linear program finds the true cost, or that there is none: for the
    given order, and for each assignment that is best by what is known, until all costs of the best
    one are true. So few of the n² programs are solved.
    """
    n, problem = scenario.n, scenario.problem
    initial, goal = np.repeat(scenario.initial, n, axis=0), np.tile(scenario.goal, (n, 1))
    found = least_fuel(goal_miss(initial, goal, problem), problem)
    if found is None:  # no table
        own = own_optima(initial, goal, problem)
        return OwnCosts(np.where(own.impossible, np.inf, own.lower_bound).reshape(n, n), PROGRAM)
    within = np.abs(found.controls).max(axis=(1, 2)) <= control_limit(problem)
    fuel, true = found.bound.reshape(n, n), (found.exact & within).reshape(n, n)
    tabled = true.copy()

    def settle(slots: Slots) -> None:
        craft = np.flatnonzero(~true[range(n), slots])
        if len(craft) == 0:
            return
        goals = np.array(slots)[craft]
        own = own_optima(scenario.initial[craft], scenario.goal[goals], problem)
        fuel[craft, goals] = np.where(own.impossible, np.inf, own.lower_bound)
        true[craft, goals] = True

    settle(tuple(range(n)))
    while (slots := next(ranked(fuel), None)) and not true[range(n), slots].all():
        settle(slots)
    return OwnCosts(fuel, TABLE if (tabled == true).all() else BOTH)


def ranked(costs: Float[Array, "n n"]) -> Iterator[Slots]:
    """Assignments by their cost, the least first; none where every one is infinite.

    After each, what is left is split: the k-th part keeps the choices of the craft before k and
    forbids that of craft k, and the best of each part is a linear assignment problem (K. G. Murty,
    "An Algorithm for Ranking all the Assignments in Order of Increasing Cost", Operations Research
    16(3), 1968).
    """
    parts: list[tuple[float, int, Slots, Float[Array, "n n"], int]] = []
    number = count()  # of equal ones the first found goes first

    def add(part: Float[Array, "n n"], kept: int) -> None:
        try:
            craft, slots = linear_sum_assignment(part)
        except ValueError:  # every assignment is infinite
            return
        cost = float(part[craft, slots].sum())
        heappush(parts, (cost, next(number), tuple(slots.tolist()), part, kept))

    add(costs, 0)
    while parts:
        _, _, slots, part, kept = heappop(parts)
        yield slots
        part = part.copy()
        for craft, slot in list(enumerate(slots))[kept:]:
            without = part.copy()
            without[craft, slot] = np.inf
            add(without, craft)
            own = part[craft, slot]
            part[craft, :] = part[:, slot] = np.inf
            part[craft, slot] = own
