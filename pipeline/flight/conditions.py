"""Conditions in which a plan is flown: where the reference orbit is, and what perturbs it."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.errors import InputError, check_range
from pipeline.flight.nonlinear import Drag, NonlinearWorld
from pipeline.flight.perturbations import atmosphere_near
from pipeline.orbit.inertial import Elements
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import R_EARTH, Reference, radius_at

MOST_ECCENTRIC = 0.01
"""Up to which a plan for a circular orbit is flown; bounds on separation hold so far, too."""


MOST_BALLISTIC = 100.0
"""Largest C_D A/m, m²/kg: that of a solar sail."""


@dataclass(frozen=True)
class Conditions:
    """Osculating elements of the reference orbit at the first node, and what perturbs it.

    Its semi-major axis follows from the problem's mean motion. The default is a frozen,
    sun-synchronous orbit.

    Attributes:
        eccentricity: from 0 to MOST_ECCENTRIC.
        inclination_deg: i, deg.
        raan_deg: Ω, deg.
        argument_of_perigee_deg: ω, from the ascending node, deg.
        argument_of_latitude_deg: u, from the ascending node to the origin of the LVLH frame, deg.
        j2: whether the Earth is oblate.
        ballistic: C_D A/m in the middle of the swarm and of the reference, m²/kg, or None for no
            drag.
        spread: by what share of it the first craft has less, and the last one more; those between
            are equally spaced.
    """

    eccentricity: float = 0.001
    inclination_deg: float = 97.4
    raan_deg: float = 0.0
    argument_of_perigee_deg: float = 90.0
    argument_of_latitude_deg: float = 0.0
    j2: bool = True
    ballistic: float | None = None
    spread: float = 0.1

    def __post_init__(self) -> None:
        """Refuse what no reference orbit can be."""
        check_range("eccentricity", self.eccentricity, 0.0, MOST_ECCENTRIC)
        check_range("inclination_deg", self.inclination_deg, 0.0, 180.0)
        for angle in ("raan_deg", "argument_of_perigee_deg", "argument_of_latitude_deg"):
            check_range(angle, getattr(self, angle), -360.0, 360.0)
        check_range("spread", self.spread, 0.0, 1.0)
        if self.ballistic is not None and not 0 < self.ballistic <= MOST_BALLISTIC:
            raise InputError(
                f"ballistic is {self.ballistic:g}; expected a positive C_D A/m in m²/kg, such as "
                f"0.01, of at most {MOST_BALLISTIC:g}."
            )

    def about(self, reference: Reference) -> "Conditions":
        """The same, on an orbit so inclined, with the frame's origin where it is at the epoch."""
        return replace(
            self,
            inclination_deg=reference.inclination_deg,
            raan_deg=reference.raan_deg % 360,
            argument_of_latitude_deg=reference.argument_of_latitude_deg % 360,
        )

    def world(self, problem: Problem, n: int) -> NonlinearWorld:
        """The world that they are, for a problem's swarms of n craft.

        Raises:
            InputError: where the orbit is too low for the model of the air.
        """
        size = radius_at(problem.mean_motion)
        i, raan, perigee, start = np.deg2rad(
            [
                self.inclination_deg,
                self.raan_deg,
                self.argument_of_perigee_deg,
                self.argument_of_latitude_deg,
            ]
        ).tolist()
        elements = Elements(size, i, raan, self.eccentricity, perigee)
        drag = None
        if self.ballistic is not None:
            held = tuple((self.ballistic * self._shares(n)).tolist())
            drag = Drag(atmosphere_near(size - R_EARTH), held, self.ballistic)
        return NonlinearWorld(elements, start, self.j2, drag)

    def _shares(self, n: int) -> Float[Array, "n"]:
        """What each craft has of the middle's ballistic coefficient."""
        return 1 + self.spread * np.linspace(-1, 1, n) if n > 1 else np.ones(1)
