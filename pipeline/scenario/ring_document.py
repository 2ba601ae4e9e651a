"""Ends of a scenario file: states of each craft, or rings that craft are on."""

from typing import Annotated, Any

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, BeforeValidator, Discriminator, Field, Tag, model_validator

from pipeline.arrays import Array
from pipeline.orbit.arrays import Formation
from pipeline.orbit.problem import Problem
from pipeline.orbit.relative_elements import ring_states
from pipeline.scenario.fields import Number, Positive, States, number, one_of, strict
from pipeline.scenario.scenario import MOST_CRAFT


class RingDocument(BaseModel):
    """Craft on one passive relative orbit, a 2:1 ellipse that closes by itself.

    x = (size/2) cos θ, y = offset - size sin θ, z = (size/2) tan(tilt) cos(θ + cross phase), with
    the phase θ growing at the mean motion. About an orbit that is no circle, or has J2: the bounded
    motion with the same mean relative orbital elements.
    """

    model_config = strict(one_of(craft="integer", phases_deg="array"))

    craft: Annotated[int, Field(ge=1, le=MOST_CRAFT), BeforeValidator(number)] | None = Field(
        None, description="Number of craft, equally spaced in phase."
    )
    first_phase_deg: Number = Field(
        0.0, description="Phase θ of the first of them at the end's time, deg."
    )
    phases_deg: Annotated[list[Number], Field(min_length=1, max_length=MOST_CRAFT)] | None = Field(
        None, description="Instead of both: phase θ of each craft, deg."
    )
    size: Positive = Field(
        description="Semi-major axis: half the ring's along-track extent, its radial one, m."
    )
    tilt_deg: Number = Field(
        0.0, gt=-90, lt=90, description="Tilt of the ring's plane against the orbital plane, deg."
    )
    cross_phase_deg: Number = Field(
        0.0, description="Phase between cross-track and radial motion, deg."
    )
    offset: Number = Field(
        0.0, description="Along-track distance of the ring's centre from the origin, m."
    )

    @model_validator(mode="after")
    def _phases_once(self) -> "RingDocument":
        if (self.craft is None) == (self.phases_deg is None):
            raise ValueError("give one of craft (equally spaced) and phases_deg (of each craft)")
        if self.phases_deg is not None and "first_phase_deg" in self.model_fields_set:
            raise ValueError("first_phase_deg goes with craft; phases_deg has all phases")
        return self

    @property
    def phase(self) -> Float[Array, "n"]:
        """θ of each craft, rad."""
        if self.phases_deg is not None:
            return np.deg2rad(self.phases_deg)
        n = self.craft or 1
        return np.deg2rad(self.first_phase_deg) + 2 * np.pi * np.arange(n) / n

    def states(self, problem: Problem) -> Formation:
        """LVLH states of its craft at the problem's first node, m and m/s."""
        tilt, cross = np.deg2rad([self.tilt_deg, self.cross_phase_deg]).tolist()
        return ring_states(problem, self.size, tilt, self.phase, cross, self.offset)


class RingsDocument(BaseModel):
    """Craft on one ring or several, numbered ring after ring."""

    model_config = strict()

    rings: list[RingDocument] = Field(min_length=1, description="Rings, whose craft follow on.")

    @model_validator(mode="after")
    def _not_too_many(self) -> "RingsDocument":
        if self.n > MOST_CRAFT:
            raise ValueError(f"give rings of at most {MOST_CRAFT} craft together")
        return self

    @property
    def n(self) -> int:
        """Number of craft."""
        return sum(len(ring.phase) for ring in self.rings)


def _form(given: Any) -> str | None:
    """Which of its forms an end has; parentheses keep it out of the paths in messages."""
    if isinstance(given, list):
        return "(states)"
    return "(rings)" if isinstance(given, dict | RingsDocument) else None


# Initial or goal states of a scenario file
End = Annotated[
    Annotated[States, Tag("(states)")] | Annotated[RingsDocument, Tag("(rings)")],
    Discriminator(
        _form,
        custom_error_type="neither_states_nor_rings",
        custom_error_message='give a list of states, or {"rings": [...]}',
    ),
]


def end_states(end: list[list[float]] | RingsDocument, problem: Problem) -> Formation:
    """The states of an end in m and m/s, whichever form it has, at the problem's first node."""
    if isinstance(end, RingsDocument):
        return np.concatenate([ring.states(problem) for ring in end.rings])
    return np.array(end, dtype=float)
