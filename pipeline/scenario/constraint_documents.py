"""What a scenario file says of single craft, obstacles, corridors and waypoints."""

from dataclasses import asdict
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, Field, TypeAdapter, model_validator

from pipeline.orbit.corridors import STEEPEST, Box, Cone, Corridor
from pipeline.orbit.participants import Obstacle
from pipeline.orbit.problem import Problem
from pipeline.scenario.fields import (
    NoBurn,
    Number,
    Positive,
    State,
    Triple,
    Whole,
    number,
    one_of,
    strict,
)
from pipeline.scenario.ring_document import End, RingsDocument, end_states
from pipeline.scenario.spacecraft import Spacecraft
from pipeline.scenario.waypoint import Waypoint


class SpacecraftDocument(BaseModel):
    """One craft, as far as it is not like the others."""

    model_config = strict()

    name: str = Field("", description="In files for simulators.")
    mass: Positive | None = Field(None, description="With propellant, at the first node, kg.")
    max_acceleration: Positive | None = Field(
        None, description="Its own limit on each component of the control, or thruster, m/s²."
    )
    max_acceleration_norm: Positive | None = Field(
        None, description="Its own limit on the norm of the control, m/s²."
    )
    delta_v: Positive | None = Field(None, description="What it may burn in all, m/s.")
    no_burn: NoBurn = ()
    radius: Positive | None = Field(
        None,
        description="Of the sphere that it takes up, m; null for half of collision_radius. Two "
        "craft must be further apart than both radii.",
    )

    @classmethod
    def of(cls, craft: Spacecraft) -> dict[str, Any]:
        """The fields of a craft, without those that are as of all."""
        given = TypeAdapter(Spacecraft).dump_python(craft, mode="json", exclude_defaults=True)
        return cls(**given).model_dump(exclude_unset=True)

    def craft(self) -> Spacecraft:
        """The craft."""
        return Spacecraft(**self.model_dump())


class ObstacleDocument(BaseModel):
    """What craft keep clear of and no plan moves: a chief, a target, debris, a dead craft."""

    model_config = strict(
        {
            "allOf": [
                one_of(state="array", position="array"),
                one_of(radius="number", semi_axes="array"),
            ]
        }
    )

    name: str = Field(min_length=1, description="What messages and certificates call it.")
    state: State | None = Field(
        None, description="At the first node, LVLH, m and m/s, of one that drifts."
    )
    position: Triple | None = Field(
        None, description="Instead: where it is held, LVLH, m; about a circle, or at the origin."
    )
    radius: Positive | None = Field(None, description="Of the sphere that it takes up, m.")
    semi_axes: tuple[Positive, Positive, Positive] | None = Field(
        None, description="Instead: of the ellipsoid along x, y, z that no part of a craft enters."
    )

    @model_validator(mode="after")
    def _one_of_each(self) -> "ObstacleDocument":
        if (self.state is None) == (self.position is None):
            raise ValueError("give one of state (it drifts) and position (it is held there)")
        if (self.radius is None) == (self.semi_axes is None):
            raise ValueError("give one of radius and semi_axes, m")
        return self

    @classmethod
    def of(cls, obstacle: Obstacle) -> dict[str, Any]:
        """The fields of an obstacle."""
        held = {"position": obstacle.state[:3]} if obstacle.hold else {"state": obstacle.state}
        size = {"radius": obstacle.radius, "semi_axes": obstacle.semi_axes}
        sized = {name: list(one) if isinstance(one, tuple) else one for name, one in size.items()}
        given = {name: one for name, one in sized.items() if one is not None}
        return {"name": obstacle.name, **{name: list(one) for name, one in held.items()}, **given}

    def obstacle(self) -> Obstacle:
        """The obstacle."""
        state = (*self.position, 0.0, 0.0, 0.0) if self.position else self.state or ()
        sizes = self.radius, self.semi_axes
        return Obstacle(self.name, tuple(state), *sizes, hold=self.position is not None)


class BoxDocument(BaseModel):
    """A box along the LVLH axes."""

    model_config = strict()

    min: Triple = Field(description="Least coordinates, LVLH, m.")
    max: Triple = Field(description="Largest coordinates, LVLH, m.")


class ConeDocument(BaseModel):
    """An approach cone."""

    model_config = strict()

    apex: Triple = Field(description="LVLH, m.")
    axis: Triple = Field(description="Direction in which it opens, LVLH, of any length.")
    half_angle_deg: Positive = Field(le=STEEPEST, description="Between axis and edge, deg.")


class CorridorDocument(BaseModel):
    """A corridor: a box or an approach cone that craft must stay inside of for some time."""

    model_config = strict(one_of(box="object", cone="object"))

    craft: tuple[Whole, ...] = Field((), description="Their numbers; all where none is given.")
    begin: Number = Field(alias="from", description="From when on, s since the first node.")
    end: Number = Field(alias="to", description="Until when, s since the first node.")
    box: BoxDocument | None = Field(None, description="A box along the axes.")
    cone: ConeDocument | None = Field(None, description="Instead: an approach cone.")

    @model_validator(mode="after")
    def _one_of_both(self) -> "CorridorDocument":
        if (self.box is None) == (self.cone is None):
            raise ValueError("give one of box and cone")
        return self

    @classmethod
    def of(cls, corridor: Corridor) -> dict[str, Any]:
        """The fields of a corridor."""
        kind = "box" if isinstance(corridor.inside, Box) else "cone"
        inside = {
            name: list(one) if isinstance(one, tuple) else one
            for name, one in asdict(corridor.inside).items()
        }
        whose = {"craft": list(corridor.craft)} if corridor.craft else {}
        return {**whose, "from": corridor.begin, "to": corridor.end, kind: inside}

    def corridor(self) -> Corridor:
        """The corridor."""
        given = self.box or self.cone
        assert given is not None  # by ``_one_of_both``
        kind = Box if self.box else Cone
        return Corridor(kind(**given.model_dump()), self.begin, self.end, self.craft)


class WaypointDocument(BaseModel):
    """A place that a craft must pass on its way, at a node, or a formation that all must be in."""

    model_config = strict()

    craft: Annotated[int, Field(ge=0), BeforeValidator(number)] | None = Field(
        None, description="Number of the craft."
    )
    position: Triple | None = Field(None, description="Where it must be, LVLH, m.")
    velocity: Triple | None = Field(None, description="LVLH, m/s; null for any.")
    formation: End | None = Field(
        None, description="Instead of these: where each craft must be, as at the ends."
    )
    time: Positive | None = Field(
        None, description="Of the node, s since the first; null for that of least fuel."
    )

    @model_validator(mode="after")
    def _one_or_all(self) -> "WaypointDocument":
        if self.formation is None and None in (self.craft, self.position):
            raise ValueError("give craft and position, or a formation")
        if self.formation is not None:
            if not self.model_fields_set <= {"formation", "time"}:
                raise ValueError("a formation is of all craft; leave craft, position, velocity out")
            if self.time is None:
                raise ValueError("a formation is at one time; give it a time")
        return self

    @property
    def n(self) -> int | None:
        """Number of craft of a formation."""
        if self.formation is None:
            return None
        end = self.formation
        return end.n if isinstance(end, RingsDocument) else len(end)

    def waypoints(self, problem: Problem) -> list[Waypoint]:
        """The waypoints of one craft or of all."""
        if self.formation is None:
            assert self.craft is not None
            assert self.position is not None
            return [Waypoint(self.craft, self.position, self.velocity, self.time)]
        node = round((self.time or 0.0) / problem.time_step)
        states = end_states(self.formation, problem.starting_at(node)).tolist()
        return [Waypoint(k, tuple(s[:3]), tuple(s[3:]), self.time) for k, s in enumerate(states)]
