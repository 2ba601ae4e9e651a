"""The circular reference orbit, its epoch and orientation, and constants of the Earth."""

from dataclasses import dataclass
from datetime import UTC, datetime
from math import pi, radians, sqrt
from reprlib import repr as brief

from pipeline.errors import InputError, check_finite, check_range, is_number

MU_EARTH = 398600.4418e9  # gravitational parameter of the Earth, m³/s²
R_EARTH = 6378137.0  # equatorial radius of the Earth, m
J2 = 1.0826266836e-3  # second zonal harmonic of the Earth, of EGM96: -√5 times its normalized C₂₀
# Altitudes in m: below, drag ends an orbit within a revolution; above, the Sun's gravity prevails
LOWEST, HIGHEST = 100e3, 1.5e9
YEARS = (1960, 2200)  # between which epochs are; UTC began in 1960
GEOSTATIONARY = 35_786e3  # altitude in m up to which a message guesses the unit


@dataclass(frozen=True)
class Reference:
    """Epoch and orientation of the reference orbit, whose size the problem has.

    Angles refer to the Earth's mean equator and equinox of J2000 (EME2000).

    Attributes:
        epoch: of the first node; one of another zone is converted to UTC.
        inclination_deg: i, deg.
        raan_deg: Ω, right ascension of the ascending node, deg.
        argument_of_latitude_deg: u, from the node to the LVLH origin at the epoch, deg.
    """

    epoch: datetime
    inclination_deg: float
    raan_deg: float
    argument_of_latitude_deg: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "epoch", utc_epoch(self.epoch))
        check_range("inclination_deg", self.inclination_deg, 0.0, 180.0)
        for name in ("inclination_deg", "raan_deg", "argument_of_latitude_deg"):
            angle = getattr(self, name)
            check_finite(name, angle, "degrees")
            object.__setattr__(self, name, float(angle))


def is_epoch(given: object) -> bool:
    """Whether a value is a date and time with a time zone, in UTC within the accepted years."""
    # Years first, since pandas' missing time has none
    if not isinstance(given, datetime) or not YEARS[0] <= given.year <= YEARS[1]:
        return False
    return given.utcoffset() is not None and YEARS[0] < given.astimezone(UTC).year < YEARS[1]


def utc_epoch(given: datetime) -> datetime:
    """An epoch in UTC; InputError without a time zone, or in a year that is not accepted."""
    if not is_epoch(given):
        raise InputError(
            f"epoch is {given}; expected a datetime with its zone, between {YEARS[0]} and "
            f"{YEARS[1]}: give UTC."
        )
    return given.astimezone(UTC)


def mean_motion_at(altitude: float) -> float:
    """Mean motion, rad/s, of the circular orbit at an altitude, m: e = √(μ/r₀³); or InputError."""
    if LOWEST / 1e3 <= altitude < LOWEST:
        raise InputError(
            f"altitude is {altitude:g} m, where air lets no orbit last; expected at least "
            f"{LOWEST:g} m: if it is in km, give {1e3 * altitude:g}."
        )
    check_range("altitude", altitude, LOWEST, HIGHEST)
    return sqrt(MU_EARTH / (R_EARTH + altitude) ** 3)


def radius_at(mean_motion: float) -> float:
    """Radius in m of the circular orbit with a mean motion in rad/s: r₀ = ∛(μ/e²)."""
    return float((MU_EARTH / mean_motion**2) ** (1 / 3))


def check_mean_motion(mean_motion: float) -> None:
    """Raise InputError for a mean motion, rad/s, of an orbit inside the Earth or its air."""
    most = mean_motion_at(LOWEST)
    if not is_number(mean_motion):
        raise InputError(f"mean_motion is {brief(mean_motion)}; expected a number, in rad/s.")
    if not mean_motion > most:
        return
    hint, slow = "", mean_motion_at(GEOSTATIONARY)
    units = {"revolutions a day": 2 * pi * mean_motion / 86400, "deg/s": radians(mean_motion)}
    for unit, value in units.items():
        if slow / 2 <= value <= most:
            hint = f": if it is in {unit}, give {value:.9g}"
    raise InputError(
        f"mean_motion is {mean_motion:g} rad/s, that of an orbit inside the Earth or its air; "
        f"expected at most {most:.5g} rad/s{hint}."
    )
