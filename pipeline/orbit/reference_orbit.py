"""The reference orbit of relative motion: osculating elements, and the forces on all craft."""

from dataclasses import dataclass, replace
from functools import lru_cache
from math import degrees, pi, radians, sqrt
from reprlib import repr as brief
from typing import Any

import numpy as np

from pipeline.arrays import Array, Float, as_lists, fields_as_python
from pipeline.errors import InputError, check_finite, check_range, check_vector
from pipeline.orbit import forces
from pipeline.orbit.arrays import AnyState, PerCraft, Scalar, Values, Vector, norm
from pipeline.orbit.chebyshev import COEFFICIENTS, INTEGRAL, ITERATIONS, POINTS, ROUNDING, basis
from pipeline.orbit.inertial import Elements, Frame, lvlh_frame
from pipeline.orbit.mean_elements import mean_states, osculating_states
from pipeline.orbit.reference import HIGHEST, LOWEST, MU_EARTH, R_EARTH

MOST_ECCENTRIC = 0.85
MOST_TURNS = 10_000  # revolutions after the epoch by which a plan begins
MOST_BALLISTIC = 100.0  # largest C_D A/m, m²/kg: that of a solar sail
ROUNDED = 1e-6  # s by which a time may be before the first node
PIECE = 0.15  # angle by which the local circular orbit turns in a piece of the reference, rad


def check_elements(of: Any) -> None:
    """Raise InputError for elements or drag out of range, in fields of an orbit or conditions."""
    check_range("eccentricity", of.eccentricity, 0.0, MOST_ECCENTRIC)
    check_range("inclination_deg", of.inclination_deg, 0.0, 180.0)
    for angle in ("raan_deg", "argument_of_perigee_deg", "argument_of_latitude_deg"):
        check_range(angle, getattr(of, angle), -360.0, 360.0)
    check_drag(of.ballistic, of.spread)


def check_drag(
    ballistic: float | None, spread: float, names: tuple[str, str] = ("ballistic", "spread")
) -> None:
    """Raise InputError for drag out of range; ``names`` name both values in the message."""
    check_range(names[1], spread, 0.0, 1.0)
    if ballistic is None:
        return
    check_finite(names[0], ballistic, "m²/kg")
    if not 0 < ballistic <= MOST_BALLISTIC:
        raise InputError(
            f"{names[0]} is {ballistic:g}; expected a positive C_D A/m in m²/kg, such as 0.01, "
            f"of at most {MOST_BALLISTIC:g}."
        )


@dataclass(frozen=True)
class ReferenceOrbit:
    """Osculating elements of the reference at an epoch, what perturbs it, and when a plan begins.

    The reference is a virtual craft that never burns. It is subject to the same forces as all
    craft, with the swarm's mean drag coefficient, so craft have differential drag relative to it.
    Angles refer to the Earth's equator.

    Attributes:
        semi_major_axis: m.
        eccentricity: from 0 to 0.85.
        inclination_deg: i, deg.
        raan_deg: Ω, right ascension of the ascending node, deg.
        argument_of_perigee_deg: ω, from the ascending node, deg.
        argument_of_latitude_deg: u = ω + ν at the epoch, deg.
        j2: whether J2 acts.
        ballistic: C_D A/m of the reference, the swarm's mean, m²/kg, or None for no drag.
        spread: relative spread of C_D A/m, linear over the craft: the first has less, the last
            more.
        start: time of the first node, s since the epoch.
    """

    semi_major_axis: float
    eccentricity: float = 0.0
    inclination_deg: float = 0.0
    raan_deg: float = 0.0
    argument_of_perigee_deg: float = 0.0
    argument_of_latitude_deg: float = 0.0
    j2: bool = True
    ballistic: float | None = None
    spread: float = 0.0
    start: float = 0.0

    def __post_init__(self) -> None:
        fields_as_python(self)
        check_elements(self)
        check_finite("semi_major_axis", self.semi_major_axis, "metres")
        perigee = self.semi_major_axis * (1 - self.eccentricity) - R_EARTH
        if not LOWEST <= perigee <= HIGHEST:
            raise InputError(
                f"semi_major_axis is {self.semi_major_axis:g} m and eccentricity "
                f"{self.eccentricity:g}, a perigee {perigee:g} m above the Earth; expected one "
                f"from {LOWEST:g} to {HIGHEST:g} m."
            )
        if self.ballistic is None and self.spread:
            raise InputError(
                f"spread is {self.spread:g} without ballistic, of which it is a share; expected "
                "both: add ballistic, such as 0.01, or leave spread out."
            )
        if self.ballistic is not None:
            forces.atmosphere_near(perigee)  # InputError below all layers
        check_range("start", self.start, 0.0, MOST_TURNS * 2 * pi / self.mean_motion)

    @classmethod
    def through(
        cls,
        state: Float[Array, "6"],
        *,
        j2: bool = True,
        ballistic: float | None = None,
        spread: float = 0.0,
    ) -> "ReferenceOrbit":
        """The orbit through an inertial state, m and m/s, by its osculating elements."""
        check_vector("state", as_lists(state), 6)
        if not any(state[:3]):
            raise InputError("state is at the Earth's centre; expected one on a closed orbit.")
        found, u = Elements.of(np.array(state, dtype=float))
        return cls(
            semi_major_axis=found.semi_major_axis,
            eccentricity=found.eccentricity,
            inclination_deg=degrees(found.inclination),
            raan_deg=degrees(found.raan),
            argument_of_perigee_deg=degrees(found.argument_of_perigee),
            argument_of_latitude_deg=degrees(u),
            j2=j2,
            ballistic=ballistic,
            spread=spread,
        )

    @classmethod
    def of_mean(cls, **fields: Any) -> "ReferenceOrbit":
        """The orbit with the given mean elements at the epoch, u = ω + ν among them.

        Mean elements are osculating ones without their short-period variations by J2, if any.
        """
        mean = cls(**fields)
        if not mean.j2:
            return mean
        state = osculating_states(mean.begin[None])[0]
        made = cls.through(state, ballistic=mean.ballistic, spread=mean.spread)
        return replace(made, start=mean.start)

    @property
    def mean_elements(self) -> Elements:
        """Mean elements at the epoch; angles in rad."""
        return Elements.of(mean_states(self.begin[None], j2=self.j2)[0])[0]

    @property
    def begin(self) -> Float[Array, "6"]:
        """Inertial state at the epoch, m and m/s."""
        angles = self.inclination_deg, self.raan_deg, self.argument_of_perigee_deg
        i, raan, perigee = map(radians, angles)
        elements = Elements(self.semi_major_axis, i, raan, self.eccentricity, perigee)
        return elements.states(np.array(radians(self.argument_of_latitude_deg)))

    @property
    def mean_motion(self) -> float:
        """Mean motion of the osculating orbit, rad/s."""
        return sqrt(MU_EARTH / self.semi_major_axis**3)

    @property
    def fastest(self) -> float:
        """Angular rate at perigee, rad/s: √(μ a (1-e²)) / (a (1-e))²."""
        e = self.eccentricity
        return self.mean_motion * (1 + e) ** 0.5 / (1 - e) ** 1.5

    @property
    def air(self) -> forces.Atmosphere:
        """The layer of the atmosphere at the perigee."""
        return forces.atmosphere_near(self.semi_major_axis * (1 - self.eccentricity) - R_EARTH)

    def later(self, time: float) -> "ReferenceOrbit":
        """The same orbit for a plan that begins a time, s, later."""
        return replace(self, start=self.start + time)

    def ballistics(self, n: int) -> PerCraft:
        """Ballistic coefficient of each of n craft, m²/kg; zero without drag."""
        if self.ballistic is None:
            return np.zeros(n)
        shares = np.linspace(-1, 1, n) if n > 1 else np.zeros(1)
        return self.ballistic * (1 + self.spread * shares)

    def acceleration(self, states: AnyState, ballistic: Scalar | float) -> Vector:
        """Acceleration by all forces but thrust at inertial states, m/s²; ballistic in m²/kg."""
        position = states[..., :3]
        total = forces.point_mass(position)
        if self.j2:
            total += forces.oblateness(position)
        if self.ballistic is not None:
            total += forces.drag(states, ballistic, self.air)
        return total

    def gradient(self, states: AnyState) -> Float[Array, "*batch 3 6"]:
        """Derivative of the acceleration by the state, with the mean ballistic coefficient."""
        by_position = forces.gravity_gradient(states[..., :3], j2=self.j2)
        gradient = np.concatenate([by_position, np.zeros_like(by_position)], axis=-1)
        if self.ballistic is not None:
            gradient += forces.drag_gradient(states, self.ballistic, self.air)
        return gradient

    def states(self, times: Values) -> Float[Array, "k 6"]:
        """Inertial states, m and m/s, at times from 0 on, s since the first node."""
        if not (np.isfinite(times).all() and np.min(times, initial=0.0) >= -ROUNDED):
            raise InputError(f"times are {brief(times)}; expected finite ones from 0 on, in s.")
        ascending, place = np.unique(self.start + times, return_inverse=True)
        return _states(self, tuple(ascending.tolist()))[place]

    def frames(self, times: Scalar) -> tuple[AnyState, Frame]:
        """Inertial states at times from 0 on, s since the first node, and the LVLH frames there."""
        origin = self.states(times.ravel()).reshape(*times.shape, 6)
        return origin, lvlh_frame(origin, self.acceleration(origin, self.ballistic or 0.0))


@lru_cache(maxsize=32)
def _states(orbit: ReferenceOrbit, times: tuple[float, ...]) -> Float[Array, "k 6"]:
    """Inertial states at ascending times, s since the epoch, by Chebyshev-Picard integration."""
    wanted, found = np.array(times), np.empty((len(times), 6))
    state, lost, begin, done = orbit.begin, np.zeros(6), 0.0, 0
    while done < len(wanted):
        half = PIECE / 2 * sqrt(float(norm(state[:3])) ** 3 / MU_EARTH)
        with np.errstate(over="ignore", invalid="ignore"):  # as a decaying orbit raises InputError
            moved = _piece(orbit, state, half)
        inside = slice(done, int(np.searchsorted(wanted, begin + 2 * half, side="right")))
        along = basis((wanted[inside] - begin) / half - 1) @ COEFFICIENTS
        found[inside] = state + along @ moved
        # Compensated summation (Kahan): rounding errors would reach micrometres on eccentric
        # orbits.
        step = moved[-1] + lost
        done, begin, before, state = inside.stop, begin + 2 * half, state, state + step
        lost = step - (state - before)
    return found


def _piece(orbit: ReferenceOrbit, start: Float[Array, "6"], half: float) -> Float[Array, "q 6"]:
    """Change of the inertial state in a piece of 2 ``half`` s, by Chebyshev-Picard iteration."""
    moved, held, integral = np.zeros((POINTS, 6)), orbit.ballistic or 0.0, half * INTEGRAL
    for _ in range(ITERATIONS):
        before = moved[:, :3]
        faster = integral @ orbit.acceleration(start + moved, held)
        further = integral @ (start[3:] + faster)
        moved = np.concatenate([further, faster], axis=1)
        if np.abs(further - before).max() <= ROUNDING * norm(start[:3]):
            return moved
    raise InputError(
        "the reference orbit could not be flown on from where it is "
        f"{(norm(start[:3]) - R_EARTH) / 1e3:.0f} km high; expected one that drag leaves above "
        "the Earth: begin higher, give a smaller ballistic, or plan for less time."
    )
