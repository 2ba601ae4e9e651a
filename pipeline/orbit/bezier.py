"""Cubic Bezier curves, and their least distance from the origin by branch and bound."""

from math import comb

import numpy as np
from jaxtyping import Float, Int

from pipeline.arrays import Array, ArrayOrNumber

MAX_SPLITS = 40  # more than enough: each split at least quarters the error of the bracket
NEWTON_STEPS = 2  # enough to be within rounding of a minimum where motion is nearly uniform
EDGE = 0.02  # a cubic that is closest this near to an end is halved instead of split there
# Bernstein coefficients of |c|², degree 6, from the 16 products of c's four Bezier points
SQUARED = np.array(
    [
        [comb(3, i) * comb(3, j) / comb(6, i + j) * (k == i + j) for k in range(7)]
        for i in range(4)
        for j in range(4)
    ]
)


def norm(a: Float[Array, "*batch d"]) -> Float[ArrayOrNumber, "*batch"]:
    """Length of vectors."""
    return np.sqrt(np.vecdot(a, a))


def hermite_bezier(
    start: Float[Array, "s 6"], end: Float[Array, "s 6"], h: float | Float[Array, "s"]
) -> Float[Array, "s 4 3"]:
    """Bezier points of the cubic with the positions and velocities of both ends, h s apart."""
    p0, p3 = start[:, :3], end[:, :3]
    third = np.asarray(h)[..., None] / 3
    return np.stack([p0, p0 + third * start[:, 3:], p3 - third * end[:, 3:], p3], axis=1)


def point_on(curve: Float[Array, "s 4 3"], at: Float[Array, "s"]) -> Float[Array, "s 3"]:
    """The point of each cubic at a share of it, by its Bernstein polynomials."""
    t, rest = at[:, None], 1 - at[:, None]
    p0, p1, p2, p3 = curve.transpose(1, 0, 2)
    return rest**3 * p0 + 3 * t * rest**2 * p1 + 3 * t**2 * rest * p2 + t**3 * p3


def chord_bound(curve: Float[Array, "s 4 3"]) -> Float[Array, "s"]:
    """A quick lower bound on each cubic's distance from the origin: its chord's, less the bend."""
    p0, p1, p2, p3 = curve.transpose(1, 0, 2)
    square, product, other = np.vecdot(p0, p0), np.vecdot(p0, p3), np.vecdot(p3, p3)
    length = square + other - 2 * product
    s = np.clip((square - product) / np.where(length > 0, length, 1.0), 0.0, 1.0)
    chord = np.sqrt(np.maximum(square + s * (s * length - 2 * (square - product)), 0.0))
    bend = np.maximum(norm(p1 - (2 * p0 + p3) / 3), norm(p2 - (p0 + 2 * p3) / 3))
    return chord - 0.75 * bend


def branch_and_bound(
    curve: Float[Array, "s 4 3"],
    remainder: Float[Array, "s"],
    group: Int[Array, "s"],
    stretch: tuple[Float[Array, "s"], Float[Array, "s"]],
    within: Float[Array, "g"],
    tolerance: float,
) -> tuple[Float[Array, "g"], Float[Array, "g"]]:
    """When each group of cubics is closest to the origin, and a lower bound on that distance.

    Cubics are split where they are closest: on either side |c|² then mostly grows, which its
    Bernstein coefficients prove at once. Each cubic is off by at most its remainder, beside which
    brackets are ``tolerance`` wide, and is a stretch of a group's motion, which begins and is as
    long as such shares of it; stretches beyond their group's distance of interest are dropped.
    """
    left, width = stretch
    best = np.full(len(within), np.inf)
    when, bound = np.zeros_like(best), np.full_like(best, np.inf)
    for level in range(MAX_SPLITS):
        s, distance = _closest(curve)
        reached = distance + remainder
        order = np.argsort(-reached, kind="stable")  # the last write, the least, stays
        order = order[reached[order] < best[group[order]]]
        best[group[order]] = reached[order]
        when[group[order]] = (left + width * s)[order]
        at = np.where((s > EDGE) & (s < 1 - EDGE), s, 0.5)
        curve = _split(curve, at)
        group, remainder = np.repeat(group, 2), np.repeat(remainder, 2)
        left = np.stack([left, left + width * at], axis=1).ravel()
        width = np.stack([width * at, width * (1 - at)], axis=1).ravel()
        lower = _hull_bound(curve) - remainder
        done = (lower > within[group]) | (lower >= best[group] - 2 * remainder - tolerance)
        if level == MAX_SPLITS - 1:
            done[:] = True
        np.minimum.at(bound, group[done], lower[done])
        rest = ~done
        if not rest.any():
            break
        curve, group, remainder = curve[rest], group[rest], remainder[rest]
        left, width = left[rest], width[rest]
    return when, bound


def _closest(curve: Float[Array, "s 4 3"]) -> tuple[Float[Array, "s"], Float[Array, "s"]]:
    """Where in [0, 1] Newton's method finds each cubic closest to the origin, and how close."""
    p0, p1, p2, p3 = curve.transpose(1, 0, 2)
    a1, a2, a3 = 3 * (p1 - p0), 3 * (p2 - 2 * p1 + p0), p3 - 3 * p2 + 3 * p1 - p0
    chord = p3 - p0
    length = np.vecdot(chord, chord)
    s = np.clip(-np.vecdot(p0, chord) / np.where(length > 0, length, 1.0), 0.0, 1.0)
    for _ in range(NEWTON_STEPS):
        r = s[:, None]
        c = p0 + r * (a1 + r * (a2 + r * a3))
        v = a1 + r * (2 * a2 + 3 * r * a3)
        slope, curvature = np.vecdot(c, v), np.vecdot(v, v) + np.vecdot(c, 2 * a2 + 6 * r * a3)
        convex = curvature > 0
        s = np.clip(s - np.where(convex, slope / np.where(convex, curvature, 1.0), 0.0), 0.0, 1.0)
    r = s[:, None]
    return s, norm(p0 + r * (a1 + r * (a2 + r * a3)))


def _split(curve: Float[Array, "s 4 3"], at: Float[Array, "s"]) -> Float[Array, "_ 4 3"]:
    """Both parts of each cubic, in turn, by de Casteljau."""
    t = at[:, None]
    p0, p1, p2, p3 = curve.transpose(1, 0, 2)
    p01, p12, p23 = p0 + t * (p1 - p0), p1 + t * (p2 - p1), p2 + t * (p3 - p2)
    p012, p123 = p01 + t * (p12 - p01), p12 + t * (p23 - p12)
    middle = p012 + t * (p123 - p012)
    both = np.stack([p0, p01, p012, middle, middle, p123, p23, p3], axis=1)
    return both.reshape(-1, 4, 3)


def _hull_bound(curve: Float[Array, "s 4 3"]) -> Float[Array, "s"]:
    """Lower bound on the distance from the origin: the least Bernstein coefficient of |c|²."""
    gram = curve @ curve.transpose(0, 2, 1)
    least = (gram.reshape(-1, 16) @ SQUARED).min(axis=1)
    return np.sqrt(np.maximum(least, 0.0))
