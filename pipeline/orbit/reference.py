"""The reference orbit: a circle about the Earth."""

from dataclasses import dataclass
from datetime import datetime
from math import sqrt

from pipeline.errors import check_range

MU_EARTH = 398600.4418e9
"""Gravitational parameter of the Earth, m³/s²."""

R_EARTH = 6378137.0
"""Equatorial radius of the Earth, m."""


HIGHEST = 1.5e9
"""Of orbits about the Earth, altitude in m: about where the Sun's pull takes over."""


@dataclass(frozen=True)
class Reference:
    """Where and when the reference orbit is; its size follows from the mean motion.

    Angles are in degrees, as they are given, and refer to the Earth's mean equator and equinox of
    J2000 (EME2000).

    Attributes:
        epoch: of the first node, UTC.
        inclination_deg: i, deg.
        raan_deg: Ω, right ascension of the ascending node, deg.
        argument_of_latitude_deg: u, from the ascending node to the origin of the LVLH frame at
            the epoch, deg.
    """

    epoch: datetime
    inclination_deg: float
    raan_deg: float
    argument_of_latitude_deg: float


def mean_motion_at(altitude: float) -> float:
    """Mean motion in rad/s of the circular orbit at an altitude in m: e = √(μ/r₀³).

    Raises:
        InputError: for an altitude that no orbit about the Earth has.
    """
    check_range("altitude", altitude, 0.0, HIGHEST)
    return sqrt(MU_EARTH / (R_EARTH + altitude) ** 3)


def radius_at(mean_motion: float) -> float:
    """Radius in m of the circular orbit with a mean motion in rad/s: r₀ = ∛(μ/e²)."""
    return float((MU_EARTH / mean_motion**2) ** (1 / 3))
