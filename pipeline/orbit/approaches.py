"""Closest approaches of craft by branch and bound, with proven lower bounds and no sampling."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Array, Float, Shaped
from pipeline.orbit.arrays import (
    Controls,
    CraftMask,
    Indices,
    Rows,
    Scalar,
    States,
    Values,
    norm,
)
from pipeline.orbit.closest import closest_of_motions, closest_of_pairs
from pipeline.orbit.dynamics import Dynamics
from pipeline.orbit.partition import (
    MOST_PAIRS,
    Pairs,
    SwarmPartition,
    swarm_partition,
)
from pipeline.orbit.problem import Problem

TOLERANCE = 1e-4  # width in m of the bracket in which a least separation is found
# Margin, m: a separation this far above a limit has, in any bracket, a bound above the limit
PROVABLE = 1.01 * TOLERANCE
TOGETHER = 20_000  # candidates that are searched at once, which bounds memory
PAIRS_AT_ONCE = 20_000  # pairs from a tree that are compared at once, to fit in caches
NO_LENGTH = 1e-300  # squared length, m², added so that a chord of length 0 divides nothing by 0
CHORDS = 4  # per interval, whose midpoints are put in trees: shorter ones have fewer neighbours


@dataclass(frozen=True, eq=False)
class Approaches(Rows):
    """Closest approaches of two craft within an interval."""

    offset: Values  # time since the interval's start, s
    distance: Values  # separation at that time, m; scaled as in ``Participants`` where sizes differ
    bound: Values  # proven lower bound on the separation in the interval, m
    state_map: Float[Array, "k 3 6"]  # map from the state at the interval's start to that position
    control_map: Float[Array, "k 3 3"]  # map from the control in the interval to it
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

    Over an interval each craft stays near its chord, and only pairs with a relative chord near the
    origin can matter; in large swarms, trees find them. These are searched by branch and bound
    (``closest.c``). On a stretch of length h the relative position is a cubic Hermite interpolant
    up to h⁴/384 max|p⁗|, which the dynamics bound; and the cubic's squared distance is nowhere
    below its least Bernstein coefficient. So every stretch has a lower bound; stretches that cannot
    be closest are dropped, the others split, until the bracket [bound, distance] is ``tolerance``
    wide, m.

    The distance ``within``, m, is one for all swarms or one for each; by default there is one
    swarm. Pairs of which neither craft is ``moved`` are skipped. There is an entry for each pair
    and interval whose bound is at most ``within``, by interval, first and second craft.
    """
    swarms = swarms or swarm_partition((len(states),))
    reach = swarms.per_craft(within)
    states, controls = swarms.all_states(states), swarms.all_controls(controls)
    moved = None if moved is None else swarms.participant_mask(moved)
    compared = _compared_pairs(swarms, moved)
    if compared is not None:
        return _of_pairs(states, controls, problem, reach, swarms, compared, tolerance)
    intervals = controls.shape[1]
    i, j, k = _candidates(states, controls, problem, reach, swarms, moved)
    flown = np.concatenate([states[:, :-1], controls], axis=2).reshape(-1, 9)
    found = []
    for begin in range(0, max(len(k), 1), TOGETHER):
        first, second, interval = (each[begin : begin + TOGETHER] for each in (i, j, k))
        relative = flown.take(first * intervals + interval, 0)
        relative -= flown.take(second * intervals + interval, 0)
        who, over = (first, second, interval), (problem.dynamics, problem.time_step)
        found.append(approaches_of_motions(relative, who, reach, swarms, *over, tolerance))
    return found[0] if len(found) == 1 else Approaches.concatenated(found)


def approaches_of_motions(
    motions: Float[Array, "k 9"],
    who: Sequence[Indices],
    reach: Float[Array, "craft"],
    swarms: SwarmPartition,
    dynamics: Dynamics,
    h: float,
    tolerance: float = TOLERANCE,
) -> Approaches:
    """Closest approaches of pairs, over h s, that may be within the reach of the first craft, m.

    Motions are relative states and controls at the starts of intervals, m, m/s and m/s²; ``who``
    are both craft, the interval and, after a loss of thrust, the node.
    """
    first, second, interval = who[:3]
    scale, beyond = swarms.separation_scaling(first, second)
    within, linear = reach.take(first) + beyond, dynamics.linear_motion(interval)
    found = closest_of_motions(linear, motions, interval, h, scale, within, tolerance)
    near = found["index"]
    return _approaches(found, beyond.take(near), *(each.take(near) for each in who))


def _of_pairs(
    states: States,
    controls: Controls,
    problem: Problem,
    reach: Float[Array, "craft"],
    swarms: SwarmPartition,
    pairs: Pairs,
    tolerance: float,
) -> Approaches:
    """As ``close_approaches``, of all of some pairs."""
    (i, j), dynamics, h = pairs, problem.dynamics, problem.time_step
    each = np.arange(controls.shape[1])
    sag = dynamics.acceleration_bound(states[:, :-1], controls, h, each) * h**2 / 8
    flown = np.concatenate([states[:, 1:], states[:, :-1], controls], axis=2)
    scale, beyond = swarms.separation_scaling(i, j)
    within, linear = reach.take(i) + beyond, dynamics.linear_motion(each)
    found = closest_of_pairs(linear, pairs, flown, sag, scale, within, h, tolerance)
    k, pair = np.divmod(found["index"], len(i))
    return _approaches(found, beyond.take(pair), i.take(pair), j.take(pair), k)


def _approaches(found: Shaped[Array, "k"], beyond: Values, *who: Indices) -> Approaches:
    """Approaches of FOUND, with offsets to subtract, m."""
    distance, bound = found["distance"] - beyond, found["bound"] - beyond
    maps = found["state_map"], found["control_map"]
    return Approaches(found["offset"], distance, bound, *maps, *who)


def _candidates(
    states: States,
    controls: Controls,
    problem: Problem,
    reach: Float[Array, "craft"],
    swarms: SwarmPartition,
    moved: CraftMask | None,
) -> tuple[Indices, Indices, Indices]:
    """Pairs and intervals in which craft may come near: first craft, second craft, interval."""
    each = np.arange(controls.shape[1])
    lines, sag = _chords(states, controls, problem.dynamics, problem.time_step)
    found = [_by_trees(lines[:, :, k], sag[:, k], reach, swarms, moved) for k in each]
    i, j = (np.concatenate(both) for both in zip(*found, strict=True))
    return i, j, each.repeat([len(first) for first, _ in found])


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
