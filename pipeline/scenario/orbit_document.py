"""Reference orbits in scenario files: a circle's orientation and epoch, or any orbit and forces."""

from datetime import datetime
from typing import Annotated

from pydantic import BeforeValidator, Field

from pipeline.documents import Strict
from pipeline.errors import InputError, error_context
from pipeline.orbit.reference_orbit import MOST_ECCENTRIC, ReferenceOrbit
from pipeline.scenario.fields import Number, Positive, utc

# Of both a reference and an orbit
ANGLES = ("inclination_deg", "raan_deg", "argument_of_latitude_deg")


class ReferenceDocument(Strict):
    """Epoch and orientation of the reference orbit; mean_motion or altitude gives its size.

    The orbit is circular. Angles refer to the Earth's mean equator and equinox of J2000 (EME2000).
    """

    epoch: Annotated[datetime, BeforeValidator(utc)] = Field(
        description="Time of the first node by ISO 8601 with a zone, such as 2026-03-01T12:00:00Z."
    )
    inclination_deg: Number = Field(ge=0, le=180, description="Inclination, deg.")
    raan_deg: Number = Field(description="Right ascension of the ascending node, deg.")
    argument_of_latitude_deg: Number = Field(
        description="From the ascending node to the LVLH frame's origin at the epoch, deg."
    )


class OrbitDocument(Strict):
    """A reference orbit that is no circle or has perturbations, with the forces on all craft.

    Osculating elements at the first node. Angles refer to the Earth's mean equator and equinox of
    J2000 (EME2000).
    """

    semi_major_axis: Positive = Field(description="Semi-major axis, m.")
    eccentricity: Number = Field(0.0, ge=0, le=MOST_ECCENTRIC, description="Eccentricity.")
    inclination_deg: Number = Field(0.0, ge=0, le=180, description="Inclination, deg.")
    raan_deg: Number = Field(0.0, description="Right ascension of the ascending node, deg.")
    argument_of_perigee_deg: Number = Field(0.0, description="Argument of perigee, deg.")
    argument_of_latitude_deg: Number = Field(
        0.0, description="From the ascending node to the LVLH frame's origin, deg."
    )
    j2: bool = Field(True, strict=True, description="Whether the Earth is oblate.")
    ballistic: Positive | None = Field(
        None, description="Mean C_D A/m of the swarm, m²/kg; null for no drag."
    )
    spread: Number = Field(
        0.0, description="Relative spread of C_D A/m: first craft less, last more than the mean."
    )

    @classmethod
    def of(cls, orbit: ReferenceOrbit) -> "OrbitDocument":
        """The fields of an orbit; InputError for one whose plan begins after its epoch."""
        if orbit.start:
            raise InputError(
                f"the orbit's start is {orbit.start:g} s after its epoch; expected elements at the "
                "first node: give those."
            )
        return cls(**{name: getattr(orbit, name) for name in cls.model_fields})

    def orbit(self) -> ReferenceOrbit:
        """The orbit."""
        with error_context("orbit"):
            return ReferenceOrbit(**self.model_dump())
