"""Proofs from initial and goal states alone that no plan is passively safe.

Whatever the plan is, a craft that loses its thrust at the first node drifts from its start, and
after the last node all other craft drift from their goals. The motion of obstacles is known.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from pipeline.arrays import Array, Bool
from pipeline.orbit.approaches import close_approaches
from pipeline.orbit.arrays import Formation, Values
from pipeline.orbit.participants import Obstacle, Participants, at_the_end
from pipeline.orbit.problem import RANGES, Problem
from pipeline.orbit.separation import Separation
from pipeline.orbit.transfer import free_drift

# Drift in s below which nothing is proven by the ends alone; plans are still checked over it
SHORTEST = 2 * RANGES["time_step"][0]


def unavoidable_encounter(
    initial: Formation,
    goal: Formation,
    problem: Problem,
    orbits: float,
    radii: Values | None = None,
    obstacles: Sequence[Obstacle] = (),
) -> Separation | None:
    """The closest encounter within r_col, or both radii, that the ends imply, or None.

    Radii of craft are in m; obstacles need them, and are numbered after the craft.
    """
    there, last = at_the_end(obstacles, problem), problem.nodes - 1
    found = list(_encounters(goal, problem, orbits, last, radii, there))
    if obstacles:
        before = _encounters(initial, problem, orbits, 0, radii, obstacles, begin=0.0)
        found += [one for one in before if one.pair and one.pair[1] >= len(goal)]
    starts = _starts_with_goals(initial, goal, problem, orbits, radii)
    found += [one for craft, taken, one in starts if craft != taken]  # a craft takes its own goal
    return min(found, key=lambda one: one.distance, default=None)


def allowed_goals(
    initial: Formation, goal: Formation, problem: Problem, orbits: float
) -> Bool[Array, "n n"]:
    """Mask of the goals that each craft may take, where goals are not assigned yet.

    A craft whose drift from its start meets a craft that drifts from some goal must take that goal
    itself. None may take any where drifts from two goals meet.
    """
    n = len(goal)
    allowed = np.ones((n, n), dtype=bool)
    if list(_encounters(goal, problem, orbits, problem.nodes - 1)):
        return ~allowed
    for craft, taken, _ in _starts_with_goals(initial, goal, problem, orbits):
        allowed[craft] &= np.arange(n) == taken
    return allowed


def _starts_with_goals(
    initial: Formation,
    goal: Formation,
    problem: Problem,
    orbits: float,
    radii: Values | None = None,
) -> Iterator[tuple[int, int, Separation]]:
    """Encounters after the plan of craft adrift from their starts with others adrift from goals."""
    n = len(goal)
    A = problem.dynamics.drift(0, problem.intervals)
    both = np.concatenate([initial @ A.T, goal])  # where they are when the plan ends
    longer = orbits - problem.duration * problem.mean_motion / (2 * np.pi)
    radii = None if radii is None else np.tile(radii, 2)
    for one in _encounters(both, problem, longer, 0, radii):
        if one.pair and one.pair[0] < n <= one.pair[1]:
            craft, taken = one.pair[0], one.pair[1] - n
            yield craft, taken, replace(one, pair=(craft, taken))


def _encounters(
    states: Formation,
    problem: Problem,
    orbits: float,
    node: int,
    radii: Values | None = None,
    obstacles: Sequence[Obstacle] = (),
    begin: float | None = None,
) -> Iterator[Separation]:
    """Encounters within the collision radius in free drift from a time, s, or the plan's end."""
    if orbits * 2 * np.pi / problem.mean_motion < SHORTEST:
        return
    begin = problem.duration if begin is None else begin
    flown, idle, drift = free_drift(states, problem, orbits, begin)
    drift = replace(drift, collision_radius=problem.collision_radius)
    swarms = None if radii is None else Participants(drift, [radii], [obstacles])
    found = close_approaches(flown, idle, drift, problem.collision_radius, swarms=swarms)
    time = begin + found.times(drift)
    for k in np.flatnonzero(found.distance <= problem.collision_radius).tolist():
        pair, distance = (int(found.first[k]), int(found.second[k])), float(found.distance[k])
        yield Separation(distance, float(found.bound[k]), pair, float(time[k]), node)
