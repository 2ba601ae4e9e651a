"""Closest approaches of the craft of a swarm, soundly: nothing is sampled."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from pipeline.arrays import Array
from pipeline.orbit.bezier import branch_and_bound, chord_bound, hermite_bezier, norm
from pipeline.orbit.problem import Problem

TOLERANCE = 1e-4
"""Width in m of the bracket in which a least separation is found."""

PROVABLE = 1.01 * TOLERANCE
"""What a bound must exceed a distance by, m, so that any later bracket's bound exceeds it too:
the width of a bracket, and rounding."""

FEW = 50
"""Craft up to which comparing all with all takes less time than a tree."""


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
    """

    first: Int[Array, "k"]
    second: Int[Array, "k"]
    interval: Int[Array, "k"]
    offset: Float[Array, "k"]
    distance: Float[Array, "k"]
    bound: Float[Array, "k"]


@lru_cache(maxsize=64)
def pairs(n: int) -> tuple[Int[Array, "p"], Int[Array, "p"]]:
    """First and second craft of every pair i < j, not to be written to."""
    both = np.triu_indices(n, 1)
    for one in both:
        one.flags.writeable = False
    return both


def close_approaches(
    states: Float[Array, "n T 6"],
    controls: Float[Array, "n intervals 3"],
    problem: Problem,
    within: float,
    *,
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
        within: distance of interest, m.
        moved: leave out pairs of which neither is marked here.
        tolerance: width of the bracket [bound, distance], m.

    Returns:
        An entry for each pair and interval whose lower bound is at most ``within``, by interval,
        first and second craft.
    """
    dynamics, h = problem.dynamics, problem.time_step
    i, j, k = _candidates(states, controls, problem, within)
    if moved is not None and not moved.all():
        kept = moved[i] | moved[j]
        i, j, k = i[kept], j[kept], k[kept]
    start, end = states[i, k] - states[j, k], states[i, k + 1] - states[j, k + 1]
    push = controls[i, k] - controls[j, k]
    remainder = h**4 / 384 * dynamics.most_fourth_derivative(start, push)
    near = np.flatnonzero(chord_bound(hermite_bezier(start, end, h)) - remainder <= within)
    if len(near) == 0:
        none, empty = np.zeros(0, dtype=int), np.zeros(0)
        return Approaches(none, none, none, empty, empty, empty)
    start, push, remainder = start[near], push[near], remainder[near]
    # The bracket is twice a part's remainder wide, and what branch and bound leaves.
    parts = max(1, int(np.ceil((remainder.max() / (tolerance / 4)) ** 0.25)))
    when, bound = branch_and_bound(
        _exact_parts(start, push, problem, parts),
        np.repeat(remainder / parts**4, parts),
        parts,
        within,
        tolerance / 2,
    )
    keep = bound <= within
    near, offset, bound = near[keep], when[keep] * h, bound[keep]
    A, B = dynamics.step(offset)
    relative = np.einsum("kij,kj->ki", A[:, :3], start[keep])
    relative += np.einsum("kij,kj->ki", B[:, :3], push[keep])
    distance = np.maximum(np.linalg.norm(relative, axis=1), bound)
    return Approaches(i[near], j[near], k[near], offset, distance, bound)


def _candidates(
    states: Float[Array, "n T 6"],
    controls: Float[Array, "n intervals 3"],
    problem: Problem,
    within: float,
) -> tuple[Int[Array, "k"], Int[Array, "k"], Int[Array, "k"]]:
    """First craft, second craft and interval of all pairs whose balls are within a distance.

    Few craft are compared all with all. Of many, all intervals go into one tree: as many planes of
    a fourth dimension, too far apart to meet.
    """
    h = problem.time_step
    n, intervals = controls.shape[:2]
    start, end = states[:, :-1], states[:, 1:]
    most = problem.dynamics.most_acceleration(start, controls, h)
    sag = most * h**2 / 8  # |p - chord| ≤ h²/8 max|p̈|
    radius = norm(end[..., :3] - start[..., :3]) / 2 + sag
    middle = (start[..., :3] + end[..., :3]) / 2
    if n <= FEW:
        i, j = pairs(n)
        apart = norm(middle[i] - middle[j])
        k, pair = np.nonzero((apart <= radius[i] + radius[j] + within).T)
        return i[pair], j[pair], k
    radius = radius.ravel()
    reach = 2 * float(radius.max()) + within
    plane = np.broadcast_to(2 * reach * np.arange(intervals)[:, None], (n, intervals, 1))
    middle = np.concatenate([middle, plane], axis=-1).reshape(-1, 4)
    pair = cKDTree(middle).query_pairs(reach, output_type="ndarray")
    one, other = pair[:, 0], pair[:, 1]
    apart = norm(middle[one] - middle[other])
    one, other = pair[apart <= radius[one] + radius[other] + within].T
    i, j, k = one // intervals, other // intervals, one % intervals
    order = np.lexsort((j, i, k))
    return i[order], j[order], k[order]


def _exact_parts(
    start: Float[Array, "g 6"], push: Float[Array, "g 3"], problem: Problem, parts: int
) -> Float[Array, "_ 4 3"]:
    """Each interval cut into equal parts with exact states at their ends, as cubics."""
    A, B = _steps(problem, parts)
    states = np.einsum("qij,gj->gqi", A, start) + np.einsum("qij,gj->gqi", B, push)
    ends = states[:, :-1].reshape(-1, 6), states[:, 1:].reshape(-1, 6)
    return hermite_bezier(*ends, problem.time_step / parts)


@lru_cache(maxsize=64)
def _steps(problem: Problem, parts: int) -> tuple[Float[Array, "_ 6 6"], Float[Array, "_ 6 3"]]:
    """How a state moves to the ends of the parts of an interval."""
    return problem.dynamics.step(problem.time_step / parts * np.arange(parts + 1))
