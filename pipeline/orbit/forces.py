"""Gravity of the Earth, point mass and J2, and air drag."""

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Array, ArrayOrNumber, Float
from pipeline.errors import InputError
from pipeline.orbit.arrays import AnyState, Scalar, Vector, norm
from pipeline.orbit.reference import J2, MU_EARTH, R_EARTH

EARTH_RATE = 7.292115e-5  # of the Earth's rotation, about the inertial z axis, rad/s

AIR = (
    (150e3, 2.070e-9, 22.523e3),
    (180e3, 5.464e-10, 29.740e3),
    (200e3, 2.789e-10, 37.105e3),
    (250e3, 7.248e-11, 45.546e3),
    (300e3, 2.418e-11, 53.628e3),
    (350e3, 9.518e-12, 53.298e3),
    (400e3, 3.725e-12, 58.515e3),
    (450e3, 1.585e-12, 60.828e3),
    (500e3, 6.967e-13, 63.822e3),
    (600e3, 1.454e-13, 71.835e3),
    (700e3, 3.614e-14, 88.667e3),
    (800e3, 1.170e-14, 124.64e3),
    (900e3, 5.245e-15, 181.05e3),
    (1000e3, 3.019e-15, 268.00e3),
)
"""Base height, m, density there, kg/m³, scale height, m, of mean solar activity (Vallado,
"Fundamentals of Astrodynamics and Applications", exponential model, after Wertz 1978)."""


@dataclass(frozen=True)
class Atmosphere:
    """An exponential atmosphere that rotates with the Earth."""

    base: float  # height of a known density, m
    density: float  # there, kg/m³
    scale: float  # scale height, m

    def density_at(self, height: Float[ArrayOrNumber, "*batch"]) -> Float[ArrayOrNumber, "*batch"]:
        """Density in kg/m³ at heights in m."""
        return self.density * np.exp((self.base - height) / self.scale)


def atmosphere_near(height: float) -> Atmosphere:
    """The layer of AIR at a height in m, extrapolated at both ends; InputError below all layers."""
    if height < AIR[0][0]:
        raise InputError(
            f"the reference orbit is {height / 1e3:.0f} km high; expected at least "
            f"{AIR[0][0] / 1e3:.0f} km for drag: leave drag out."
        )
    return Atmosphere(*max(layer for layer in AIR if layer[0] <= height))


def gravity_gradient(position: Vector, *, j2: bool) -> Float[Array, "*batch 3 3"]:
    """Gradient of gravity by position, 1/s²: of a point mass and, if asked, J2."""
    r, unit = norm(position)[..., None, None], np.eye(3)
    outer = position[..., :, None] * position[..., None, :]
    gradient: Float[Array, "*batch 3 3"] = MU_EARTH * (3 * outer / r**5 - unit / r**3)
    if j2:
        z = position[..., 2:, None]
        pole = np.outer(unit[2], unit[2])
        mixed = position[..., :, None] * unit[2]
        gradient -= (1.5 * J2 * MU_EARTH * R_EARTH**2) * (
            (unit + 2 * pole) / r**5
            - 5 * (outer + z**2 * unit + 2 * z * (mixed + mixed.mT)) / r**7
            + 35 * z**2 * outer / r**9
        )
    return gradient


def point_mass(position: Vector) -> Vector:
    """Gravity of the Earth as a point mass, -μ r/r³, m/s²."""
    return -MU_EARTH / norm(position)[..., None] ** 3 * position


def oblateness(position: Vector) -> Vector:
    """Acceleration by J2, m/s² (Curtis, "Orbital Mechanics for Engineering Students", ch. 10).

    -(3/2) J2 μ R²/r⁵ ((1 - 5 z²/r²) x, (1 - 5 z²/r²) y, (3 - 5 z²/r²) z), with z towards the
    north pole.
    """
    square = np.vecdot(position, position)[..., None]
    pull = -1.5 * J2 * MU_EARTH * R_EARTH**2 / square**2.5
    added: Vector = pull * (1 - 5 * position[..., 2:] ** 2 / square) * position
    added[..., 2:] += 2 * pull * position[..., 2:]
    return added


def drag(states: AnyState, ballistic: Scalar | float, air: Atmosphere) -> Vector:
    """Drag, -½ ρ B |v| v with v relative to the rotating air, m/s², at inertial states, m and m/s.

    B = C_D A/m is the ballistic coefficient, m²/kg; height is above a sphere of the Earth's
    equatorial radius.
    """
    velocity = _through_air(states)
    density = air.density_at(norm(states[..., :3]) - R_EARTH)
    return (-0.5 * density * ballistic * norm(velocity))[..., None] * velocity


def drag_gradient(
    states: AnyState, ballistic: float, air: Atmosphere
) -> Float[Array, "*batch 3 6"]:
    """Derivative of ``drag`` by the state, 1/s² by the position and 1/s by the velocity."""
    position, velocity = states[..., :3], _through_air(states)
    r, speed = norm(position)[..., None, None], norm(velocity)[..., None, None]
    pull = -0.5 * ballistic * air.density_at(r - R_EARTH)
    along = velocity[..., :, None]
    by_velocity = pull * (speed * np.eye(3) + along * velocity[..., None, :] / speed)
    thinner = -pull * speed * along * position[..., None, :] / (r * air.scale)
    return np.concatenate([thinner + by_velocity @ _AIR_TURNS, by_velocity], axis=-1)


# Velocity relative to the air that rotates with the Earth: v + _AIR_TURNS r
_AIR_TURNS = np.array([[0.0, EARTH_RATE, 0.0], [-EARTH_RATE, 0.0, 0.0], [0.0, 0.0, 0.0]])


def _through_air(states: AnyState) -> Vector:
    return states[..., 3:] + states[..., :3] @ _AIR_TURNS.T
