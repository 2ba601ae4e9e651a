"""Cubic Bezier curves, and their least distance from the origin by branch and bound."""

from math import comb

import numpy as np

from pipeline.arrays import Array, Float, Int
from pipeline.orbit.arrays import norm

# Rows are mapped one by one: rounding in a matrix product depends on the number of rows, and no
# plan may depend on what is planned beside it.
MAX_SPLITS = 40  # more than enough: each split at least quarters the error of the bracket
NEWTON_STEPS = 2  # enough to be within rounding of a minimum where motion is nearly uniform
NO_LENGTH = 1e-300  # squared length, m², added so that a chord of length 0 divides nothing by 0
EDGE = 0.02  # share of a cubic: if it is closest this near to an end, it is split in the middle


def _bernstein(degree: int) -> Float[Array, "4 _"]:
    """Coefficients of Bernstein polynomials of a degree up to 3, by powers."""
    found = np.zeros((4, degree + 1))
    for j in range(degree + 1):
        for k in range(degree - j + 1):
            found[j + k, j] = comb(degree, j) * comb(degree - j, k) * (-1) ** k
    return found


CUBIC = _bernstein(3)
# Bernstein coefficients of |c|², degree 6, from the 16 products of c's four Bezier points
SQUARED = np.array(
    [
        [comb(3, i) * comb(3, j) / comb(6, i + j) * (k == i + j) for k in range(7)]
        for i in range(4)
        for j in range(4)
    ]
).T.copy()
# Power coefficients of half the derivative of |c|², from these products
SLOPE = np.array(
    [np.convolve(CUBIC[:, i], CUBIC[1:, j] * [1, 2, 3]) for i in range(4) for j in range(4)]
).T.copy()
DEGREES = np.arange(1.0, 6.0)
# Weights of c's points in the points of both its parts, by powers of the split parameter
PARTS = np.zeros((32, 4))
for _point in range(4):
    PARTS[4 * _point : 5 * _point + 1] = _bernstein(_point).T
    PARTS[16 + 5 * _point : 20 + 4 * _point] = _bernstein(3 - _point).T

# Weights of c's points in those of four equal parts: its blossom at their ends
EQUAL_PARTS = np.zeros((16, 4))
for _part, _point in np.ndindex(4, 4):
    _weights = np.eye(4)
    for _end in [_part + 1] * _point + [_part] * (3 - _point):
        _weights = (1 - _end / 4) * _weights[:-1] + _end / 4 * _weights[1:]
    EQUAL_PARTS[4 * _part + _point] = _weights[0]


def hermite_bezier(
    start: Float[Array, "s 6"], end: Float[Array, "s 6"], h: float | Float[Array, "s"]
) -> Float[Array, "s 4 3"]:
    """Bezier points of the cubic with the positions and velocities of both ends, h s apart."""
    third, curve = np.asarray(h)[..., None] / 3, np.empty((len(start), 4, 3))
    curve[:, 0], curve[:, 3] = start[:, :3], end[:, :3]
    curve[:, 1] = start[:, :3] + third * start[:, 3:]
    curve[:, 2] = end[:, :3] - third * end[:, 3:]
    return curve


def point_on(curve: Float[Array, "s 4 3"], at: Float[Array, "s"]) -> Float[Array, "s 3"]:
    """The point of each cubic at a parameter in [0, 1], by Bernstein polynomials."""
    return np.vecmat(np.matvec(CUBIC.T, np.vander(at, 4, increasing=True)), curve)


def chord_bound(curve: Float[Array, "s 4 3"]) -> Float[Array, "s"]:
    """Quick lower bound on each cubic's distance from the origin, by its chord and its bend."""
    begin, chord = curve[:, 0], curve[:, 3] - curve[:, 0]
    s = _along(begin, chord)[:, None]
    leave, come = 3 * (curve[:, 1] - begin) - chord, 3 * (curve[:, 3] - curve[:, 2]) - chord
    bend = np.maximum(np.vecdot(leave, leave), np.vecdot(come, come))
    return norm(begin + s * chord) - 0.25 * np.sqrt(bend)


def equal_parts(curve: Float[Array, "s 4 3"]) -> Float[Array, "_ 4 3"]:
    """The Bezier points of four equal parts of each cubic, one after the other."""
    return (EQUAL_PARTS @ curve).reshape(-1, 4, 3)


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
    Bernstein coefficients prove at once. Each cubic differs from the motion by at most its
    remainder; brackets are ``tolerance`` wide besides. It is a ``stretch`` of its group's motion,
    begin and width as shares of the whole; stretches farther than ``within`` are dropped.
    """
    left, width = stretch
    best = np.full(len(within), np.inf)
    when, bound = np.zeros(len(within)), best.copy()
    for level in range(MAX_SPLITS):
        s, distance = _closest(curve)
        reached, before = distance + remainder, best.take(group)
        np.minimum.at(best, group, reached)
        least = best.take(group)
        better = ((reached < before) & (reached == least)).nonzero()[0]
        when[group.take(better)] = (left + width * s).take(better)
        at = np.where(np.abs(s - 0.5) < 0.5 - EDGE, s, 0.5)
        curve = _split(curve, at)
        lower = _hull_bound(curve) - remainder[:, None]
        enough = least - 2 * remainder - tolerance
        going = (lower <= within.take(group)[:, None]) & (lower < enough[:, None])
        row, half = going.nonzero()
        if level == MAX_SPLITS - 1 or len(row) == 0:
            np.minimum.at(bound, group, np.minimum(lower[:, 0], lower[:, 1]))
            break
        np.minimum.at(bound, group, np.where(going, np.inf, lower).min(axis=1))
        curve, group, remainder = curve[row, half], group.take(row), remainder.take(row)
        at, share = at.take(row), width.take(row)
        left = left.take(row) + half * share * at
        width = share * np.where(half, 1 - at, at)
    return when, bound


def _closest(curve: Float[Array, "s 4 3"]) -> tuple[Float[Array, "s"], Float[Array, "s"]]:
    """Where in [0, 1] Newton's method finds each cubic closest to the origin, and how close."""
    slope = np.matvec(SLOPE, (curve @ curve.mT).reshape(-1, 16))
    curvature = slope[:, 1:] * DEGREES
    s = _along(curve[:, 0], curve[:, 3] - curve[:, 0])
    for _ in range(NEWTON_STEPS):
        power = np.vander(s, 6, increasing=True)
        bends = np.vecdot(curvature, power[:, :-1])
        # Where the squared distance is not convex, s stays.
        step = np.vecdot(slope, power) / np.where(bends > 0, bends, np.inf)
        s = np.minimum(np.maximum(s - step, 0.0), 1.0)
    return s, norm(point_on(curve, s))


def _along(begin: Float[Array, "s 3"], chord: Float[Array, "s 3"]) -> Float[Array, "s"]:
    """Parameter in [0, 1] at which each chord is closest to the origin."""
    along = -np.vecdot(begin, chord) / (np.vecdot(chord, chord) + NO_LENGTH)
    return np.minimum(np.maximum(along, 0.0), 1.0)


def _split(curve: Float[Array, "s 4 3"], at: Float[Array, "s"]) -> Float[Array, "s 2 4 3"]:
    """Both parts of each cubic, by de Casteljau's weights."""
    weights = np.matvec(PARTS, np.vander(at, 4, increasing=True)).reshape(-1, 8, 4)
    return (weights @ curve).reshape(-1, 2, 4, 3)


def _hull_bound(curve: Float[Array, "s parts 4 3"]) -> Float[Array, "s parts"]:
    """Lower bound on the distance from the origin: the least Bernstein coefficient of |c|²."""
    gram = curve @ curve.mT
    least = np.matvec(SQUARED, gram.reshape(-1, 16)).min(axis=1)
    return np.sqrt(np.maximum(least, 0.0)).reshape(curve.shape[:2])
