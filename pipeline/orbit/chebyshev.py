"""Polynomials through Chebyshev-Lobatto points: their integrals, derivatives and bounds."""

from math import ceil
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev

from pipeline.arrays import Array, Float, like

POINTS = 12  # collocation points of a piece, both ends included
CUBICS = 8  # into which a piece is cut, so that they err by micrometres
ANGLE = 0.25  # largest angle by which the reference turns in a piece, rad
ITERATIONS = 40  # at most, of Picard's method: each integrates the forces at the last positions
ROUNDING = 1e-14  # share of the largest position: smaller changes are convergence
# On [-1, 1], ascending
NODES = -np.cos(np.pi * np.arange(POINTS) / (POINTS - 1))
# From values at the points to Chebyshev coefficients, and to those of derivatives by their order
COEFFICIENTS = np.linalg.inv(chebyshev.chebvander(NODES, POINTS - 1))
DERIVATIVES = {order: chebyshev.chebder(COEFFICIENTS, order) for order in (1, 2, 3)}
# From values at the points to those of the integral from the first point
INTEGRAL = chebyshev.chebvander(NODES, POINTS) @ chebyshev.chebint(COEFFICIENTS, lbnd=-1)


def pieces_of(angle: float) -> int:
    """Number of pieces, at least one, for motion while the reference turns by an angle, rad."""
    return max(1, ceil(angle / ANGLE))


def basis(at: Float[Array, "*batch"]) -> Float[Array, "*batch q"]:
    """Values of the Chebyshev polynomials at arguments in [-1, 1]."""
    return chebyshev.chebvander(at.ravel(), POINTS - 1).reshape(*at.shape, POINTS)


def derivative_bound(
    values: Float[Any, "*batch q d"], order: int, half: float
) -> Float[Any, "*batch d"]:
    """Upper bound on a derivative over a piece of 2 ``half`` s, from values (array or tensor)."""
    # Absolute coefficients are added up, since no Chebyshev polynomial exceeds 1.
    found = abs(like(DERIVATIVES[order], values) @ values).sum(axis=-2)
    return found / half**order
