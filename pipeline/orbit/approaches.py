"""Closest approaches of craft by branch and bound, with proven lower bounds and no sampling."""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from pipeline.arrays import Array, Float
from pipeline.orbit.arrays import (
    Controls,
    CraftMask,
    Indices,
    PositionMaps,
    Rows,
    Scalar,
    States,
    Values,
    Vector,
    Vectors,
    norm,
)
from pipeline.orbit.bezier import (
    NO_LENGTH,
    branch_and_bound,
    chord_bound,
    equal_parts,
    hermite_bezier,
)
from pipeline.orbit.dynamics import Dynamics
from pipeline.orbit.partition import (
    MOST_PAIRS,
    Pairs,
    SwarmPartition,
    least_of_each,
    swarm_partition,
)
from pipeline.orbit.problem import Problem

TOLERANCE = 1e-4  # width in m of the bracket in which a least separation is found
# Margin, m: a separation this far above a limit has, in any bracket, a bound above the limit
PROVABLE = 1.01 * TOLERANCE
MOST_PARTS = 64  # parts of an interval in one search; longer intervals are searched piece by piece
AT_ONCE = 250  # motions that are searched in pieces at once, which bounds memory
MANY = 300  # motions or parts from which a prefilter by quick lower bounds pays
TOGETHER = 20_000  # candidates that are searched at once, which bounds memory
PAIRS_AT_ONCE = 20_000  # pairs from a tree that are compared at once, to fit in caches
CHORDS = 4  # per interval, whose midpoints are put in trees: shorter ones have fewer neighbours


@dataclass(frozen=True, eq=False)
class Motions(Rows):
    """Relative motions over an interval of constant control."""

    # state at the end, state at the start, m and m/s, and control, m/s², which with the start
    # determines the motion
    data: Float[Array, "k 15"]
    reach: Values  # scaled distance from the origin within which motions are searched, m
    interval: Indices  # index, from the plan's first node
    since: Values  # start of the motion, s since the interval's start
    scale: Vectors | None = None  # of the axes in which distances count, at most 1

    @property
    def end(self) -> Float[Array, "k 6"]:
        """States at the end of the interval."""
        return self.data[:, :6]

    @property
    def start(self) -> Float[Array, "k 6"]:
        """States at the start of the interval."""
        return self.data[:, 6:12]

    @property
    def control(self) -> Vectors:
        """Controls in the interval."""
        return self.data[:, 12:]

    def at(self, offset: Values, dynamics: Dynamics) -> tuple[PositionMaps, Vectors]:
        """Maps to positions at times since the start, s, and the positions."""
        A, B = dynamics.step(offset, self.interval, self.since)
        free, pushed = A[:, :3], B[:, :3]
        return (free, pushed), np.matvec(free, self.start) + np.matvec(pushed, self.control)


@dataclass(frozen=True, eq=False)
class Closest(Rows):
    """Closest points to the origin of relative motions over an interval."""

    offset: Values  # time since the interval's start, s
    distance: Values  # separation at that time, m; scaled as in ``Participants`` where sizes differ
    bound: Values  # proven lower bound on the separation in the interval, m
    state_map: Float[Array, "k 3 6"]  # map from the state at the interval's start to that position
    control_map: Float[Array, "k 3 3"]  # map from the control in the interval to it

    def reduced_by(self, beyond: Float[Array, "all"], which: Indices) -> "Closest":
        """The approaches with offsets, of which ``which`` gives the indices, subtracted, m."""
        off = beyond[which]
        return replace(self, distance=self.distance - off, bound=self.bound - off)


_EMPTY = np.zeros(0)
NOTHING = Closest(_EMPTY, _EMPTY, _EMPTY, np.zeros((0, 3, 6)), np.zeros((0, 3, 3)))


@dataclass(frozen=True, eq=False)
class Approaches(Closest):
    """Closest approaches of two craft within an interval."""

    first: Indices  # the craft with the lower index or, after a loss of thrust, the drifting one
    second: Indices  # the other craft
    interval: Indices  # index, from the first node; after a loss of thrust also beyond the last
    # at which the first craft lost its thrust; the last node where both are at their goals; or None
    node: Indices | None = None

    def times(self, problem: Problem) -> Values:
        """Times of the approaches, s since the first node."""
        return self.interval * problem.time_step + self.offset


def close_approaches(
    states: States,
    controls: Controls,
    problem: Problem,
    within: float | Float[Array, "swarms"],
    *,
    swarms: SwarmPartition | None = None,
    moved: CraftMask | None = None,
    tolerance: float = TOLERANCE,
) -> Approaches:
    """All closest approaches, one for each pair and interval, that may be within a distance.

    Over an interval each craft stays in a ball about the middle of its chord, and only pairs whose
    balls are near can matter; in large swarms, pairs with near balls about parts of the interval.
    Those are searched by branch and bound. On a stretch of length h the relative position is a
    cubic Hermite interpolant up to h⁴/384 max|p⁗|, which the dynamics bound; and the cubic's
    squared distance is nowhere below its least Bernstein coefficient. So every stretch has a lower
    bound; stretches that cannot be closest are dropped, the others split, until the bracket [bound,
    distance] is ``tolerance`` wide, m.

    The distance ``within``, m, is one for all swarms or one for each; by default there is one
    swarm. Pairs of which neither craft is ``moved`` are skipped. There is an entry for each pair
    and interval whose bound is at most ``within``, by interval, first and second craft.
    """
    swarms = swarms or swarm_partition((len(states),))
    reach = swarms.per_craft(within)
    states, controls = swarms.all_states(states), swarms.all_controls(controls)
    moved = None if moved is None else swarms.participant_mask(moved)
    intervals = controls.shape[1]
    i, j, k = _candidates(states, controls, problem, reach, swarms, moved)
    flown = np.concatenate([states[:, 1:], states[:, :-1], controls], axis=2).reshape(-1, 15)
    found = []
    for begin in range(0, max(len(k), 1), TOGETHER):
        first, second, interval = (each[begin : begin + TOGETHER] for each in (i, j, k))
        relative = flown.take(first * intervals + interval, 0)
        relative -= flown.take(second * intervals + interval, 0)
        scale, beyond = swarms.separation_scaling(first, second)
        within_reach = reach.take(first) + beyond
        motions = Motions(relative, within_reach, interval, np.zeros(len(interval)), scale)
        near, part = closest_to_origin(motions, problem.dynamics, problem.time_step, tolerance)
        part = part.reduced_by(beyond, near)
        who = (each.take(near) for each in (first, second, interval))
        found.append(Approaches(*vars(part).values(), *who))
    return found[0] if len(found) == 1 else Approaches.concatenated(found)


def closest_to_origin(
    motions: Motions, dynamics: Dynamics, h: float, tolerance: float = TOLERANCE
) -> tuple[Indices, Closest]:
    """Motions over h seconds that may come within their reach, and their closest points."""
    where = motions.interval, motions.since
    fourth = dynamics.fourth_derivative_bound(motions.start, motions.control, *where)
    remainder = h**4 / 384 * fourth
    curve = _scaled(hermite_bezier(motions.start, motions.end, h), motions.scale)
    near = (chord_bound(curve) - remainder <= motions.reach).nonzero()[0]
    if len(near) > MANY:
        pieces = chord_bound(equal_parts(curve.take(near, 0))).reshape(len(near), -1).min(axis=1)
        near = near[pieces - remainder.take(near) <= motions.reach.take(near)]
    if len(near) == 0:
        return near, NOTHING
    motions, remainder = motions[near], remainder.take(near)
    long = remainder > tolerance / 4 * MOST_PARTS**4
    if not long.any():
        when, bound = _closest_in_interval(motions, remainder, dynamics, h, tolerance)
    else:
        when, bound = np.zeros((2, len(near)))
        for which, search in ((~long, _closest_in_interval), (long, _closest_in_pieces)):
            if which.any():
                given = motions[which], remainder[which], dynamics, h, tolerance
                when[which], bound[which] = search(*given)
    kept = bound <= motions.reach
    if not kept.all():
        keep = kept.nonzero()[0]
        near, motions, when, bound = near[keep], motions[keep], when[keep], bound[keep]
    offset = when * h
    maps, position = motions.at(offset, dynamics)
    distance = norm(_scaled(position, motions.scale))
    return near, Closest(offset, np.maximum(distance, bound), bound, *maps)


def _scaled(
    points: Float[Array, "rows *some 3"], scale: Float[Array, "rows 3"] | None
) -> Float[Array, "rows *some 3"]:
    """Points in the scaled axes in which distances are measured."""
    if scale is None:
        return points
    return points * scale.reshape(len(points), *[1] * (points.ndim - 2), 3)


def _closest_in_interval(
    motions: Motions, remainder: Values, dynamics: Dynamics, h: float, tolerance: float
) -> tuple[Values, Values]:
    """When each motion is closest, as a share of the interval, and a lower bound on its distance.

    Equal parts have exact states at their ends, and cubics between them that err by no more than a
    quarter of the tolerance. Each motion has its own number of parts, so that results do
    not depend on what is searched beside it.
    """
    parts = np.maximum(1, np.ceil((remainder / (tolerance / 4)) ** 0.25)).astype(int)
    row = np.arange(len(parts)).repeat(parts)
    part = np.arange(len(row)) - (parts.cumsum() - parts).take(row)
    many, each = parts.take(row), motions[row]
    curve = _scaled(_curves(each, part, many, dynamics, h), each.scale)
    remainder = remainder.take(row) / many**4
    if len(row) > MANY:
        near = (chord_bound(curve) - remainder <= each.reach).nonzero()[0]
        curve, remainder, row, part, many = (
            one.take(near, 0) for one in (curve, remainder, row, part, many)
        )
    stretch = part / many, 1.0 / many
    return branch_and_bound(curve, remainder, row, stretch, motions.reach, tolerance / 2)


def _closest_in_pieces(
    motions: Motions, _: Values, dynamics: Dynamics, h: float, tolerance: float
) -> tuple[Values, Values]:
    """As ``_closest_in_interval``, for intervals of too many parts, cut into pieces first."""
    begins = h / MOST_PARTS * np.arange(MOST_PARTS + 1)
    when, bound = np.zeros(len(motions)), np.full(len(motions), np.inf)
    for some in np.array_split(np.arange(len(motions)), 1 + len(motions) // AT_ONCE):
        row, whole = np.repeat(some, MOST_PARTS), motions[some]
        A, B = dynamics.step(begins, whole.interval[:, None], whole.since[:, None])
        states = np.matvec(A, whole.start[:, None]) + np.matvec(B, whole.control[:, None])
        since = (whole.since[:, None] + begins[:-1]).ravel()
        ends = states[:, 1:].reshape(-1, 6), states[:, :-1].reshape(-1, 6)
        flown = np.concatenate([*ends, motions.control[row]], axis=1)
        pieces = replace(motions[row], data=flown, since=since)
        near, found = closest_to_origin(pieces, dynamics, h / MOST_PARTS, tolerance)
        np.minimum.at(bound, row[near], found.bound)
        which, k = least_of_each(found.distance, row[near])
        when[which] = near[k] % MOST_PARTS / MOST_PARTS + found.offset[k] / h
    return when, bound


def _curves(
    motions: Motions, part: Indices, many: Indices, dynamics: Dynamics, h: float
) -> Float[Array, "_ 4 3"]:
    """Bezier points of the cubic of each motion in one of the equal parts of its interval."""
    table = _part_maps(dynamics, h, int(many.max()))
    if table is not None:
        maps = table.take((many - 1) * many // 2 + part, 0)
        return np.matvec(maps, motions.data[:, 6:]).reshape(-1, 4, 3)
    begin, end = (
        np.matvec(A, motions.start) + np.matvec(B, motions.control)
        for A, B in (
            dynamics.step(h * at / many, motions.interval, motions.since) for at in (part, part + 1)
        )
    )
    return hermite_bezier(begin, end, h / many)


@lru_cache(maxsize=64)
def _part_maps(dynamics: Dynamics, h: float, most: int) -> Float[Array, "_ 12 9"] | None:
    """Maps from states and controls to Bezier points in each of 1, 2, … equal parts of an interval.

    None where maps differ between intervals.
    """
    if dynamics.step(h, np.arange(1))[0].ndim > 2:
        return None
    many = np.arange(1, most + 1).repeat(np.arange(1, most + 1))
    part = np.arange(len(many)) - (many - 1) * many // 2
    # Columns of A and B are the motions of unit states and controls.
    begin, end = (
        np.concatenate(dynamics.step(h * at / many), axis=-1).mT.reshape(-1, 6)
        for at in (part, part + 1)
    )
    columns = hermite_bezier(begin, end, h / many.repeat(9)).reshape(-1, 9, 12)
    return np.ascontiguousarray(columns.mT)


def _candidates(
    states: States,
    controls: Controls,
    problem: Problem,
    reach: Float[Array, "craft"],
    swarms: SwarmPartition,
    moved: CraftMask | None,
) -> tuple[Indices, Indices, Indices]:
    """Pairs and intervals in which craft may come near: first craft, second craft, interval."""
    dynamics, h, each = problem.dynamics, problem.time_step, np.arange(controls.shape[1])
    compared = _compared_pairs(swarms, moved)
    if compared is None:
        lines, sag = _chords(states, controls, dynamics, h)
        found = [_by_trees(lines[:, :, k], sag[:, k], reach, swarms, moved) for k in each]
        i, j = (np.concatenate(both) for both in zip(*found, strict=True))
        return i, j, each.repeat([len(first) for first, _ in found])
    i, j = compared
    sag = dynamics.acceleration_bound(states[:, :-1], controls, h, each) * h**2 / 8
    middle, radius = chord_balls(states[:, :-1, :3], states[:, 1:, :3], sag)
    own = radius[: len(reach)] + reach[:, None]  # the first of a pair is a craft
    near = swarms.separations(middle, middle, i, j) <= own.take(i, 0) + radius.take(j, 0)
    k, pair = np.divmod(near.T.ravel().nonzero()[0], len(i))
    return i.take(pair), j.take(pair), k


def _compared_pairs(swarms: SwarmPartition, moved: CraftMask | None) -> Pairs | None:
    """All pairs that contain a moved craft, in order; None where they are too many to compare."""
    if swarms.few:
        i, j = swarms.pairs
        if moved is None or moved.all():
            return i, j
        kept = moved[i] | moved[j]
        return i[kept], j[kept]
    n = len(swarms.label)
    if moved is None or len(swarms.sizes) > 1 or moved.sum() * n > MOST_PAIRS:
        return None
    some = moved.nonzero()[0]
    one, other = some.repeat(n), np.tile(np.arange(n), len(some))
    once = (one < other) | ~moved[other]
    one, other = one[once], other[once]
    return np.divmod(np.sort(n * np.minimum(one, other) + np.maximum(one, other)), n)


def chord_balls(begin: Vector, end: Vector, sag: Scalar) -> tuple[Vector, Scalar]:
    """Centre and radius of a ball about the chord of a motion that strays up to ``sag`` from it, m.

    For h s of constant control |p - chord| ≤ h²/8 max|p̈|.
    """
    return (begin + end) / 2, norm(end - begin) / 2 + sag


def _chords(
    states: States, controls: Controls, dynamics: Dynamics, h: float
) -> tuple[Float[Array, "6 n intervals chords"], Float[Array, "n intervals"]]:
    """Midpoints and half-vectors of each interval's CHORDS chords, and bounds on deviation, m.

    Each chord joins the ends of one of CHORDS equal parts of the interval; its half-vector leads
    from the midpoint to the end. Deviation from uniform motion along it is at most h²/8 max|p̈|.
    """
    each, times = np.arange(controls.shape[1]), h / CHORDS * np.arange(CHORDS + 1)
    A, B = (maps[..., :3, :] for maps in dynamics.step(times, each[:, None]))
    at = np.matvec(A, states[:, :-1, None]) + np.matvec(B, controls[:, :, None])
    sag = dynamics.acceleration_bound(states[:, :-1], controls, h, each) * (h / CHORDS) ** 2 / 8
    begin, end = at[:, :, :-1], at[:, :, 1:]
    lines = np.concatenate([(begin + end) / 2, (end - begin) / 2], axis=-1)
    return lines.transpose(3, 0, 1, 2), sag


def _by_trees(
    lines: Float[Array, "6 n chords"],
    sag: Float[Array, "n"],
    reach: Float[Array, "n"],
    swarms: SwarmPartition,
    moved: CraftMask | None,
) -> tuple[Indices, Indices]:
    """Pairs that may come within a distance in an interval, by k-d trees of its chords' midpoints.

    A fourth coordinate keeps swarms far apart. Most pairs whose balls are near fly side by side,
    so pairs are kept by the distance between their chords at equal times.
    """
    from scipy.spatial import cKDTree  # slow to import, and only large swarms need it

    pairs, n, within = [], len(reach), sag + reach
    # Where few craft moved, their own tree is compared with that of all.
    some = None if moved is None or 2 * moved.sum() > n else moved.nonzero()[0]
    for chord in range(CHORDS):
        line = np.ascontiguousarray(lines[:, :, chord])
        points, size = line[:3].T, norm(line[3:].T) + sag
        most = 2 * float(size.max()) + float(reach.max())
        if len(swarms.sizes) > 1:
            points = np.column_stack([points, 2 * most * swarms.label])
        tree = cKDTree(points)
        if some is None:
            i, j = tree.query_pairs(most, output_type="ndarray").T
        else:
            near = cKDTree(points.take(some, 0)).sparse_distance_matrix(
                tree, most, output_type="ndarray"
            )
            one, other = some.take(near["i"]), near["j"]
            i, j = np.minimum(one, other), np.maximum(one, other)
        for few in range(0, len(i), PAIRS_AT_ONCE):
            one, other = i[few : few + PAIRS_AT_ONCE], j[few : few + PAIRS_AT_ONCE]
            if moved is not None:
                touched = ((moved.take(one) | moved.take(other)) & (one != other)).nonzero()[0]
                one, other = one.take(touched), other.take(touched)
            relative = line.take(one, 1)
            relative -= line.take(other, 1)
            distance = chord_distances(relative[:3], relative[3:])
            near = distance <= within.take(one) + sag.take(other)
            pairs.append((n * one + other)[near])
    found = np.sort(np.concatenate([*pairs, np.zeros(0, dtype=int)]))
    i, j = np.divmod(found[np.diff(found, prepend=-1) > 0], n)  # np.unique takes ten times as long
    return i, j


def chord_distances(gap: Float[Array, "3 *some"], way: Float[Array, "3 *some"]) -> Scalar:
    """Least distance of pairs in uniform motion along their chords, m.

    From the middles and half-vectors of the relative chords. Coordinates are the first axis in the
    computation, which is several times faster.
    """
    length = np.square(way).sum(axis=0) + NO_LENGTH
    gap = gap + np.clip(-(gap * way).sum(axis=0) / length, -1.0, 1.0) * way
    return np.asarray(np.sqrt(np.square(gap).sum(axis=0)))
