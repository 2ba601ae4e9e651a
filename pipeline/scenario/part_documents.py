"""Data models of the parts of a scenario file: orbits, rings, craft, obstacles, waypoints."""

from collections.abc import Mapping
from dataclasses import fields
from datetime import UTC, datetime
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Discriminator, Field, FiniteFloat, Tag, model_validator
from pydantic_core import to_jsonable_python

from pipeline.documents import Strict
from pipeline.errors import InputError, error_context
from pipeline.orbit.arrays import Formation, PerCraft
from pipeline.orbit.corridors import STEEPEST, Box, Cone, Corridor
from pipeline.orbit.participants import Obstacle
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import YEARS, is_epoch
from pipeline.orbit.reference_orbit import MOST_ECCENTRIC, ReferenceOrbit
from pipeline.orbit.rings import ring_states
from pipeline.scenario.scenario import MOST_CRAFT
from pipeline.scenario.waypoint import LATEST, Waypoint

# Of both a reference and an orbit
ANGLES = ("inclination_deg", "raan_deg", "argument_of_latitude_deg")


def one_of(**fields: str) -> dict[str, Any]:
    """JSON Schema's condition that exactly one of some fields is given, each with its JSON type."""
    return {"oneOf": [_all_of({}, **{name: kind}) for name, kind in fields.items()]}


def _all_of(others: Mapping[str, Any], **fields: str | list[str]) -> dict[str, Any]:
    """JSON Schema that requires fields of some types, and others as their schemas say."""
    types = {name: {"type": kind} for name, kind in fields.items()}
    return {"required": [*fields], "properties": {**types, **others}}


def number(given: Any) -> Any:
    """Refuse text and booleans where a number is expected."""
    if isinstance(given, str | bool):
        raise ValueError("expected a number, without quotes")
    return given


def given_fields(value: Any) -> dict[str, Any]:
    """The fields of a dataclass that are not at their defaults, as JSON values."""
    every = {field.name: (getattr(value, field.name), field.default) for field in fields(value)}
    return {name: to_jsonable_python(one) for name, (one, usual) in every.items() if one != usual}


def utc(given: Any) -> datetime:
    """The time, UTC, of an ISO 8601 text; ValueError for one without a zone."""
    try:
        epoch = datetime.fromisoformat(given)
    except (TypeError, ValueError):
        epoch = None
    if epoch is None or not is_epoch(epoch):
        raise ValueError(
            "give date, time and zone by ISO 8601, such as 2026-03-01T12:00:00Z, of a year after "
            f"{YEARS[0]} and before {YEARS[1]}"
        )
    return epoch.astimezone(UTC)


Number = Annotated[FiniteFloat, Field(strict=True)]
Whole = Annotated[int, BeforeValidator(number)]
Positive = Annotated[Number, Field(gt=0)]
State = Annotated[list[Number], Field(min_length=6, max_length=6)]
StateList = Annotated[
    list[State],
    Field(min_length=1, description="A state x y z vx vy vz of each craft, LVLH, m and m/s."),
]
Triple = tuple[Number, Number, Number]
NoBurn = Annotated[
    tuple[tuple[Number, Number], ...],
    Field(description="Stretches of time, from and to, s since the first node, without burns."),
]


class ReferenceDocument(Strict):
    """Epoch and orientation of the reference orbit; mean_motion, altitude or orbit gives its size.

    Angles are those of the orbit, if there is one, and refer to the Earth's mean equator and
    equinox of J2000 (EME2000).
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
    """Eccentric or perturbed reference orbit, with the perturbing forces on all craft.

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


class RingDocument(
    Strict,
    json_schema_extra=one_of(craft="integer", phases_deg="array")
    | {"dependentRequired": {"first_phase_deg": ["craft"]}},
):
    """Craft on one passive relative orbit, a 2:1 ellipse that closes by itself.

    x = (size/2) cos θ, y = offset - size sin θ, z = (size/2) tan(tilt) cos(θ + cross phase), with
    the phase θ growing at the mean motion. About an orbit that is no circle, or has J2: the bounded
    motion with the same mean relative orbital elements.
    """

    craft: Annotated[int, Field(ge=1, le=MOST_CRAFT), BeforeValidator(number)] | None = Field(
        None, description="Number of craft, equally spaced in phase."
    )
    first_phase_deg: Number = Field(0.0, description="Phase θ of the first craft at this end, deg.")
    phases_deg: Annotated[list[Number], Field(min_length=1, max_length=MOST_CRAFT)] | None = Field(
        None, description="Instead of these: phase θ of each craft, deg."
    )
    size: Positive = Field(
        description="Semi-major axis: half the ring's along-track extent, or its radial extent, m."
    )
    tilt_deg: Number = Field(
        0.0,
        gt=-90,
        lt=90,
        description="Tilt, deg: its tangent is the ring's cross-track extent over its radial one. "
        "At a cross phase of 0 it is the angle of the ring's plane to the orbital plane.",
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
    def phase(self) -> PerCraft:
        """θ of each craft, rad."""
        if self.phases_deg is not None:
            return np.deg2rad(self.phases_deg)
        n = self.craft or 1
        return np.deg2rad(self.first_phase_deg) + 2 * np.pi * np.arange(n) / n

    def states(self, problem: Problem) -> Formation:
        """LVLH states of its craft at the problem's first node, m and m/s.

        InputError where the orbit has no relative motion of that size.
        """
        tilt, cross = np.deg2rad([self.tilt_deg, self.cross_phase_deg]).tolist()
        with np.errstate(all="ignore"):
            found = ring_states(problem, self.size, tilt, self.phase, cross, self.offset)
        if not np.isfinite(found).all():
            raise InputError(
                f"a ring has a size of {self.size:g} m and an offset of {self.offset:g} m; "
                "expected both far below the radius of the reference orbit."
            )
        return found


class RingsDocument(Strict):
    """Craft on one ring or several, numbered ring after ring."""

    rings: list[RingDocument] = Field(
        min_length=1, description="Rings, whose craft are numbered one ring after the other."
    )

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
    """The form of an end; parentheses keep it out of the paths in messages."""
    if isinstance(given, list):
        return "(states)"
    return "(rings)" if isinstance(given, dict | RingsDocument) else None


# Initial or goal states of a scenario file
End = Annotated[
    Annotated[StateList, Tag("(states)")] | Annotated[RingsDocument, Tag("(rings)")],
    Discriminator(
        _form,
        custom_error_type="neither_states_nor_rings",
        custom_error_message='give a list of states, or {"rings": [...]}',
    ),
]


def count_of(end: list[list[float]] | RingsDocument) -> int:
    """Number of spacecraft in an initial or goal formation."""
    return end.n if isinstance(end, RingsDocument) else len(end)


def end_states(end: list[list[float]] | RingsDocument, problem: Problem) -> Formation:
    """The states of an end in m and m/s, whichever form it has, at the problem's first node."""
    if isinstance(end, RingsDocument):
        return np.concatenate([ring.states(problem) for ring in end.rings])
    return np.array(end, dtype=float)


class SpacecraftDocument(Strict):
    """One craft, as far as it is not like the others."""

    name: str = Field("", description="Name in files for simulators.")
    mass: Positive | None = Field(None, description="Mass with propellant at the first node, kg.")
    max_acceleration: Positive | None = Field(
        None, description="Its own limit on each component of the control, or thruster, m/s²."
    )
    max_acceleration_norm: Positive | None = Field(
        None, description="Its own limit on the norm of the control, m/s²."
    )
    delta_v: Positive | None = Field(None, description="Total Δv that it may burn, m/s.")
    no_burn: NoBurn = ()
    radius: Positive | None = Field(
        None,
        description="Radius of the sphere that it takes up, m; null for half of collision_radius. "
        "Two craft must be further apart than the sum of their radii.",
    )


class ObstacleDocument(
    Strict,
    json_schema_extra={
        "allOf": [
            one_of(state="array", position="array"),
            one_of(radius="number", semi_axes="array"),
        ]
    },
):
    """A body that craft keep clear of and no plan moves: a chief, a target, debris."""

    name: str = Field(min_length=1, description="Name in messages and certificates.")
    state: State | None = Field(
        None, description="LVLH state at the first node, m and m/s; from there it drifts."
    )
    position: Triple | None = Field(
        None,
        description="Instead: LVLH position where it is held, m; the origin unless about a circle.",
    )
    radius: Positive | None = Field(None, description="Radius of the sphere that it takes up, m.")
    semi_axes: tuple[Positive, Positive, Positive] | None = Field(
        None,
        description="Instead: semi-axes along x, y, z, m, of an ellipsoid that no craft enters.",
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
        given = given_fields(obstacle)
        state = given.pop("state")
        held = {"position": state[:3]} if given.pop("hold", False) else {"state": state}
        return {"name": given.pop("name"), **held, **given}

    def obstacle(self) -> Obstacle:
        """The obstacle."""
        state = (*self.position, 0.0, 0.0, 0.0) if self.position else self.state or ()
        sizes = self.radius, self.semi_axes
        return Obstacle(self.name, tuple(state), *sizes, hold=self.position is not None)


class BoxDocument(Strict):
    """A box along the LVLH axes."""

    min: Triple = Field(description="Least coordinates, LVLH, m.")
    max: Triple = Field(description="Largest coordinates, LVLH, m.")


class ConeDocument(Strict):
    """An approach cone."""

    apex: Triple = Field(description="Apex, LVLH, m.")
    axis: Triple = Field(description="Direction in which it opens, LVLH, of any length.")
    half_angle_deg: Positive = Field(le=STEEPEST, description="Angle between axis and edge, deg.")


class CorridorDocument(Strict, json_schema_extra=one_of(box="object", cone="object")):
    """A corridor: a box or an approach cone that craft must stay inside of for some time."""

    craft: tuple[Whole, ...] | None = Field(
        None, description="Numbers of the craft; null for all.", json_schema_extra={"minItems": 1}
    )
    begin: Number = Field(alias="from", description="From when on, s since the first node.")
    end: Number = Field(alias="to", description="Until when, s since the first node.")
    box: BoxDocument | None = Field(None, description="A box along the axes.")
    cone: ConeDocument | None = Field(None, description="Instead: an approach cone.")

    @model_validator(mode="after")
    def _definite(self) -> "CorridorDocument":
        if (self.box is None) == (self.cone is None):
            raise ValueError("give one of box and cone")
        if self.craft == ():
            raise ValueError("craft is empty; name some, or leave the field out for all")
        return self

    @classmethod
    def of(cls, corridor: Corridor) -> dict[str, Any]:
        """The fields of a corridor."""
        kind = "box" if isinstance(corridor.inside, Box) else "cone"
        whose = {"craft": list(corridor.craft)} if corridor.craft else {}
        inside = given_fields(corridor.inside)
        return {**whose, "from": corridor.begin, "to": corridor.end, kind: inside}

    def corridor(self) -> Corridor:
        """The corridor."""
        given = self.box or self.cone
        assert given is not None  # by ``_definite``
        kind = Box if self.box else Cone
        return Corridor(kind(**given.model_dump()), self.begin, self.end, self.craft or ())


class WaypointDocument(
    Strict,
    json_schema_extra={
        "oneOf": [
            _all_of({"formation": {"type": "null"}}, craft="integer", position="array"),
            _all_of(
                dict.fromkeys(("craft", "position", "velocity"), False),
                formation=["array", "object"],
                time="number",
            ),
        ]
    },
):
    """A place that a craft must pass on its way, at a node, or a formation that all must be in."""

    craft: Annotated[int, Field(ge=0), BeforeValidator(number)] | None = Field(
        None, description="Number of the craft."
    )
    position: Triple | None = Field(None, description="Where it must be, LVLH, m.")
    velocity: Triple | None = Field(None, description="Velocity there, LVLH, m/s; null for any.")
    formation: End | None = Field(
        None, description="Instead of these: where each craft must be, as at the ends."
    )
    time: Positive | None = Field(
        None,
        le=LATEST,
        description="Time of its node, s since the first; null for that of least fuel.",
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
        return None if self.formation is None else count_of(self.formation)

    def waypoints(self, problem: Problem) -> list[Waypoint]:
        """The waypoints of one craft or of all."""
        if self.formation is None:
            assert self.craft is not None
            assert self.position is not None
            return [Waypoint(self.craft, self.position, self.velocity, self.time)]
        node = round((self.time or 0.0) / problem.time_step)
        states = end_states(self.formation, problem.starting_at(node)).tolist()
        return [Waypoint(k, tuple(s[:3]), tuple(s[3:]), self.time) for k, s in enumerate(states)]
