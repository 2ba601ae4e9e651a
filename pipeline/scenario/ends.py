"""An end of a scenario file, initial or goal: raw states, or rings of passive relative orbits."""

from typing import Annotated, Any

import numpy as np
from jaxtyping import Float
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    FiniteFloat,
    Tag,
    model_validator,
)

from pipeline.arrays import Array
from pipeline.orbit.rings import pro_states
from pipeline.scenario.scenario import MOST_CRAFT


def _number(given: Any) -> Any:
    """Refuse what only looks like a number: a text in quotes, true and false."""
    if isinstance(given, str | bool):
        raise ValueError("expected a number, without quotes")
    return given


Number = Annotated[FiniteFloat, Field(strict=True)]
Whole = Annotated[int, BeforeValidator(_number)]
Positive = Annotated[Number, Field(gt=0)]
State = Annotated[list[Number], Field(min_length=6, max_length=6)]
States = Annotated[
    list[State],
    Field(min_length=1, description="A state x y z vx vy vz of each craft, LVLH, m and m/s."),
]


class RingDocument(BaseModel):
    """Craft on one passive relative orbit, a 2:1 ellipse that closes by itself.

    x = (size/2) cos θ, y = offset - size sin θ, z = (size/2) tan(tilt) cos(θ + cross phase), with
    the phase θ growing at the mean motion.
    """

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        json_schema_extra={
            "oneOf": [
                {"required": [name], "properties": {name: {"type": kind}}}
                for name, kind in (("craft", "integer"), ("phases_deg", "array"))
            ]
        },
    )

    craft: Annotated[int, Field(ge=1, le=MOST_CRAFT), BeforeValidator(_number)] | None = Field(
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

    def states(self, mean_motion: float) -> Float[Array, "n 6"]:
        """States x y z vx vy vz of its craft in m and m/s, mean motion in rad/s."""
        tilt, cross = np.deg2rad([self.tilt_deg, self.cross_phase_deg])
        return pro_states(
            self.size, float(tilt), self.phase, float(cross), mean_motion, self.offset
        )


class RingsDocument(BaseModel):
    """Craft on one ring or several, numbered ring after ring."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    rings: list[RingDocument] = Field(min_length=1, description="Rings, whose craft follow on.")

    @model_validator(mode="after")
    def _not_too_many(self) -> "RingsDocument":
        if sum(len(ring.phase) for ring in self.rings) > MOST_CRAFT:
            raise ValueError(f"give rings of at most {MOST_CRAFT} craft together")
        return self

    def states(self, mean_motion: float) -> Float[Array, "n 6"]:
        """States x y z vx vy vz of all craft in m and m/s, mean motion in rad/s."""
        return np.concatenate([ring.states(mean_motion) for ring in self.rings])


def _form(given: Any) -> str | None:
    """Which of its forms an end has; parentheses keep it out of the paths in messages."""
    if isinstance(given, list):
        return "(states)"
    return "(rings)" if isinstance(given, dict | RingsDocument) else None


End = Annotated[
    Annotated[States, Tag("(states)")] | Annotated[RingsDocument, Tag("(rings)")],
    Discriminator(
        _form,
        custom_error_type="neither_states_nor_rings",
        custom_error_message='give a list of states, or {"rings": [...]}',
    ),
]
"""Initial or goal states of a scenario file."""


def craft_of(end: list[list[float]] | RingsDocument) -> int:
    """Number of craft of an end."""
    return (
        sum(len(ring.phase) for ring in end.rings) if isinstance(end, RingsDocument) else len(end)
    )


def end_states(end: list[list[float]] | RingsDocument, mean_motion: float) -> Float[Array, "n 6"]:
    """The states of an end in m and m/s, whichever form it has; mean motion in rad/s."""
    return end.states(mean_motion) if isinstance(end, RingsDocument) else np.array(end, dtype=float)
