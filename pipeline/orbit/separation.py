"""How close craft come: at the nodes (Eq. 5) and, soundly, at any time between them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from pipeline.arrays import Array
from pipeline.orbit.cw import cw_matrices
from pipeline.orbit.problem import Problem

TOLERANCE = 1e-4
"""Width in m of the bracket in which a least separation is found."""

MAX_BISECTIONS = 40
"""More than enough: each bisection quarters the error of the bracket."""


def pairs(n: int) -> tuple[Int[Array, "p"], Int[Array, "p"]]:
    """First and second craft of every pair i < j."""
    return np.triu_indices(n, 1)


def node_distances(states: Float[Array, "*batch n T 6"]) -> Float[Array, "*batch p T"]:
    """Distance in m of every pair at every node."""
    i, j = pairs(states.shape[-3])
    return np.linalg.norm(states[..., i, :, :3] - states[..., j, :, :3], axis=-1)


def node_collisions(
    states: Float[Array, "*batch n T 6"], collision_radius: float
) -> Int[Array, "*batch"]:
    """f_col of Eq. 5: pairs and nodes with a distance of at most r_col."""
    return np.asarray((node_distances(states) <= collision_radius).sum(axis=(-2, -1)))


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


@dataclass(frozen=True)
class Separation:
    """The least separation of any pair at any time; infinite where there is no pair.

    Attributes:
        distance: the separation attained, m.
        bound: no pair is ever closer than this, m; at most TOLERANCE below ``distance``.
        pair: the two craft, or None.
        time: when, s since the start, or None.
    """

    distance: float
    bound: float
    pair: tuple[int, int] | None
    time: float | None


def least_separation(
    states: Float[Array, "n T 6"], controls: Float[Array, "n intervals 3"], problem: Problem
) -> Separation:
    """The least distance of any pair at any time of a flown trajectory."""
    i, j = pairs(len(states))
    if len(i) == 0:
        return Separation(np.inf, np.inf, None, None)
    at_nodes = float(node_distances(states).min())
    found = close_approaches(
        states[i] - states[j], controls[i] - controls[j], problem, within=at_nodes
    )
    k = int(found.distance.argmin())
    time = float(found.interval[k] * problem.time_step + found.offset[k])
    pair = (int(i[found.row[k]]), int(j[found.row[k]]))
    return Separation(float(found.distance[k]), float(found.bound.min()), pair, time)


def pair_conflicts(
    states: Float[Array, "n T 6"], controls: Float[Array, "n intervals 3"], problem: Problem
) -> int:
    """Pairs that come within r_col at any time, at nodes or between them."""
    i, j = pairs(len(states))
    radius = problem.collision_radius
    found = close_approaches(states[i] - states[j], controls[i] - controls[j], problem, radius)
    return len(np.unique(found.row))


def close_approaches(
    states: Float[Array, "p T 6"],
    controls: Float[Array, "p intervals 3"],
    problem: Problem,
    within: float,
    tolerance: float = TOLERANCE,
) -> Approaches:
    """All closest approaches, one an interval, that may come within a distance.

    Branch and bound. On a stretch of length h the relative position is a cubic Hermite
    interpolant up to h⁴/384 max|p⁗|, and under Eq. 1 with constant control p⁗ has a bound in
    closed form; the cubic in turn stays within 3/4 of its Bezier points' distance from its
    chord. So every stretch has a lower bound; stretches that cannot matter are dropped, the
    others halved, until the bracket around the minimum is ``tolerance`` wide. No pass is fast
    enough to slip through, since nothing is sampled.

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
    intervals = controls.shape[1]
    start = states[:, :-1].reshape(-1, 6)
    push = controls.reshape(-1, 3)
    bezier = _bezier(start, states[:, 1:].reshape(-1, 6), h)
    remainder = _remainder(start, push, e, h)
    lower, _, _ = _bracket(bezier)
    near = np.flatnonzero(lower - remainder <= within)
    start, push, remainder = start[near], push[near], remainder[near]
    if len(near) == 0:
        empty = np.zeros(0)
        return Approaches(near, near, empty, empty, empty)
    parts = max(1, int(np.ceil((remainder.max() / (tolerance / 2)) ** 0.25)))
    bezier = _exact_parts(start, push, e, h, parts)
    when, bound = _branch_and_bound(
        bezier, np.repeat(remainder / parts**4, parts), parts, within, tolerance / 2
    )
    keep = bound <= within
    near, offset, bound = near[keep], when[keep] * h, bound[keep]
    A, B = cw_matrices(e, offset)
    relative = np.einsum("kij,kj->ki", A[:, :3], start[keep]) + np.einsum(
        "kij,kj->ki", B[:, :3], push[keep]
    )
    distance = np.maximum(np.linalg.norm(relative, axis=1), bound)
    return Approaches(near // intervals, near % intervals, offset, distance, bound)


def _bezier(
    start: Float[Array, "s 6"], end: Float[Array, "s 6"], h: float
) -> Float[Array, "s 4 3"]:
    """Bezier points of the cubic that has the positions and velocities of both ends."""
    p0, p3 = start[:, :3], end[:, :3]
    return np.stack([p0, p0 + h / 3 * start[:, 3:], p3 - h / 3 * end[:, 3:], p3], axis=1)


def _remainder(
    start: Float[Array, "s 6"], push: Float[Array, "s 3"], e: float, h: float
) -> Float[Array, "s"]:
    """Bound on the distance between the motion and its cubic, m.

    By Eq. 1 with constant control ẍ and z̈ oscillate at e about 0, so their amplitudes bound
    them for all times; x⁗ = -e² ẍ, |y⁗| ≤ 2e² times the amplitude of ẍ, z⁗ = -e² z̈.
    """
    x, z = start[:, 0], start[:, 2]
    vx, vy, vz = start[:, 3], start[:, 4], start[:, 5]
    in_plane = np.hypot(3 * e**2 * x + 2 * e * vy + push[:, 0], 2 * push[:, 1] - e * vx)
    cross = np.hypot(push[:, 2] - e**2 * z, e * vz)
    return h**4 / 384 * e**2 * np.sqrt(5 * in_plane**2 + cross**2)


def _exact_parts(
    start: Float[Array, "g 6"], push: Float[Array, "g 3"], e: float, h: float, parts: int
) -> Float[Array, "_ 4 3"]:
    """Each interval cut into equal parts with exact states at their ends, as cubics."""
    A, B = cw_matrices(e, h / parts * np.arange(parts + 1))
    states = np.einsum("qij,gj->gqi", A, start) + np.einsum("qij,gj->gqi", B, push)
    return _bezier(states[:, :-1].reshape(-1, 6), states[:, 1:].reshape(-1, 6), h / parts)


def _bracket(
    bezier: Float[Array, "s 4 3"],
) -> tuple[Float[Array, "s"], Float[Array, "s"], Float[Array, "s"]]:
    """Bounds on the least distance of each cubic from the origin.

    Returns:
        Lower bound, a distance attained, and the parameter in [0, 1] where it is attained.
    """
    p0, p1, p2, p3 = (bezier[:, k] for k in range(4))
    chord = p3 - p0
    length = np.einsum("sk,sk->s", chord, chord)
    s = -np.einsum("sk,sk->s", p0, chord) / np.where(length > 0, length, 1.0)
    s = np.clip(s, 0.0, 1.0)[:, None]
    bend = np.maximum(
        np.linalg.norm(p1 - (2 * p0 + p3) / 3, axis=1),
        np.linalg.norm(p2 - (p0 + 2 * p3) / 3, axis=1),
    )
    lower = np.linalg.norm(p0 + s * chord, axis=1) - 0.75 * bend
    r = 1 - s
    point = r**3 * p0 + 3 * r**2 * s * p1 + 3 * r * s**2 * p2 + s**3 * p3
    return lower, np.linalg.norm(point, axis=1), s[:, 0]


def _halves(bezier: Float[Array, "s 4 3"]) -> Float[Array, "_ 4 3"]:
    """Both halves of each cubic, by de Casteljau, in turn."""
    p0, p1, p2, p3 = (bezier[:, k] for k in range(4))
    p01, p12, p23 = (p0 + p1) / 2, (p1 + p2) / 2, (p2 + p3) / 2
    p012, p123 = (p01 + p12) / 2, (p12 + p23) / 2
    middle = (p012 + p123) / 2
    both = np.stack([p0, p01, p012, middle, middle, p123, p23, p3], axis=1)
    return both.reshape(-1, 4, 3)


def _branch_and_bound(
    bezier: Float[Array, "s 4 3"],
    remainder: Float[Array, "s"],
    parts: int,
    within: float,
    tolerance: float,
) -> tuple[Float[Array, "g"], Float[Array, "g"]]:
    """Where each group of ``parts`` consecutive cubics is closest, and a bound on how close."""
    group = np.repeat(np.arange(len(bezier) // parts), parts)
    left, width = np.tile(np.arange(parts) / parts, len(bezier) // parts), 1.0 / parts
    best = np.full(group[-1] + 1, np.inf)
    when, bound = np.zeros_like(best), np.full_like(best, np.inf)
    for level in range(MAX_BISECTIONS):
        lower, attained, s = _bracket(bezier)
        lower, attained = lower - remainder, attained + remainder
        order = np.argsort(-attained, kind="stable")  # the last write, the least, stays
        order = order[attained[order] < best[group[order]]]
        best[group[order]] = attained[order]
        when[group[order]] = left[order] + width * s[order]
        done = (lower > within) | (lower >= best[group] - 2 * remainder - tolerance)
        if level == MAX_BISECTIONS - 1:
            done[:] = True
        np.minimum.at(bound, group[done], lower[done])
        open_ = ~done
        if not open_.any():
            break
        bezier = _halves(bezier[open_])
        group, remainder = np.repeat(group[open_], 2), np.repeat(remainder[open_], 2)
        width /= 2
        left = np.repeat(left[open_], 2)
        left[1::2] += width
    return when, bound
