"""The reference orbit by its osculating elements."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.orbit.reference import MU_EARTH


@dataclass(frozen=True)
class Elements:
    """Size, shape and attitude of a two-body orbit about the Earth.

    Angles are in rad and refer to the frame that states are in.

    Attributes:
        semi_major_axis: m.
        inclination: i.
        raan: Ω, right ascension of the ascending node.
        eccentricity: from 0 to below 1.
        argument_of_perigee: ω, from the ascending node; without a meaning where the orbit is a
            circle.
    """

    semi_major_axis: float
    inclination: float = 0.0
    raan: float = 0.0
    eccentricity: float = 0.0
    argument_of_perigee: float = 0.0

    def states(self, argument_of_latitude: Float[Array, "*batch"]) -> Float[Array, "*batch 6"]:
        """Inertial states so far past the ascending node, m and m/s.

        The orbit equation and the velocity along the radius and across it (Curtis, "Orbital
        Mechanics for Engineering Students", sections 2.4 and 4.6).

        Args:
            argument_of_latitude: u = ω + ν, rad.
        """
        u, eccentricity = np.asarray(argument_of_latitude), self.eccentricity
        anomaly = u - self.argument_of_perigee
        parameter = self.semi_major_axis * (1 - eccentricity**2)
        swing = 1 + eccentricity * np.cos(anomaly)
        speed = np.sqrt(MU_EARTH / parameter)
        node, ahead = self._plane()
        cos, sin = np.cos(u)[..., None], np.sin(u)[..., None]
        radial, along = cos * node + sin * ahead, cos * ahead - sin * node
        position = (parameter / swing)[..., None] * radial
        rising = (eccentricity * np.sin(anomaly))[..., None] * radial
        return np.concatenate([position, speed * (rising + swing[..., None] * along)], axis=-1)

    def _plane(self) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
        """Unit vectors to the ascending node and, in the orbital plane, 90° ahead of it."""
        i, raan = self.inclination, self.raan
        node = np.array([np.cos(raan), np.sin(raan), 0.0])
        ahead = np.array([-np.sin(raan) * np.cos(i), np.cos(raan) * np.cos(i), np.sin(i)])
        return node, ahead
