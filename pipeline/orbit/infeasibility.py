"""Proofs by the ends alone that no plan is passively safe.

A craft that loses its thrust at the first node drifts on from its start, and after the plan the
others drift on from their goals, whatever the plan is; after the last node all drift on from
their goals.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from pipeline.arrays import Array
from pipeline.orbit.approaches import close_approaches
from pipeline.orbit.arrays import Formation
from pipeline.orbit.passive_safety import LossSeparation
from pipeline.orbit.problem import RANGES, Problem
from pipeline.orbit.transfer import free_drift

# Drift in s below which nothing is proven of the ends alone; plans are held to it all the same
SHORTEST = 2 * RANGES["time_step"][0]


def unavoidable(
    initial: Formation, goal: Formation, problem: Problem, orbits: float
) -> LossSeparation | None:
    """The closest encounter within the collision radius that follows from the ends, or None."""
    starts = _starts_with_goals(initial, goal, problem, orbits)
    others = [one for one in starts if one.pair[0] != one.pair[1]]  # a craft takes its own goal
    met = [*_goals_together(goal, problem, orbits), *others]
    return min(met, key=lambda one: one.distance, default=None)


def forced_goals(
    initial: Formation, goal: Formation, problem: Problem, orbits: float
) -> Bool[Array, "n n"]:
    """Which goals craft may take, by craft and goal, where goals are not assigned yet.

    Who drifts from its start into one that drifts on from some goal must take that goal itself;
    none may take any where two goals drift into each other.
    """
    n = len(goal)
    allowed = np.ones((n, n), dtype=bool)
    if list(_goals_together(goal, problem, orbits)):
        return ~allowed
    for one in _starts_with_goals(initial, goal, problem, orbits):
        craft, taken = one.pair
        allowed[craft] &= np.arange(n) == taken
    return allowed


def _goals_together(goal: Formation, problem: Problem, orbits: float) -> Iterator[LossSeparation]:
    """Encounters of craft that all drift on from their goals."""
    yield from _encounters(goal, problem, orbits, problem.nodes - 1)


def _starts_with_goals(
    initial: Formation, goal: Formation, problem: Problem, orbits: float
) -> Iterator[LossSeparation]:
    """Encounters, after the plan, of craft drifting from a start and others on a goal's orbit."""
    n = len(goal)
    A, _ = problem.dynamics.step(problem.duration)
    both = np.concatenate([initial @ A.T, goal])  # where they are when the plan ends
    longer = orbits - problem.duration * problem.mean_motion / (2 * np.pi)
    for one in _encounters(both, problem, longer, 0):
        first, second = one.pair
        if first < n <= second:
            yield replace(one, pair=(first, second - n))


def _encounters(
    states: Float[Array, "k 6"], problem: Problem, orbits: float, node: int
) -> Iterator[LossSeparation]:
    """Encounters within the collision radius in free drift from the plan's end on."""
    if orbits * 2 * np.pi / problem.mean_motion < SHORTEST:
        return
    flown, idle, drift = free_drift(states, problem, orbits)
    found = close_approaches(flown, idle, drift, problem.collision_radius)
    for k in np.flatnonzero(found.distance <= problem.collision_radius).tolist():
        yield LossSeparation(
            distance=float(found.distance[k]),
            bound=float(found.bound[k]),
            pair=(int(found.first[k]), int(found.second[k])),
            node=node,
            time=float(problem.duration + found.interval[k] * drift.time_step + found.offset[k]),
        )
