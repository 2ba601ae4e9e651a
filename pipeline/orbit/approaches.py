"""Closest approaches of the craft of a swarm, soundly: nothing is sampled."""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from pipeline.arrays import Array
from pipeline.orbit.bezier import branch_and_bound, chord_bound, hermite_bezier, norm
from pipeline.orbit.dynamics import Dynamics
from pipeline.orbit.problem import Problem

TOLERANCE = 1e-4
"""Width in m of the bracket in which a least separation is found."""

PROVABLE = 1.01 * TOLERANCE
"""What a bound must exceed a distance by, m, so that any later bracket's bound exceeds it too:
the width of a bracket, and rounding."""

ROUNDING = 1e-14
"""Share of the largest coordinate that a distance may be off by, with some room."""

MOST_PARTS = 64
"""Parts of an interval that one search looks at; longer intervals are searched piece by piece."""

AT_ONCE = 250
"""Motions of which pieces are looked at, which bounds the memory that it takes."""

FEW, MOST_PAIRS = 128, 300_000
"""Craft of a swarm, and pairs in all, up to which comparing all with all takes less than a tree."""


@dataclass(frozen=True, eq=False)
class Approaches:
    """The closest approach of two craft within an interval, one entry each.

    Attributes:
        first: first craft, the one with the lower index.
        second: second craft.
        interval: which interval.
        offset: time since the interval's start, s.
        distance: separation at that time, m.
        bound: no separation of the two in the interval is below this, m.
        free: from a state at the interval's start to the position then, (k, 3, 6).
        pushed: the same of the control in the interval, (k, 3, 3).
    """

    first: Int[Array, "k"]
    second: Int[Array, "k"]
    interval: Int[Array, "k"]
    offset: Float[Array, "k"]
    distance: Float[Array, "k"]
    bound: Float[Array, "k"]
    free: Float[Array, "k 3 6"]
    pushed: Float[Array, "k 3 3"]


@dataclass(frozen=True)
class Swarms:
    """Swarms side by side in one array of craft, each of which knows its own craft alone.

    Attributes:
        sizes: craft of each swarm.
    """

    sizes: tuple[int, ...]

    @cached_property
    def label(self) -> Int[Array, "n"]:
        """The swarm of each craft."""
        return np.repeat(np.arange(len(self.sizes)), self.sizes)

    @cached_property
    def starts(self) -> Int[Array, "swarms"]:
        """The first craft of each swarm."""
        return np.cumsum((0, *self.sizes[:-1]))

    @property
    def few(self) -> bool:
        """Whether all pairs can be looked at."""
        return max(self.sizes) <= FEW and sum(n * n for n in self.sizes) <= 2 * MOST_PAIRS

    @cached_property
    def pairs(self) -> tuple[Int[Array, "p"], Int[Array, "p"]]:
        """First and second craft of every pair i < j of a swarm."""
        first, second = zip(*(pairs(n) for n in self.sizes), strict=True)
        shift = np.repeat(self.starts, [len(one) for one in first])
        return np.concatenate(first) + shift, np.concatenate(second) + shift


def rounding(states: Float[Array, "*batch 6"]) -> float:
    """What rounding may take off a distance between craft that are at such states, m."""
    return ROUNDING * float(np.abs(states[..., :3]).max())


def least_of_each(
    value: Float[Array, "k"], label: Int[Array, "k"]
) -> tuple[Int[Array, "labels"], Int[Array, "labels"]]:
    """The labels that occur, and where the least value of each is; what is no number is least."""
    order = np.lexsort((np.nan_to_num(value, nan=-np.inf, posinf=np.inf), label))
    occurring, first = np.unique(label[order], return_index=True)
    return occurring, order[first]


@lru_cache(maxsize=64)
def pairs(n: int) -> tuple[Int[Array, "p"], Int[Array, "p"]]:
    """First and second craft of every pair i < j of n craft, not to be written to."""
    both = np.triu_indices(n, 1)
    for one in both:
        one.flags.writeable = False
    return both


@lru_cache(maxsize=64)
def side_by_side(sizes: tuple[int, ...]) -> Swarms:
    """Swarms of some sizes, whose pairs are found once."""
    return Swarms(sizes)


def close_approaches(
    states: Float[Array, "n T 6"],
    controls: Float[Array, "n intervals 3"],
    problem: Problem,
    within: float | Float[Array, "swarms"],
    *,
    swarms: Swarms | None = None,
    moved: Bool[Array, "n"] | None = None,
    tolerance: float = TOLERANCE,
) -> Approaches:
    """All closest approaches, one a pair and interval, that may come within a distance.

    Over an interval each craft stays in a ball about the middle of its chord, and only pairs whose
    balls are near can matter. For those it is branch and bound. On a stretch of length h the
    relative position is a cubic Hermite interpolant up to h⁴/384 max|p⁗|, which the dynamics
    bound; and the cubic's squared distance is nowhere below its least Bernstein coefficient. So
    every stretch has a lower bound; stretches that cannot matter are dropped, the others split,
    until the bracket around the minimum is ``tolerance`` wide. No pass is fast enough to slip
    through, since nothing is sampled.

    Args:
        states: node states, m and m/s.
        controls: constant over each interval, m/s².
        problem: dynamics and time step.
        within: distance of interest, m, of all swarms or of each.
        swarms: which craft belong together; by default all of them.
        moved: leave out pairs of which neither is marked here.
        tolerance: width of the bracket [bound, distance], m.

    Returns:
        An entry for each pair and interval whose lower bound is at most ``within``, by interval,
        first and second craft.
    """
    swarms = swarms or side_by_side((len(states),))
    reach = np.broadcast_to(within, len(swarms.sizes))[swarms.label]
    i, j, k = _candidates(states, controls, problem, reach, swarms, moved)
    start, end = states[i, k] - states[j, k], states[i, k + 1] - states[j, k + 1]
    push = controls[i, k] - controls[j, k]
    h = problem.time_step
    found = passes(start, end, push, problem.dynamics, h, reach[i], tolerance)
    i, j, k = i[found.which], j[found.which], k[found.which]
    closest = found.offset, found.distance, found.bound
    return Approaches(i, j, k, *closest, found.free, found.pushed)


@dataclass(frozen=True, eq=False)
class Passes:
    """Relative motions over an interval, where each is closest to the origin.

    Attributes:
        which: number of the motion among those given.
        offset: time since the interval's start, s.
        distance: from the origin at that time, m.
        bound: the motion is never closer than this, m.
        free: from a state at the interval's start to the position then, (k, 3, 6).
        pushed: the same of the control in the interval, (k, 3, 3).
    """

    which: Int[Array, "k"]
    offset: Float[Array, "k"]
    distance: Float[Array, "k"]
    bound: Float[Array, "k"]
    free: Float[Array, "k 3 6"]
    pushed: Float[Array, "k 3 3"]


def passes(
    start: Float[Array, "s 6"],
    end: Float[Array, "s 6"],
    push: Float[Array, "s 3"],
    dynamics: Dynamics,
    h: float,
    reach: Float[Array, "s"],
    tolerance: float = TOLERANCE,
) -> Passes:
    """The relative motions over an interval that may come within a distance, by branch and bound.

    Args:
        start: relative states at the interval's start, m and m/s.
        end: at its end.
        push: relative controls, m/s².
        dynamics: how craft move.
        h: length of the interval, s.
        reach: distance of interest of each, m.
        tolerance: width of the bracket [bound, distance], m.
    """
    remainder = h**4 / 384 * dynamics.most_fourth_derivative(start, push)
    near = np.flatnonzero(chord_bound(hermite_bezier(start, end, h)) - remainder <= reach)
    if len(near) == 0:
        none, empty = np.zeros(0, dtype=int), np.zeros(0)
        return Passes(none, empty, empty, empty, np.zeros((0, 3, 6)), np.zeros((0, 3, 3)))
    start, push, remainder, reach = start[near], push[near], remainder[near], reach[near]
    when, bound = np.zeros((2, len(near)))
    long = remainder > tolerance / 4 * MOST_PARTS**4
    for which, search in ((~long, _closest_in_interval), (long, _closest_in_pieces)):
        if which.any():
            given = start[which], push[which], remainder[which], reach[which]
            when[which], bound[which] = search(*given, dynamics, h, tolerance)
    keep = bound <= reach
    near, offset, bound = near[keep], when[keep] * h, bound[keep]
    A, B = dynamics.step(offset)
    free, pushed = A[:, :3], B[:, :3]
    relative = np.matvec(free, start[keep]) + np.matvec(pushed, push[keep])
    distance = np.maximum(norm(relative), bound)
    return Passes(near, offset, distance, bound, free, pushed)


def _candidates(
    states: Float[Array, "n T 6"],
    controls: Float[Array, "n intervals 3"],
    problem: Problem,
    reach: Float[Array, "n"],
    swarms: Swarms,
    moved: Bool[Array, "n"] | None,
) -> tuple[Int[Array, "k"], Int[Array, "k"], Int[Array, "k"]]:
    """First craft, second craft and interval of all pairs whose balls are within a distance.

    Few craft are compared all with all. Of many, all swarms and intervals go into one tree: as
    many planes of a fourth dimension, too far apart to meet.
    """
    start, end, h = states[:, :-1], states[:, 1:], problem.time_step
    most = problem.dynamics.most_acceleration(start, controls, h)
    sag = most * h**2 / 8  # |p - chord| ≤ h²/8 max|p̈|
    radius = norm(end[..., :3] - start[..., :3]) / 2 + sag
    middle = (start[..., :3] + end[..., :3]) / 2
    if swarms.few:
        i, j = swarms.pairs
        if moved is not None and not moved.all():
            kept = moved[i] | moved[j]
            i, j = i[kept], j[kept]
        apart = norm(middle[i] - middle[j])
        k, pair = np.nonzero((apart <= radius[i] + radius[j] + reach[i, None]).T)
        return i[pair], j[pair], k
    i, j, k = _by_tree(middle, radius, float(reach.max()), swarms)
    kept = norm(middle[i, k] - middle[j, k]) <= radius[i, k] + radius[j, k] + reach[i]
    if moved is not None:
        kept &= moved[i] | moved[j]
    i, j, k = i[kept], j[kept], k[kept]
    order = np.lexsort((j, i, k))
    return i[order], j[order], k[order]


def _by_tree(
    middle: Float[Array, "n intervals 3"],
    radius: Float[Array, "n intervals"],
    reach: float,
    swarms: Swarms,
) -> tuple[Int[Array, "k"], Int[Array, "k"], Int[Array, "k"]]:
    """First craft, second craft and interval of pairs no further apart than any could be."""
    intervals = radius.shape[1]
    most = 2 * float(radius.max()) + reach
    plane = 2 * most * (np.arange(intervals) + intervals * swarms.label[:, None])
    points = np.concatenate([middle, plane[..., None]], axis=-1).reshape(-1, 4)
    pair = cKDTree(points).query_pairs(most, output_type="ndarray")
    one, other = pair[:, 0], pair[:, 1]
    return one // intervals, other // intervals, one % intervals


def _closest_in_interval(
    start: Float[Array, "g 6"],
    push: Float[Array, "g 3"],
    remainder: Float[Array, "g"],
    reach: Float[Array, "g"],
    dynamics: Dynamics,
    h: float,
    tolerance: float,
) -> tuple[Float[Array, "g"], Float[Array, "g"]]:
    """When a pair is closest, as a share of the interval, and a bound on how close.

    The interval is cut into equal parts with exact states at their ends, so many that the cubics
    between them are near enough: the bracket is twice a part's remainder wide, and what branch
    and bound leaves. Each pair has its own number, so that no other has a say in what is found.
    """
    parts = np.maximum(1, np.ceil((remainder / (tolerance / 4)) ** 0.25)).astype(int)
    row = np.repeat(np.arange(len(parts)), parts)
    part = np.arange(len(row)) - np.repeat(np.cumsum(parts) - parts, parts)
    many = parts[row]
    A, B, first = _steps(dynamics, h, int(many.max()))
    begin, end = (
        np.matvec(A[first[many] + at], start[row]) + np.matvec(B[first[many] + at], push[row])
        for at in (part, part + 1)
    )
    curve = hermite_bezier(begin, end, h / many)
    stretch = part / many, 1.0 / many
    return branch_and_bound(curve, remainder[row] / many**4, row, stretch, reach, tolerance / 2)


def _closest_in_pieces(
    start: Float[Array, "g 6"],
    push: Float[Array, "g 3"],
    _: Float[Array, "g"],
    reach: Float[Array, "g"],
    dynamics: Dynamics,
    h: float,
    tolerance: float,
) -> tuple[Float[Array, "g"], Float[Array, "g"]]:
    """As ``_closest_in_interval``, for intervals that would need too many parts.

    They are cut into pieces, of which only those that may come within the distance are searched.
    """
    A, B = dynamics.step(h / MOST_PARTS * np.arange(MOST_PARTS + 1))
    when, bound = np.zeros(len(start)), np.full(len(start), np.inf)
    for some in np.array_split(np.arange(len(start)), 1 + len(start) // AT_ONCE):
        row = np.repeat(some, MOST_PARTS)
        states = np.matvec(A, start[some, None]) + np.matvec(B, push[some, None])
        ends = states[:, :-1].reshape(-1, 6), states[:, 1:].reshape(-1, 6)
        found = passes(*ends, push[row], dynamics, h / MOST_PARTS, reach[row], tolerance)
        motion, piece = row[found.which], found.which % MOST_PARTS
        np.minimum.at(bound, motion, found.bound)
        which, k = least_of_each(found.distance, motion)
        when[which] = piece[k] / MOST_PARTS + found.offset[k] / h
    return when, bound


@lru_cache(maxsize=64)
def _steps(
    dynamics: Dynamics, h: float, most: int
) -> tuple[Float[Array, "_ 6 6"], Float[Array, "_ 6 3"], Int[Array, "_"]]:
    """How a state moves to the ends of parts, for each number of parts, and where those begin."""
    share = np.concatenate([np.arange(parts + 1) / max(parts, 1) for parts in range(most + 1)])
    A, B = dynamics.step(h * share)
    first = np.cumsum(np.arange(most + 1))
    return A, B, first
