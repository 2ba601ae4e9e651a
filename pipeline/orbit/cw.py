"""The Clohessy-Wiltshire equations in closed form (Eq. 1 and 2 of the paper)."""

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array

MU_EARTH = 398600.4418e9
"""Gravitational parameter of the Earth, m³/s²."""

R_EARTH = 6378137.0
"""Equatorial radius of the Earth, m."""

SERIES_BELOW = 0.1
"""Angle in rad under which θ - sin θ is taken from its series, not from a difference."""


def mean_motion_at(altitude: float) -> float:
    """Mean motion in rad/s of the circular orbit at an altitude in m: e = √(μ/r₀³)."""
    return float(np.sqrt(MU_EARTH / (R_EARTH + altitude) ** 3))


def cw_matrices(
    mean_motion: float, time_step: float | Float[Array, "*batch"]
) -> tuple[Float[Array, "*batch 6 6"], Float[Array, "*batch 6 3"]]:
    """The A and B of s[t+1] = A s[t] + B u[t], Eq. 2, with u constant over the step.

    Closed form (Clohessy and Wiltshire 1960; Curtis, "Orbital Mechanics for Engineering
    Students", section 7.4), written so that nothing is divided by the mean motion: it holds
    down to the double integrator at ``mean_motion`` = 0.

    Args:
        mean_motion: e of the reference circular orbit, rad/s.
        time_step: one step or an array of steps, s.

    Returns:
        A and B for states x y z vx vy vz in m and m/s and accelerations in m/s².
    """
    e, t = mean_motion, np.asarray(time_step, dtype=float)
    theta = np.asarray(e * t)
    sin, cos = np.sin(theta), np.cos(theta)
    half = np.sinc(theta / (2 * np.pi))  # sin(θ/2) / (θ/2)
    s = t * np.sinc(theta / np.pi)  # sin θ / e
    c = 0.5 * (t * half) ** 2  # (1 - cos θ) / e²
    d = t**3 * _cubic_remainder(theta)  # (θ - sin θ) / e³

    A = np.zeros((*t.shape, 6, 6))
    A[..., 0, 0] = 1 + 3 * e**2 * c
    A[..., 0, 3] = A[..., 2, 5] = s
    A[..., 0, 4] = 2 * e * c
    A[..., 1, 0] = -6 * e**3 * d
    A[..., 1, 1] = 1
    A[..., 1, 3] = -2 * e * c
    A[..., 1, 4] = 4 * s - 3 * t
    A[..., 2, 2] = A[..., 3, 3] = A[..., 5, 5] = cos
    A[..., 3, 0] = 3 * e**2 * s
    A[..., 3, 4] = 2 * sin
    A[..., 4, 0] = -6 * e**3 * c
    A[..., 4, 3] = -2 * sin
    A[..., 4, 4] = 4 * cos - 3
    A[..., 5, 2] = -(e**2) * s

    B = np.zeros((*t.shape, 6, 3))
    B[..., 0, 0] = B[..., 2, 2] = c
    B[..., 0, 1] = 2 * e * d
    B[..., 1, 0] = -2 * e * d
    B[..., 1, 1] = 4 * c - 1.5 * t**2
    B[..., 3, 0] = B[..., 5, 2] = s
    B[..., 3, 1] = 2 * e * c
    B[..., 4, 0] = -2 * e * c
    B[..., 4, 1] = 4 * s - 3 * t
    return A, B


def _cubic_remainder(theta: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """(θ - sin θ) / θ³, which a difference of nearly equal numbers would spoil near 0."""
    x = theta**2
    series = (1 - x / 20 * (1 - x / 42 * (1 - x / 72 * (1 - x / 110)))) / 6
    small = np.abs(theta) < SERIES_BELOW
    safe = np.where(small, 1.0, theta)
    return np.where(small, series, (safe - np.sin(safe)) / safe**3)
