"""The reference orbit: a circle about the Earth."""

from math import sqrt

MU_EARTH = 398600.4418e9
"""Gravitational parameter of the Earth, m³/s²."""

R_EARTH = 6378137.0
"""Equatorial radius of the Earth, m."""


def mean_motion_at(altitude: float) -> float:
    """Mean motion in rad/s of the circular orbit at an altitude in m: e = √(μ/r₀³)."""
    return sqrt(MU_EARTH / (R_EARTH + altitude) ** 3)
