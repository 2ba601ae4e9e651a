"""Closest approaches of pairs in relative motion, soundly: nothing is sampled."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from pipeline.arrays import Array
from pipeline.orbit.bezier import branch_and_bound, chord_bound, chord_distance, hermite_bezier
from pipeline.orbit.cw import cw_matrices
from pipeline.orbit.problem import Problem

TOLERANCE = 1e-4
"""Width in m of the bracket in which a least separation is found."""


@dataclass(frozen=True, eq=False)
class Approaches:
    """The closest approach of a pair within an interval, one entry each.

    Attributes:
        row: which row of relative motion.
        interval: which interval.
        offset: time since the interval's start, s.
        distance: separation at that time, m.
        bound: no separation in the interval is below this, m.
    """

    row: Int[Array, "k"]
    interval: Int[Array, "k"]
    offset: Float[Array, "k"]
    distance: Float[Array, "k"]
    bound: Float[Array, "k"]


def close_approaches(
    states: Float[Array, "p T 6"],
    controls: Float[Array, "p intervals 3"],
    problem: Problem,
    within: float,
    tolerance: float = TOLERANCE,
) -> Approaches:
    """All closest approaches, one an interval, that may come within a distance.

    Over an interval the relative position stays within h²/8 max|p̈| of its chord, and most chords
    are too far away to matter. The rest is branch and bound. On a stretch of length h the relative
    position is a cubic Hermite interpolant up to h⁴/384 max|p⁗|, where p⁗ has a bound in closed
    form under Eq. 1 with constant control; and the cubic's squared distance is nowhere below its
    least Bernstein coefficient. So every stretch has a lower bound; stretches that cannot matter
    are dropped, the others split, until the bracket around the minimum is ``tolerance`` wide. No
    pass is fast enough to slip through, since nothing is sampled.

    Args:
        states: relative states of each pair at the nodes, m and m/s.
        controls: relative controls, constant over each interval, m/s².
        problem: mean motion and time step.
        within: distance of interest, m.
        tolerance: width of the bracket [bound, distance], m.

    Returns:
        An entry for each pair and interval whose lower bound is at most ``within``.
    """
    e, h = problem.mean_motion, problem.time_step
    start, end = states[:, :-1], states[:, 1:]
    in_plane, cross = _amplitudes(start, controls, e)
    sag = _acceleration(start, controls, in_plane, cross, e, h) * h**2 / 8
    chord = chord_distance(start[..., :3], end[..., :3])
    row, interval = np.nonzero(chord - sag <= within)
    start, end, push = start[row, interval], end[row, interval], controls[row, interval]
    remainder = h**4 / 384 * e**2 * np.hypot(5**0.5 * in_plane, cross)[row, interval]
    near = np.flatnonzero(chord_bound(hermite_bezier(start, end, h)) - remainder <= within)
    row, interval, start, push = row[near], interval[near], start[near], push[near]
    remainder = remainder[near]
    if len(near) == 0:
        empty = np.zeros(0)
        return Approaches(near, near, empty, empty, empty)
    parts = max(1, int(np.ceil((remainder.max() / (tolerance / 2)) ** 0.25)))
    when, bound = branch_and_bound(
        _exact_parts(start, push, e, h, parts),
        np.repeat(remainder / parts**4, parts),
        parts,
        within,
        tolerance / 2,
    )
    keep = bound <= within
    offset, bound = when[keep] * h, bound[keep]
    A, B = cw_matrices(e, offset)
    relative = np.einsum("kij,kj->ki", A[:, :3], start[keep])
    relative += np.einsum("kij,kj->ki", B[:, :3], push[keep])
    distance = np.maximum(np.linalg.norm(relative, axis=1), bound)
    return Approaches(row[keep], interval[keep], offset, distance, bound)


def _amplitudes(
    start: Float[Array, "*batch 6"], push: Float[Array, "*batch 3"], e: float
) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
    """Amplitudes of ẍ and z̈, which under constant control oscillate at e about 0 by Eq. 1.

    So they bound both for all times, and with them x⁗ = -e² ẍ, |y⁗| ≤ 2e² times the amplitude of
    ẍ, and z⁗ = -e² z̈.
    """
    x, z = start[..., 0], start[..., 2]
    vx, vy, vz = start[..., 3], start[..., 4], start[..., 5]
    in_plane = np.hypot(3 * e**2 * x + 2 * e * vy + push[..., 0], 2 * push[..., 1] - e * vx)
    return in_plane, np.hypot(push[..., 2] - e**2 * z, e * vz)


def _acceleration(
    start: Float[Array, "*batch 6"],
    push: Float[Array, "*batch 3"],
    in_plane: Float[Array, "*batch"],
    cross: Float[Array, "*batch"],
    e: float,
    h: float,
) -> Float[Array, "*batch"]:
    """Bound on the acceleration over an interval: of ẍ and z̈ as above, and ÿ = u - 2e ẋ."""
    along = np.abs(push[..., 1]) + 2 * e * (np.abs(start[..., 3]) + h * in_plane)
    return np.sqrt(in_plane**2 + cross**2 + along**2)


def _exact_parts(
    start: Float[Array, "g 6"], push: Float[Array, "g 3"], e: float, h: float, parts: int
) -> Float[Array, "_ 4 3"]:
    """Each interval cut into equal parts with exact states at their ends, as cubics."""
    A, B = cw_matrices(e, h / parts * np.arange(parts + 1))
    states = np.einsum("qij,gj->gqi", A, start) + np.einsum("qij,gj->gqi", B, push)
    return hermite_bezier(states[:, :-1].reshape(-1, 6), states[:, 1:].reshape(-1, 6), h / parts)
