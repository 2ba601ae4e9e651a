"""Passive safety: closest approaches of a craft that has lost its thrust at a node.

One craft drifts from that node on; the others fly their plan to its end and then drift from their
goals. All of this is linear motion under controls that are constant over intervals, so the search
with proven bounds is the same as for craft in flight.

Initial and goal states alone may prove that no plan is passively safe: whatever the plan is, a
craft that loses its thrust at the first node drifts from its start, and after the last node all
other craft drift from their goals. The motion of obstacles is known.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from pipeline.arrays import Array, Bool, Float, Int
from pipeline.orbit.approaches import (
    Approaches,
    Motions,
    balls,
    close_approaches,
    closest_to_origin,
)
from pipeline.orbit.arrays import Controls, CraftMask, Formation, Indices, States, Values, mapped
from pipeline.orbit.participants import Obstacle, Participants, at_the_end
from pipeline.orbit.partition import SwarmPartition, swarm_partition
from pipeline.orbit.problem import RANGES, Problem
from pipeline.orbit.separation import (
    ROUNDING,
    Separation,
    closest_sampled,
    distances_of,
    replace_if_closer,
)
from pipeline.orbit.transfer import free_drift

AT_ONCE = 1_000_000  # pairs and intervals that are compared at once, which bounds memory
NO_LENGTH = 1e-9  # share of an interval below which a remainder is rounding
# Drift in s below which nothing is proven by the ends alone; plans are still checked over it
SHORTEST = 2 * RANGES["time_step"][0]


def loss_encounters(
    states: States,
    controls: Controls,
    problem: Problem,
    orbits: float,
    within: float | Float[Array, "swarms"],
    *,
    swarms: SwarmPartition | None = None,
    moved: CraftMask | None = None,
) -> Approaches:
    """All encounters within a distance, m, of craft adrift from a node with others.

    The distance is one for all swarms or one for each; by default there is one swarm. ``orbits`` is
    the length of a drift. Encounters that no controls of ``moved`` craft affect are skipped.
    """
    swarms = swarms or swarm_partition((len(states),))
    reach, paths = swarms.per_craft(within), _Paths(states, controls, problem, orbits, swarms)
    moved = None if moved is None else swarms.participant_mask(moved)
    found = []
    for length, since in paths.pieces:
        none = (np.zeros(0, dtype=int),) * 4
        near = _candidates(paths, length, since, reach, swarms, moved)
        which = map(np.concatenate, zip(none, *near, strict=True))
        found.append(_closest(paths, length, reach, which, swarms))
    return Approaches.concatenated(found)


def least_after_loss(
    states: States, controls: Controls, problem: Problem, orbits: float, swarms: SwarmPartition
) -> list[Separation]:
    """The least separation between a craft after loss of thrust and any other, in each swarm."""
    paths = _Paths(states, controls, problem, orbits, swarms)
    least = _closest_at_steps(paths, swarms)
    found = loss_encounters(states, controls, problem, orbits, distances_of(least), swarms=swarms)
    return replace_if_closer(least, found, problem, swarms)


class _Paths:
    """A plan of participants flown to its end, and the drift from there for a number of orbits."""

    def __init__(
        self,
        states: States,
        controls: Controls,
        problem: Problem,
        orbits: float,
        swarms: SwarmPartition,
    ) -> None:
        states, controls = swarms.all_states(states), swarms.all_controls(controls)
        h = problem.time_step
        steps = orbits * 2 * np.pi / problem.mean_motion / h
        whole = self.whole = int(steps + NO_LENGTH)  # M, whole time steps of a drift
        self.problem, self.last = problem, states.shape[1] - 1  # the last node of the plan
        self.rest = max(0.0, (steps - whole) * h)  # remainder of a drift after M time steps, s
        # At nodes, and at every further time step of the drift, (n, T + M, 6), m and m/s.
        after = np.matvec(self.drift(self.last)[1:], states[:, -1:])
        idle = np.zeros((len(states), whole + 1, 3))  # after the plan
        held = swarms.held
        after[held], idle[held] = states[held, -1:], controls[held, -1:]
        self.states = np.concatenate([states, after], axis=1)
        self.controls = np.concatenate([controls, idle], axis=1)

    def drift(self, node: int | Indices, steps: Indices | None = None) -> Float[Array, "_ 6 6"]:
        """State transition matrices A from a node to all, or some, time steps of a drift."""
        table = _drifts(self.problem, self.whole)
        begin = node if len(table) > 1 else 0
        return table[begin] if steps is None else table[begin, steps]

    @property
    def pieces(self) -> Iterator[tuple[float, Int[Array, "steps"]]]:
        """Groups of intervals of one length, s, and their begins, in time steps after the loss."""
        if self.whole:
            yield self.problem.time_step, np.arange(self.whole)
        if self.rest > NO_LENGTH * self.problem.time_step or not self.whole:
            yield self.rest, np.array([self.whole])


@lru_cache(maxsize=8)
def _drifts(problem: Problem, whole: int) -> Float[Array, "_ _ 6 6"]:
    """A from each node to each time step of a drift; about a circle, one node stands for all."""
    nodes = np.arange(1 if problem.orbit is None else problem.nodes)[:, None]
    return problem.dynamics.drift(nodes, nodes + np.arange(whole + 1))


def _candidates(
    paths: _Paths,
    length: float,
    since: Int[Array, "steps"],
    reach: Float[Array, "craft"],
    swarms: SwarmPartition,
    moved: CraftMask | None,
) -> Iterator[tuple[Array, ...]]:
    """Drifting craft, node, other craft and interval whose balls are within a distance."""
    dynamics = paths.problem.dynamics

    def around(start: States, controls: Controls, interval: Indices) -> tuple[Array, Array]:
        A, B = (one[..., :3, :] for one in dynamics.step(length, interval))
        end = mapped(A, start) + mapped(B, controls)
        return balls(start, end, controls, dynamics, length, interval)

    middle, radius = around(paths.states, paths.controls, np.arange(paths.states.shape[1]))
    for node in range(paths.last + 1):
        drifting = np.matvec(paths.drift(node)[since], paths.states[:, node, None])
        centre, size = around(drifting, np.zeros((*drifting.shape[:2], 3)), node + since)
        for i, j, steps in _searched(node, paths.last, since, swarms, moved):
            at = slice(node + since[steps.start], node + since[steps.stop - 1] + 1)
            separation = swarms.separations(centre[:, steps], middle[:, at], i, j)
            pair, step = np.nonzero(separation <= size[i, steps] + radius[j, at] + reach[i, None])
            yield i[pair], np.full(len(pair), node), j[pair], at.start + step


def _searched(
    node: int,
    last: int,
    since: Int[Array, "steps"],
    swarms: SwarmPartition,
    moved: CraftMask | None,
) -> Iterator[tuple[Int[Array, "p"], Int[Array, "p"], slice]]:
    """Pairs of a drifting craft and another, and steps of a drift from a node, in batches.

    All of them, or those that the controls of ``moved`` craft affect.
    """
    (lost, met), count = swarms.loss_pairs, len(since)
    if moved is None:
        windows = [(np.ones(len(lost), dtype=bool), 0, count)]
    else:  # drifts from the first and the last node are fixed, and so are those from goals
        flying = int(np.clip(last - node - since[0], 0, count))
        lost_moved = moved[lost] & (0 < node < last)
        windows = [(lost_moved | moved[met], 0, flying), (lost_moved, flying, count)]
    for wanted, begin, end in windows:
        chosen = np.flatnonzero(wanted)
        if begin == end or len(chosen) == 0:
            continue
        for part in np.array_split(chosen, 1 + len(chosen) * (end - begin) // AT_ONCE):
            yield lost[part], met[part], slice(begin, end)


def _closest(
    paths: _Paths, length: float, reach: Values, which: Iterable[Array], swarms: SwarmPartition
) -> Approaches:
    """The encounters among candidates."""
    lost, node, other, interval = which
    dynamics, held = paths.problem.dynamics, paths.controls[other, interval]
    drifting = np.matvec(paths.drift(node, interval - node), paths.states[lost, node])
    start = drifting - paths.states[other, interval]
    A, B = dynamics.step(length, interval)
    end, since = np.matvec(A, start) - np.matvec(B, held), np.zeros(len(start))
    scale, beyond = swarms.separation_scaling(lost, other)
    flown = np.concatenate([end, start, -held], axis=1)
    motions = Motions(flown, reach[lost] + beyond, interval, since, scale)
    near, found = closest_to_origin(motions, dynamics, length)
    return Approaches(
        **vars(found.reduced_by(beyond, near)),
        first=lost[near],
        second=other[near],
        interval=interval[near],
        node=node[near],
    )


def _closest_at_steps(paths: _Paths, swarms: SwarmPartition) -> list[Separation]:
    """The least separation after a loss at any time step; its bound allows for rounding."""
    closest = [Separation()] * len(swarms.sizes)
    since, step = np.arange(paths.whole + 1), paths.problem.time_step
    slack = ROUNDING * float(np.abs(paths.states[..., :3]).max())
    for node in range(paths.last + 1):
        drifting = np.matvec(paths.drift(node), paths.states[:, node, None])[..., :3]
        for i, j, _ in _searched(node, paths.last, since, swarms, None):
            others = paths.states[:, node : node + len(since), :3]
            separation = swarms.separations(drifting, others, i, j)
            for swarm, distance, at, pair in closest_sampled(separation, i, j, swarms):
                if not closest[swarm].distance <= distance:
                    time = float(node + at) * step
                    closest[swarm] = Separation(distance, distance - slack, pair, time, node)
    return closest


def unavoidable_encounter(
    initial: Formation,
    goal: Formation,
    problem: Problem,
    orbits: float,
    radii: Values | None = None,
    obstacles: Sequence[Obstacle] = (),
) -> Separation | None:
    """The closest encounter too near that no plan between the two ends avoids, or None.

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
