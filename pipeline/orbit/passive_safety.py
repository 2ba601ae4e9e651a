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
from math import ceil

import numpy as np

from pipeline.arrays import Array, Bool, Float, Int
from pipeline.orbit.approaches import (
    Approaches,
    Motions,
    chord_distances,
    close_approaches,
    closest_to_origin,
)
from pipeline.orbit.arrays import Controls, CraftMask, Formation, Indices, States, Values, norm
from pipeline.orbit.dynamics import Dynamics
from pipeline.orbit.linearized import LinearizedDynamics
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

# Node of loss, number of the pair, first time step, and bound on the acceleration adrift, m/s²
Near = tuple[Int[Array, "_"], Int[Array, "_"], Int[Array, "_"], Float[Array, "_"]]

AT_ONCE = 50_000  # blocks of time steps that are compared at once, which bounds memory
PARTS = 2  # into which blocks of time steps are cut
WIDEST = 0.3  # largest angle by which the reference turns in a block of several steps, rad
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
    none = (np.zeros(0, dtype=int),) * 4
    near = _BlockSearch(paths, reach, swarms, moved).found()
    lost, node, other, interval = map(np.concatenate, zip(none, *near, strict=True))
    if moved is not None:  # in the order in which further starts take their random shifts
        order = np.lexsort((interval >= paths.last, node))
        lost, node, other, interval = (one[order] for one in (lost, node, other, interval))
    cut, found = interval - node == paths.whole, []
    for length, which in ((problem.time_step, ~cut), (paths.rest, cut)):
        where = lost[which], node[which], other[which], interval[which]
        found.append(_closest(paths, length, reach, where, swarms))
    return Approaches.concatenated(found)


def least_after_loss(
    states: States, controls: Controls, problem: Problem, orbits: float, swarms: SwarmPartition
) -> list[Separation]:
    """The least separation between a craft after loss of thrust and any other, in each swarm."""
    paths = _Paths(states, controls, problem, orbits, swarms)
    least = _closest_sampled(paths, swarms)
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
        last = self.last = states.shape[1] - 1  # the last node of the plan
        self.problem = problem
        self.rest = max(0.0, (steps - whole) * h)  # remainder of a drift after M time steps, s
        self.steps = whole + (self.rest > NO_LENGTH * h or not whole)  # the remainder included
        width, angle = 1, problem.dynamics.fastest * h
        while width * PARTS * angle <= WIDEST and width * PARTS <= self.steps:
            width *= PARTS
        self.width = width  # time steps in a block
        self.blocks = ceil(self.steps / width) + (width > 1)  # that a drift from any node meets
        total = (last // width + self.blocks) * width
        self.dynamics = self.coarse = problem.dynamics  # of time steps and of blocks
        if problem.orbit is not None:  # all of the drift is computed at once
            self.dynamics = LinearizedDynamics(problem.orbit, h, total)
            self.coarse = LinearizedDynamics(problem.orbit, width * h, total // width)
        self.from_start, self.to_start = _drifts(self.dynamics, last, total)
        # At nodes, and at every further time step up to the last block's end, m and m/s.
        after = np.matvec(self.drift(last, np.arange(1, total - last + 1)), states[:, -1:])
        idle = np.zeros((len(states), total - last, 3))  # after the plan
        held = swarms.held
        after[held], idle[held] = states[held, -1:], controls[held, -1:]
        self.states = np.concatenate([states, after], axis=1)
        self.controls = np.concatenate([controls, idle], axis=1)
        # The states at the first node from which free drift leads to those at each node.
        self.begins = np.matvec(self.to_start, states)

    def drift(self, node: int | Indices, steps: Indices) -> Float[Array, "_ 6 6"]:
        """State transition matrices A from a node to some time steps of a drift."""
        if self.problem.orbit is None:
            return self.from_start[steps]
        return self.from_start[node + steps] @ self.to_start[node]

    def batches(self, pairs: int) -> Iterator[tuple[Int[Array, "k"], list[Int[Array, "_"]]]]:
        """Nodes of loss, and parts of pairs by number, whose blocks are compared at once."""
        each = max(1, pairs * self.blocks)
        parts = np.array_split(np.arange(pairs), 1 + each // AT_ONCE)
        few = max(1, AT_ONCE // each)
        for node in range(0, self.last + 1, few):
            yield np.arange(node, min(node + few, self.last + 1)), parts


@lru_cache(maxsize=8)
def _drifts(
    dynamics: Dynamics, last: int, steps: int
) -> tuple[Float[Array, "_ 6 6"], Float[Array, "nodes 6 6"]]:
    """A from the first node to each of so many time steps, and from each node back to the first."""
    drift = dynamics.drift
    return drift(0, np.arange(steps + 1)), drift(np.arange(last + 1), 0)


class _BlockSearch:
    """Search for drifting craft, nodes, other craft and intervals that may be within a distance.

    Over a block of time steps both craft stay near their chords, by which most blocks are left out
    at once. The others are cut into parts, down to single steps.
    """

    def __init__(
        self,
        paths: _Paths,
        reach: Float[Array, "craft"],
        swarms: SwarmPartition,
        moved: CraftMask | None,
    ) -> None:
        self.paths, self.reach, self.swarms, self.moved = paths, reach, swarms, moved
        lost, met = swarms.loss_pairs
        if moved is not None:
            affected = moved[lost] | moved[met]
            lost, met = lost[affected], met[affected]
        self.lost, self.met = lost, met
        self.scale, beyond = swarms.separation_scaling(lost, met)
        self.within = reach[lost] + beyond
        h, each = paths.problem.time_step, np.arange(paths.controls.shape[1])
        most = paths.dynamics.acceleration_bound(paths.states[:, :-1], paths.controls, h, each)
        self.sag = most * h**2 / 8

    def found(self) -> Iterator[tuple[Array, ...]]:
        """Indices of craft, node, other craft and interval, by node, pair and interval."""
        widths = [self.paths.width]
        while widths[-1] > 1:
            widths.append(widths[-1] // PARTS)
        bends = [self._bends(width) for width in widths]
        for batch in self.paths.batches(len(self.lost)):
            for near in self._blocks(*batch, bends[0]):
                for width, bend in zip(widths[1:], bends[1:], strict=True):
                    near = self._parts(near, width, bend)
                node, pair, interval, _ = near
                yield self.lost[pair], node, self.met[pair], interval

    def _bends(self, width: int) -> Float[Array, "n blocks"]:
        """Bound on the deviation of flown paths from their chords over blocks, m."""
        position = self.paths.states[..., :3]
        begin, end = position[:, :-1:width, None], position[:, width::width, None]
        chord = begin + np.arange(width)[:, None] / width * (end - begin)
        off = norm(position[:, :-1].reshape(chord.shape) - chord)
        return np.asarray(off.max(axis=-1) + self.sag.reshape(off.shape).max(axis=-1))

    def _blocks(
        self,
        nodes: Int[Array, "k"],
        parts: Sequence[Int[Array, "_"]],
        bends: Float[Array, "n blocks"],
    ) -> Iterator[Near]:
        """The widest blocks in which balls about the craft are near, for parts of the pairs."""
        paths, width = self.paths, self.paths.width
        length = width * paths.problem.time_step
        ends = nodes[:, None] // width * width + width * np.arange(paths.blocks + 1)
        begin, block = ends[:, :-1], ends[:, :-1] // width
        adrift = np.matvec(paths.from_start[ends], paths.begins[:, nodes, None])
        start = adrift[:, :, :-1]
        idle = np.zeros_like(start[..., :3])
        most = paths.coarse.acceleration_bound(start, idle, length, block)
        centre, size = _chord_balls(adrift, length**2 / 8 * most)
        middle, radius = _chord_balls(paths.states[:, ends], bends[:, block])
        size[: len(self.reach)] += self.reach[:, None]
        for part in parts:
            lost, met = self.lost[part], self.met[part]
            separation = self.swarms.separations(centre, middle, lost, met)
            near = separation <= size.take(lost, 0) + radius.take(met, 0)
            near = near.reshape(len(part), *begin.shape).swapaxes(0, 1)
            near &= self._wanted(nodes[:, None, None], part[:, None], begin[:, None], width)
            node, pair, at = near.nonzero()
            yield nodes[node], part[pair], begin[node, at], most[lost[pair], node, at]

    def _parts(self, near: Near, width: int, bends: Float[Array, "n blocks"]) -> Near:
        """The parts of such blocks in which relative chords are near the origin."""
        paths, (node, pair, begin, most) = self.paths, near
        lost, met = self.lost[pair], self.met[pair, None]
        ends = begin[:, None] + width * np.arange(PARTS + 1)
        drifting = np.matvec(paths.from_start[ends, :3], paths.begins[lost, node, None])
        gap = np.moveaxis(drifting - paths.states[met, ends, :3], -1, 0)
        if self.scale is not None:
            gap = gap * self.scale[pair].T[:, :, None]
        half, parts = (gap[..., 1:] - gap[..., :-1]) / 2, ends[:, :-1]
        sag = (width * paths.problem.time_step) ** 2 / 8 * most[:, None]
        within = self.within[pair, None] + sag + bends[met, parts // width]
        close = chord_distances(gap[..., :-1] + half, half) <= within
        close &= self._wanted(node[:, None], pair[:, None], parts, width)
        row, step = close.nonzero()
        return node[row], pair[row], parts[row, step], most[row]

    def _wanted(self, node: Array, pair: Array, begin: Array, width: int) -> Bool[Array, "*some"]:
        """Whether blocks are part of a drift, and controls of moved craft affect them."""
        inside = (begin + width > node) & (begin < node + self.paths.steps)
        if self.moved is None:
            return inside
        # Drifts from the first and the last node are fixed, and so are those from goals.
        last = self.paths.last
        affected = self.moved[self.lost[pair]] & (node > 0) & (node < last)
        return inside & (affected | (self.moved[self.met[pair]] & (begin < last)))


def _chord_balls(
    states: Float[Array, "n k ends 6"], bend: Float[Array, "n k blocks"]
) -> tuple[Float[Array, "n times 3"], Float[Array, "n times"]]:
    """Centre and radius of a ball in which each craft stays in each block, m."""
    begin, end = states[:, :, :-1, :3], states[:, :, 1:, :3]
    size = norm(end - begin) / 2 + bend
    return ((begin + end) / 2).reshape(len(size), -1, 3), size.reshape(len(size), -1)


def _closest(
    paths: _Paths, length: float, reach: Values, which: Iterable[Array], swarms: SwarmPartition
) -> Approaches:
    """The encounters among candidates."""
    lost, node, other, interval = which
    dynamics, held = paths.dynamics, paths.controls[other, interval]
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


def _closest_sampled(paths: _Paths, swarms: SwarmPartition) -> list[Separation]:
    """The least separation after a loss at begins of blocks; its bound allows for rounding."""
    closest = [Separation()] * len(swarms.sizes)
    lost, met = swarms.loss_pairs
    since, step = np.arange(0, paths.whole + 1, paths.width), paths.problem.time_step
    slack = ROUNDING * float(np.abs(paths.states[..., :3]).max())
    for nodes, parts in paths.batches(len(lost)):
        at = nodes[:, None] + since
        start = paths.begins[:, nodes, None]
        drifting = np.matvec(paths.from_start[at, :3], start).reshape(len(start), -1, 3)
        others = paths.states[:, at.ravel(), :3]
        for i, j in ((lost[part], met[part]) for part in parts):
            separation = swarms.separations(drifting, others, i, j)
            for swarm, distance, k, pair in closest_sampled(separation, i, j, swarms):
                if not closest[swarm].distance <= distance:
                    time, node = float(at.ravel()[k]) * step, int(nodes[k // len(since)])
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
