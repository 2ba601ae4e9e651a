"""Closest approaches of craft, found by branch and bound with proven lower bounds, no sampling."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.arrays import Array, ArrayOrNumber
from pipeline.orbit.arrays import (
    AnyState,
    Controls,
    Indices,
    Marked,
    PositionMaps,
    Rows,
    Scalar,
    States,
    Values,
    Vector,
    Vectors,
)
from pipeline.orbit.bezier import branch_and_bound, chord_bound, hermite_bezier, norm
from pipeline.orbit.dynamics import Dynamics
from pipeline.orbit.problem import Problem

TOLERANCE = 1e-4  # width in m of the bracket in which a least separation is found
PROVABLE = 1.01 * TOLERANCE  # margin over a distance, m, that any later bracket's bound exceeds
MOST_PARTS = 64  # parts of an interval in one search; longer intervals are searched piece by piece
AT_ONCE = 250  # motions whose pieces are searched at once, which bounds memory
# Craft of a swarm, and pairs in all, up to which comparing all with all is faster than a tree
FEW, MOST_PAIRS = 128, 300_000

if TYPE_CHECKING:
    from pipeline.orbit.corridors import Faces

Pairs = tuple[Int[Array, "p"], Int[Array, "p"]]
Candidates = tuple[Indices, Indices, Indices]  # first craft, second craft and interval


class SwarmPartition:
    """Partition of the craft axis into independent swarms, by their numbers of craft."""

    def __init__(self, sizes: tuple[int, ...]) -> None:
        self.sizes = sizes
        self.label = np.repeat(np.arange(len(sizes)), sizes)  # the swarm of each craft
        self.starts = np.cumsum((0, *sizes[:-1]))  # the first craft of each swarm
        # Whether all pairs can be compared.
        self.few = max(sizes) <= FEW and sum(n * n for n in sizes) <= 2 * MOST_PAIRS
        self.held = np.zeros(0, dtype=int)  # participants that are held where they are
        self.faces: Faces | None = None  # half-spaces that craft stay inside of

    @cached_property
    def pairs(self) -> Pairs:
        """First and second craft of every pair i < j of a swarm."""
        first, second = zip(*(pairs(n) for n in self.sizes), strict=True)
        shift = np.repeat(self.starts, [len(one) for one in first])
        return np.concatenate(first) + shift, np.concatenate(second) + shift

    def alone(self, swarm: int) -> "SwarmPartition":
        """One of the swarms."""
        return side_by_side((self.sizes[swarm],))

    def beside(
        self, states: States, nodes: slice = slice(None)
    ) -> Float[Array, "participants T 6"]:
        """Node states of all participants, craft and obstacles; here of craft alone."""
        return states

    def pushed(self, controls: Controls) -> Float[Array, "participants intervals 3"]:
        """Controls of all participants, craft and obstacles; here of craft alone."""
        return controls

    def marked(self, moved: Marked) -> Bool[Array, "participants"]:
        """Those marked among all participants."""
        return moved

    def still(self, rows: Indices) -> Bool[Array, "k"]:
        """Which participants no plan moves."""
        return np.zeros(len(rows), dtype=bool)

    def places(self, rows: Indices, interval: Indices, maps: PositionMaps) -> Vectors:
        """Positions of what no plan moves, by maps from states at intervals' starts, m."""
        return np.zeros((len(rows), 3))

    def local(self, swarm: int, row: int) -> int:
        """The number of a participant within its swarm."""
        return row - int(self.starts[swarm])

    def asked(self, first: Indices, second: Indices) -> tuple[Vectors | None, Values | float]:
        """Scales of the axes by which pairs' separation counts, and what is taken off it, m."""
        return None, 0.0

    def apart(self, gap: Vector, first: Indices, second: Indices) -> Float[ArrayOrNumber, "*batch"]:
        """The separation of pairs by their gaps, m, as it compares with the collision radius."""
        return norm(gap)


@lru_cache(maxsize=64)
def side_by_side(sizes: tuple[int, ...]) -> SwarmPartition:
    """Swarms of some sizes, cached so that their pairs are listed once."""
    return SwarmPartition(sizes)


@lru_cache(maxsize=64)
def pairs(n: int) -> Pairs:
    """First and second craft of every pair i < j of n craft, read-only."""
    both = np.triu_indices(n, 1)
    for one in both:
        one.flags.writeable = False
    return both


def least_of_each(
    value: Values, label: Indices
) -> tuple[Int[Array, "labels"], Int[Array, "labels"]]:
    """The labels that occur, and the index of each one's least value; NaN is least."""
    if len(label) and (label == label[0]).all():
        return label[:1], np.array([value.argmin()])
    order = np.lexsort((np.where(np.isnan(value), -np.inf, value), label))
    ordered = label[order]
    first = np.flatnonzero(np.diff(ordered, prepend=-1))
    return ordered[first], order[first]


@dataclass(frozen=True, eq=False)
class Motions(Rows):
    """Relative motions over an interval of constant control."""

    start: Float[Array, "k 6"]  # state at its start, m and m/s
    end: Float[Array, "k 6"]  # and at its end
    push: Vectors  # control, m/s²
    reach: Values  # scaled distance from the origin up to which it is of interest, m
    interval: Indices  # counted from the plan's first node
    since: Values  # when they start, s since the interval's start
    scale: Vectors | None = None  # of the axes in which distances count, at most 1


@dataclass(frozen=True, eq=False)
class Closest(Rows):
    """Relative motions over an interval, each where it is closest to the origin."""

    offset: Values  # time since the interval's start, s
    distance: Values  # separation at that time, m; where sizes differ as in ``Participants``
    bound: Values  # proven lower bound on the separation in the interval, m
    free: Float[Array, "k 3 6"]  # map from the state at the interval's start to that position
    pushed: Float[Array, "k 3 3"]  # map from the control in the interval to it

    def less(self, beyond: Float[Array, "all"] | float, which: Indices) -> "Closest":
        """With distances and bounds by so much less, of those numbers."""
        if isinstance(beyond, float):
            return self
        off = beyond[which]
        return replace(self, distance=self.distance - off, bound=self.bound - off)


_EMPTY = np.zeros(0)
NOTHING = Closest(_EMPTY, _EMPTY, _EMPTY, np.zeros((0, 3, 6)), np.zeros((0, 3, 3)))


@dataclass(frozen=True, eq=False)
class Approaches(Closest):
    """Closest approaches of two craft within an interval."""

    first: Indices  # the craft with the lower index or, after a loss of thrust, the drifting one
    second: Indices  # the other craft
    interval: Indices  # counted from the first node; after a loss of thrust also beyond the last
    # at which the first lost its thrust; the last one, where it has none left to lose; or None
    node: Indices | None = None

    def times(self, problem: Problem) -> Values:
        """When they are, s since the first node."""
        return self.interval * problem.time_step + self.offset


def close_approaches(
    states: States,
    controls: Controls,
    problem: Problem,
    within: float | Float[Array, "swarms"],
    *,
    swarms: SwarmPartition | None = None,
    moved: Marked | None = None,
    tolerance: float = TOLERANCE,
) -> Approaches:
    """All closest approaches, one a pair and interval, that may come within a distance.

    Over an interval each craft stays in a ball about the middle of its chord, and only pairs whose
    balls are near can matter. For those it is branch and bound. On a stretch of length h the
    relative position is a cubic Hermite interpolant up to h⁴/384 max|p⁗|, which the dynamics
    bound; and the cubic's squared distance is nowhere below its least Bernstein coefficient. So
    every stretch has a lower bound; stretches that cannot matter are dropped, the others split,
    until the bracket [bound, distance] is ``tolerance`` wide, m.

    The distance ``within``, m, is of all swarms or of each; by default there is one swarm. Pairs
    of which neither is ``moved`` are skipped. There is an entry for each pair and interval whose
    bound is at most ``within``, by interval, first and second craft.
    """
    swarms = swarms or side_by_side((len(states),))
    reach = np.broadcast_to(within, len(swarms.sizes))[swarms.label]
    states, controls = swarms.beside(states), swarms.pushed(controls)
    moved = None if moved is None else swarms.marked(moved)
    motion = states[:, :-1], states[:, 1:, :3], controls, problem.dynamics, problem.time_step
    each = np.arange(controls.shape[1])
    i, j, k = _candidates(*balls(*motion, each), reach, swarms, moved)
    start, end = states[i, k] - states[j, k], states[i, k + 1] - states[j, k + 1]
    push, since = controls[i, k] - controls[j, k], np.zeros(len(k))
    scale, beyond = swarms.asked(i, j)
    motions = Motions(start, end, push, reach[i] + beyond, k, since, scale)
    near, found = closest_to_origin(motions, problem.dynamics, problem.time_step, tolerance)
    found = found.less(beyond, near)
    return Approaches(**vars(found), first=i[near], second=j[near], interval=k[near])


def closest_to_origin(
    motions: Motions, dynamics: Dynamics, h: float, tolerance: float = TOLERANCE
) -> tuple[Indices, Closest]:
    """Which motions may come within their distances in the h s that they take, and when."""
    where = motions.interval, motions.since
    fourth = dynamics.most_fourth_derivative(motions.start, motions.push, *where)
    remainder = h**4 / 384 * fourth
    apart = chord_bound(_scaled(hermite_bezier(motions.start, motions.end, h), motions)) - remainder
    near = np.flatnonzero(apart <= motions.reach)
    if len(near) == 0:
        return near, NOTHING
    motions, remainder = motions[near], remainder[near]
    when, bound = np.zeros((2, len(near)))
    long = remainder > tolerance / 4 * MOST_PARTS**4
    for which, search in ((~long, _closest_in_interval), (long, _closest_in_pieces)):
        if which.any():
            given = motions[which], remainder[which], dynamics, h, tolerance
            when[which], bound[which] = search(*given)
    keep = bound <= motions.reach
    motions, offset, bound = motions[keep], when[keep] * h, bound[keep]
    A, B = dynamics.step(offset, motions.interval, motions.since)
    free, pushed = A[:, :3], B[:, :3]
    relative = np.matvec(free, motions.start) + np.matvec(pushed, motions.push)
    distance = norm(_scaled(relative, motions))
    return near[keep], Closest(offset, np.maximum(distance, bound), bound, free, pushed)


def _scaled(
    points: Float[Array, "rows *some 3"],
    motions: Motions,
    row: Int[Array, "rows"] | slice = slice(None),
) -> Float[Array, "rows *some 3"]:
    """Points of motions in the scaled axes of their distances."""
    if motions.scale is None:
        return points
    return points * motions.scale[row].reshape(len(points), *[1] * (points.ndim - 2), 3)


def _closest_in_interval(
    motions: Motions, remainder: Values, dynamics: Dynamics, h: float, tolerance: float
) -> tuple[Values, Values]:
    """When each motion is closest, as a share of the interval, and a bound on how close.

    Equal parts have exact states at their ends, and cubics between them that are off by no more
    than a quarter of the tolerance. Each motion has its own number of parts, so that results do
    not depend on what is searched beside it.
    """
    parts = np.maximum(1, np.ceil((remainder / (tolerance / 4)) ** 0.25)).astype(int)
    row = np.repeat(np.arange(len(parts)), parts)
    part = np.arange(len(row)) - np.repeat(np.cumsum(parts) - parts, parts)
    many = parts[row]
    start, push = motions.start[row], motions.push[row]
    begin, end = (
        np.matvec(A, start) + np.matvec(B, push)
        for A, B in _at_ends(motions, row, part, many, dynamics, h)
    )
    curve, remainder = hermite_bezier(begin, end, h / many), remainder[row] / many**4
    curve = _scaled(curve, motions, row)
    stretch = part / many, 1.0 / many
    return branch_and_bound(curve, remainder, row, stretch, motions.reach, tolerance / 2)


def _closest_in_pieces(
    motions: Motions, _: Values, dynamics: Dynamics, h: float, tolerance: float
) -> tuple[Values, Values]:
    """The same for intervals of too many parts, by pieces that are searched where they are near."""
    begins = h / MOST_PARTS * np.arange(MOST_PARTS + 1)
    when, bound = np.zeros(len(motions)), np.full(len(motions), np.inf)
    for some in np.array_split(np.arange(len(motions)), 1 + len(motions) // AT_ONCE):
        row, whole = np.repeat(some, MOST_PARTS), motions[some]
        A, B = dynamics.step(begins, whole.interval[:, None], whole.since[:, None])
        states = np.matvec(A, whole.start[:, None]) + np.matvec(B, whole.push[:, None])
        begin, end = states[:, :-1].reshape(-1, 6), states[:, 1:].reshape(-1, 6)
        since = (whole.since[:, None] + begins[:-1]).ravel()
        pushed, reach, interval = motions.push[row], motions.reach[row], motions.interval[row]
        scale = None if motions.scale is None else motions.scale[row]
        pieces = Motions(begin, end, pushed, reach, interval, since, scale)
        near, found = closest_to_origin(pieces, dynamics, h / MOST_PARTS, tolerance)
        np.minimum.at(bound, row[near], found.bound)
        which, k = least_of_each(found.distance, row[near])
        when[which] = near[k] % MOST_PARTS / MOST_PARTS + found.offset[k] / h
    return when, bound


def _at_ends(
    motions: Motions, row: Indices, part: Indices, many: Indices, dynamics: Dynamics, h: float
) -> Iterator[tuple[Float[Array, "_ 6 6"], Float[Array, "_ 6 3"]]]:
    """A and B of some motions to the beginning of a part, of so many, and to its end."""
    table = _steps(dynamics, h, int(many.max()))
    for end in (part, part + 1):
        if table is None:
            yield dynamics.step(h * end / many, motions.interval[row], motions.since[row])
        else:
            A, B, first = table
            at = first[many] + end
            yield A[at], B[at]


@lru_cache(maxsize=64)
def _steps(
    dynamics: Dynamics, h: float, most: int
) -> tuple[Float[Array, "_ 6 6"], Float[Array, "_ 6 3"], Int[Array, "_"]] | None:
    """A and B to the ends of equal parts, for each number of parts, and where its own begin.

    None where intervals have maps of their own.
    """
    if dynamics.step(h, np.arange(1))[0].ndim > 2:
        return None
    share = np.concatenate([np.arange(parts + 1) / max(parts, 1) for parts in range(most + 1)])
    return *dynamics.step(h * share), np.cumsum(np.arange(most + 1))


def _candidates(
    middle: Vector,
    radius: Scalar,
    reach: Float[Array, "craft"],
    swarms: SwarmPartition,
    moved: Marked | None,
) -> Candidates:
    """All pairs and intervals whose balls are within a distance: few compared, many by a tree."""
    if swarms.few:
        i, j = swarms.pairs
        if moved is not None and not moved.all():
            kept = moved[i] | moved[j]
            i, j = i[kept], j[kept]
        apart = swarms.apart(middle[i] - middle[j], i, j)
        k, pair = np.nonzero((apart <= radius[i] + radius[j] + reach[i, None]).T)
        return i[pair], j[pair], k
    i, j, k = _by_tree(middle, radius, float(reach.max()), swarms)
    kept = norm(middle[i, k] - middle[j, k]) <= radius[i, k] + radius[j, k] + reach[i]
    if moved is not None:
        kept &= moved[i] | moved[j]
    i, j, k = i[kept], j[kept], k[kept]
    order = np.lexsort((j, i, k))
    return i[order], j[order], k[order]


def balls(
    start: AnyState,
    end: Vector,
    control: Vector,
    dynamics: Dynamics,
    h: float,
    interval: Indices,
) -> tuple[Vector, Scalar]:
    """Middle and radius of a ball that each craft stays in over the first h s of an interval, m.

    Of states at its start and positions h s later: |p - chord| ≤ h²/8 max|p̈|.
    """
    begin = start[..., :3]
    sag = dynamics.most_acceleration(start, control, h, interval) * h**2 / 8
    return (begin + end) / 2, norm(end - begin) / 2 + sag


def _by_tree(middle: Vector, radius: Scalar, reach: float, swarms: SwarmPartition) -> Candidates:
    """Pairs and intervals whose balls may be near, by one k-d tree with a plane for each."""
    from scipy.spatial import cKDTree  # slow to import, and only large swarms need it

    intervals = radius.shape[1]
    most = 2 * float(radius.max()) + reach
    plane = 2 * most * (np.arange(intervals) + intervals * swarms.label[:, None])
    points = np.concatenate([middle, plane[..., None]], axis=-1).reshape(-1, 4)
    pair = cKDTree(points).query_pairs(most, output_type="ndarray")
    one, other = pair[:, 0], pair[:, 1]
    return one // intervals, other // intervals, one % intervals
