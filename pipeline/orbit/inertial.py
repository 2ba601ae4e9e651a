"""Inertial states from orbital elements, and LVLH frames of the reference orbit."""

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Array, Float
from pipeline.errors import InputError
from pipeline.orbit.arrays import AnyState, Rows, Scalar, Vector, norm
from pipeline.orbit.reference import MU_EARTH

UNDEFINED = 1e-15  # sine of the inclination, or eccentricity, up to which it is rounding of 0


@dataclass(frozen=True)
class Elements:
    """Osculating elements of a two-body orbit about the Earth; angles in rad."""

    semi_major_axis: float  # m
    inclination: float = 0.0  # i
    raan: float = 0.0  # Ω, right ascension of the ascending node
    eccentricity: float = 0.0  # from 0 to below 1
    argument_of_perigee: float = 0.0  # ω, from the ascending node; arbitrary for a circle

    @classmethod
    def of(cls, state: Float[Array, "6"]) -> tuple["Elements", float]:
        """Elements of an inertial state, m and m/s, with angles from 0 to 2π, and u = ω + ν, rad.

        The inverse of ``states``, from the angular momentum h, and e cos ν = p/r - 1,
        e sin ν = ṙ h/μ with p = h²/μ (Curtis, section 4.4). Ω is 0 where the orbit is equatorial
        within rounding, and ω where it is a circle. Close to these cases they are sensitive to the
        state, but all elements together reproduce it. InputError for a state on no closed orbit.
        """
        position, velocity = state[:3], state[3:]
        momentum = np.cross(position, velocity)
        h, r = float(norm(momentum)), float(norm(position))
        parameter = h**2 / MU_EARTH
        e_cos, e_sin = parameter / r - 1, float(position @ velocity) / r * h / MU_EARTH
        eccentricity = float(np.hypot(e_cos, e_sin))
        if not eccentricity < 1:
            raise InputError(
                f"the state {r / 1e3:.6g} km from the Earth's centre at "
                f"{norm(velocity) / 1e3:.6g} km/s has eccentricity {eccentricity:.4g}; expected "
                "one on a closed orbit."
            )
        normal = momentum / h
        tilt = float(np.hypot(normal[0], normal[1]))
        inclination, raan = np.arctan2(tilt, normal[2]), np.arctan2(normal[0], -normal[1])
        node = np.array([-normal[1], normal[0], 0.0])
        if tilt <= UNDEFINED:
            inclination, raan = (0.0 if normal[2] > 0 else np.pi), 0.0
            node = np.array([1.0, 0.0, 0.0])
        latitude = np.arctan2(position @ np.cross(normal, node), position @ node)
        perigee = latitude - np.arctan2(e_sin, e_cos)
        if eccentricity <= UNDEFINED:
            eccentricity, perigee = 0.0, 0.0
        axis = parameter / (1 - eccentricity**2)
        raan, perigee, u = (float(angle % (2 * np.pi)) for angle in (raan, perigee, latitude))
        return cls(axis, float(inclination), raan, eccentricity, perigee), u

    def states(self, argument_of_latitude: Scalar) -> AnyState:
        """Inertial states at u = ω + ν (rad), m and m/s.

        Curtis, "Orbital Mechanics for Engineering Students", sections 2.4 and 4.6.
        """
        u, eccentricity = np.asarray(argument_of_latitude), self.eccentricity
        anomaly = u - self.argument_of_perigee
        parameter = self.semi_major_axis * (1 - eccentricity**2)
        swing = 1 + eccentricity * np.cos(anomaly)
        speed = np.sqrt(MU_EARTH / parameter)
        i, raan = self.inclination, self.raan
        node = np.array([np.cos(raan), np.sin(raan), 0.0])
        ahead = np.array([-np.sin(raan) * np.cos(i), np.cos(raan) * np.cos(i), np.sin(i)])
        cos, sin = np.cos(u)[..., None], np.sin(u)[..., None]
        radial, along = cos * node + sin * ahead, cos * ahead - sin * node
        position = (parameter / swing)[..., None] * radial
        rising = (eccentricity * np.sin(anomaly))[..., None] * radial
        return np.concatenate([position, speed * (rising + swing[..., None] * along)], axis=-1)


@dataclass(frozen=True, eq=False)
class Frame(Rows):
    """LVLH frames of an orbit at some times."""

    axes: Float[Array, "*batch 3 3"]  # radial, along-track and cross-track unit vectors as columns
    rate: Vector  # angular velocity of the frame along these axes, rad/s

    def to_inertial(self, states: Float[Array, "*many 6"]) -> Float[Array, "*more 6"]:
        """Convert LVLH states to inertial axes, relative to the frame's origin, m and m/s."""
        position, velocity = states[..., :3], states[..., 3:]
        moving = velocity + np.cross(self.rate, position)
        both = np.matvec(self.axes, position), np.matvec(self.axes, moving)
        return np.concatenate(both, axis=-1)

    def from_inertial(self, relative: Float[Array, "*many 6"]) -> Float[Array, "*more 6"]:
        """The inverse of ``to_inertial``."""
        position = np.matvec(self.axes.mT, relative[..., :3])
        moving = np.matvec(self.axes.mT, relative[..., 3:])
        return np.concatenate([position, moving - np.cross(self.rate, position)], axis=-1)


def lvlh_axes(origin: AnyState) -> Float[Array, "*batch 3 3"]:
    """Unit vectors along r, h × r and h = r × v of the origin's inertial state, as columns."""
    position, velocity = origin[..., :3], origin[..., 3:]
    momentum = np.cross(position, velocity)
    radial = position / norm(position)[..., None]
    cross = momentum / norm(momentum)[..., None]
    return np.stack([radial, np.cross(cross, radial), cross], axis=-1)


def lvlh_frame(origin: AnyState, acceleration: Vector) -> Frame:
    """LVLH frames of an orbit from the origin's inertial states and its acceleration, m/s².

    The frame rotates about its cross-track axis at h/r², and, where an acceleration aₙ normal to
    the orbital plane turns the plane, about its radial axis at r aₙ/h (Alfriend and others,
    "Spacecraft Formation Flying", section 4.1).
    """
    axes = lvlh_axes(origin)
    position, velocity = origin[..., :3], origin[..., 3:]
    r, h = norm(position), norm(np.cross(position, velocity))
    across = np.vecdot(axes[..., 2], acceleration)
    return Frame(axes, np.stack([r * across / h, np.zeros_like(r), h / r**2], axis=-1))
