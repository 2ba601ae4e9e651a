"""scenario.json (schema prolearn.scenario/1): read with an answer to every mistake, and written."""

from collections.abc import Mapping
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

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
    TypeAdapter,
    model_validator,
)

from pipeline.arrays import Array
from pipeline.documents import DIALECT, document_from, read_document, write_document
from pipeline.errors import InputError
from pipeline.files import stem_of
from pipeline.orbit.arrays import Formation
from pipeline.orbit.corridors import STEEPEST, Box, Cone, Corridor
from pipeline.orbit.participants import Obstacle
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import Reference, mean_motion_at
from pipeline.orbit.reference_orbit import MOST_ECCENTRIC, ReferenceOrbit
from pipeline.orbit.relative_elements import ring_states
from pipeline.orbit.thrust import Objective, Thrust
from pipeline.scenario.scenario import MOST_CRAFT, Ends, Scenario
from pipeline.scenario.spacecraft import Spacecraft
from pipeline.scenario.validation import check
from pipeline.scenario.waypoint import Waypoint

SCHEMA = "prolearn.scenario/1"
WHAT = f"a scenario file (schema {SCHEMA})"
YEARS = (1960, 2200)  # of an epoch: since there is UTC, and no further than anyone plans


def _one_of(**fields: str) -> dict[str, Any]:
    """JSON Schema's condition that of some fields with their types there is exactly one."""
    forms = [
        {"required": [name], "properties": {name: {"type": kind}}} for name, kind in fields.items()
    ]
    return {"oneOf": forms}


def _strict(more: dict[str, Any] | None = None) -> ConfigDict:
    """Pydantic's settings: no unknown keys, and perhaps a condition for the schema."""
    return ConfigDict(extra="forbid", frozen=True, json_schema_extra=more)


def _number(given: Any) -> Any:
    """Refuse what only looks like a number: a text in quotes, true and false."""
    if isinstance(given, str | bool):
        raise ValueError("expected a number, without quotes")
    return given


def utc(given: Any) -> datetime:
    """The UTC of an epoch as files have it; ValueError for one without a zone."""
    try:
        epoch = datetime.fromisoformat(given)
    except (TypeError, ValueError):
        epoch = None
    if epoch is None or epoch.tzinfo is None or not YEARS[0] < epoch.year < YEARS[1]:
        raise ValueError("give date, time and zone by ISO 8601, such as 2026-03-01T12:00:00Z")
    return epoch.astimezone(UTC)


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
    the phase θ growing at the mean motion. About an orbit that is no circle, or has J2: the bounded
    motion with the same mean relative orbital elements.
    """

    model_config = _strict(_one_of(craft="integer", phases_deg="array"))

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

    def states(self, problem: Problem) -> Formation:
        """LVLH states of its craft at the problem's first node, m and m/s."""
        tilt, cross = np.deg2rad([self.tilt_deg, self.cross_phase_deg]).tolist()
        return ring_states(problem, self.size, tilt, self.phase, cross, self.offset)


class RingsDocument(BaseModel):
    """Craft on one ring or several, numbered ring after ring."""

    model_config = _strict()

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


def _end_states(end: list[list[float]] | RingsDocument, problem: Problem) -> Formation:
    """The states of an end in m and m/s, whichever form it has, at the problem's first node."""
    if isinstance(end, RingsDocument):
        return np.concatenate([ring.states(problem) for ring in end.rings])
    return np.array(end, dtype=float)


class ReferenceDocument(BaseModel):
    """Where and when the reference orbit is; its size follows from mean_motion or altitude.

    The orbit is circular. Angles refer to the Earth's mean equator and equinox of J2000 (EME2000).
    """

    model_config = _strict()

    epoch: Annotated[datetime, BeforeValidator(utc)] = Field(
        description="Time of the first node by ISO 8601 with a zone, such as 2026-03-01T12:00:00Z."
    )
    inclination_deg: Number = Field(ge=0, le=180, description="Inclination, deg.")
    raan_deg: Number = Field(description="Right ascension of the ascending node, deg.")
    argument_of_latitude_deg: Number = Field(
        description="From the ascending node to the LVLH frame's origin at the epoch, deg."
    )


class OrbitDocument(BaseModel):
    """The reference orbit, and the forces on all craft, where they are not a circle's alone.

    Osculating elements at the first node. Angles refer to the Earth's mean equator and equinox of
    J2000 (EME2000).
    """

    model_config = _strict()

    semi_major_axis: Positive = Field(description="Semi-major axis, m.")
    eccentricity: Number = Field(0.0, ge=0, le=MOST_ECCENTRIC, description="Osculating.")
    inclination_deg: Number = Field(0.0, ge=0, le=180, description="Inclination, deg.")
    raan_deg: Number = Field(0.0, description="Right ascension of the ascending node, deg.")
    argument_of_perigee_deg: Number = Field(0.0, description="From the ascending node, deg.")
    argument_of_latitude_deg: Number = Field(
        0.0, description="From the ascending node to the LVLH frame's origin, deg."
    )
    j2: bool = Field(True, strict=True, description="Whether the Earth is oblate.")
    ballistic: Positive | None = Field(
        None, description="Mean C_D A/m of the swarm, m²/kg; null for no drag."
    )
    spread: Number = Field(
        0.0, description="By what share of it the first craft has less, and the last more."
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
        try:
            return ReferenceOrbit(**self.model_dump())
        except InputError as error:
            raise InputError(f"orbit: {error}") from error


NoBurn = Annotated[
    tuple[tuple[Number, Number], ...],
    Field(description="Stretches of time, from and to, s since the first node, without burns."),
]


class SpacecraftDocument(BaseModel):
    """One craft, as far as it is not like the others."""

    model_config = _strict()

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


Triple = tuple[Number, Number, Number]


class ObstacleDocument(BaseModel):
    """What craft keep clear of and no plan moves: a chief, a target, debris, a dead craft."""

    model_config = _strict(
        {
            "allOf": [
                _one_of(state="array", position="array"),
                _one_of(radius="number", semi_axes="array"),
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

    model_config = _strict()

    min: Triple = Field(description="Least coordinates, LVLH, m.")
    max: Triple = Field(description="Largest coordinates, LVLH, m.")


class ConeDocument(BaseModel):
    """An approach cone."""

    model_config = _strict()

    apex: Triple = Field(description="LVLH, m.")
    axis: Triple = Field(description="Direction in which it opens, LVLH, of any length.")
    half_angle_deg: Positive = Field(le=STEEPEST, description="Between axis and edge, deg.")


class CorridorDocument(BaseModel):
    """A corridor: a box or an approach cone that craft must stay inside of for some time."""

    model_config = _strict(_one_of(box="object", cone="object"))

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

    model_config = _strict()

    craft: Annotated[int, Field(ge=0), BeforeValidator(_number)] | None = Field(
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
        states = _end_states(self.formation, problem.starting_at(node)).tolist()
        return [Waypoint(k, tuple(s[:3]), tuple(s[3:]), self.time) for k, s in enumerate(states)]


# Of both a reference and an orbit
ANGLES = ("inclination_deg", "raan_deg", "argument_of_latitude_deg")


class ScenarioDocument(BaseModel):
    """What a swarm is asked to do: where each craft starts, and where it must be at the end.

    SI units but for angles, whose names end in _deg. LVLH frame: x radial outward, y along-track,
    z cross-track.
    """

    model_config = _strict(_one_of(mean_motion="number", altitude="number"))

    schema_name: Literal["prolearn.scenario/1"] = Field(
        alias="schema", description="Name and version of this format."
    )
    mean_motion: Positive | None = Field(
        None, description="Of the circular reference orbit, rad/s; or give altitude."
    )
    altitude: Positive | None = Field(
        None, description="Of the circular reference orbit above the Earth's equatorial radius, m."
    )
    orbit: OrbitDocument | None = Field(
        None, description="A reference orbit that is no circle, or has perturbations."
    )
    time_step: Positive = Field(
        Problem.time_step, description="Length of an interval of constant control, s."
    )
    nodes: Whole = Field(
        Problem.nodes, ge=3, description="Time nodes, both ends included: intervals and one."
    )
    collision_radius: Positive = Field(
        Problem.collision_radius, description="Craft must be further apart at all times, m."
    )
    max_acceleration: Positive | None = Field(
        None,
        description="Limit on each component of the control, or on each thruster where thrust has "
        "directions, m/s²; null for none.",
    )
    thrust: Literal["components", "norm"] | tuple[Triple, ...] = Field(
        "components",
        description="components: thrusters along the three axes; norm: one that is pointed; or "
        "unit vectors, LVLH, of the accelerations that thrusters give.",
    )
    max_acceleration_norm: Positive | None = Field(
        None, description="Limit on the norm of the control, m/s²; null for none."
    )
    min_delta_v: Positive | None = Field(
        None,
        description="Smallest impulse bit: least Δv of a thruster's burn in an interval, m/s.",
    )
    no_burn: NoBurn = ()
    objective: Objective = Field(
        "total",
        description="What is least: total, the fuel of all craft; fair, the largest share that a "
        "craft burns of its delta_v.",
    )
    craft: list[SpacecraftDocument] = Field(
        [], description="What each craft has of its own; empty where all are alike."
    )
    waypoints: list[WaypointDocument] = Field(
        [], description="Places that craft must pass on their way, in the order of each craft."
    )
    obstacles: list[ObstacleDocument] = Field(
        [], description="What craft keep clear of at all times and no plan moves."
    )
    corridors: list[CorridorDocument] = Field(
        [], description="Boxes and approach cones that craft stay inside of for some time."
    )
    initial: End = Field(description="Where each craft is at the first node.")
    goal: End = Field(description="Where each craft must be at the last node, in the same order.")
    reference: ReferenceDocument | None = Field(
        None, description="Where and when the reference orbit is, for files in inertial frames."
    )
    ends: Ends = Field(
        "passive",
        description="passive: both ends are on orbits that do not drift; any: as in a rendezvous, "
        "they may.",
    )

    @model_validator(mode="after")
    def _one_orbit(self) -> "ScenarioDocument":
        for k, one in enumerate(self.waypoints):
            if one.n not in (None, self.n):
                raise ValueError(f"waypoints[{k}] has {one.n} craft and initial has {self.n}")
        given = [one for one in (self.mean_motion, self.altitude, self.orbit) if one is not None]
        if len(given) != 1:
            raise ValueError("give one of mean_motion (rad/s), altitude (m) and orbit")
        for name in ANGLES if self.orbit and self.reference else ():
            here, there = getattr(self.reference, name), getattr(self.orbit, name)
            if here % 360 != there % 360:
                raise ValueError(f"{name} is {here:g} in reference and {there:g} in orbit")
        return self

    @property
    def n(self) -> int:
        """Number of spacecraft."""
        end = self.initial
        return end.n if isinstance(end, RingsDocument) else len(end)

    def scenario(self, name: str) -> Scenario:
        """The scenario that the fields describe."""
        grid, limits = (self.time_step, self.nodes), (self.collision_radius, self.max_acceleration)
        orbit = None if self.orbit is None else self.orbit.orbit()
        if orbit is not None:
            mean_motion = orbit.mean_motion
        else:
            mean_motion = self.mean_motion or mean_motion_at(self.altitude or 0.0)
        problem = Problem(mean_motion, *grid, *limits, orbit, self._thrust())
        initial = _end_states(self.initial, problem)
        goal = _end_states(self.goal, problem.starting_at(problem.intervals))
        where = None if self.reference is None else Reference(**self.reference.model_dump())
        craft = tuple(one.craft() for one in self.craft)
        waypoints = tuple(way for one in self.waypoints for way in one.waypoints(problem))
        about: dict[str, Any] = {"name": name, "reference": where}
        about |= {"craft": craft, "waypoints": waypoints}
        about["obstacles"] = tuple(one.obstacle() for one in self.obstacles)
        about["corridors"] = tuple(one.corridor() for one in self.corridors)
        return Scenario(problem, initial, goal, ends=self.ends, **about)

    def _thrust(self) -> Thrust:
        limits = self.max_acceleration_norm, self.min_delta_v
        return Thrust(self.thrust, *limits, self.no_burn, self.objective)

    def scenario_of(self, path: Path) -> Scenario:
        """The scenario, whose InputErrors name the file."""
        try:
            return self.scenario(stem_of(path))
        except InputError as error:
            raise InputError(f"{path}: {error}") from error


def read_scenario(path: Path | str) -> Scenario:
    """The scenario in a file; InputError names a field that is missing or wrong."""
    path = Path(path)
    return read_document(path, ScenarioDocument, WHAT).scenario_of(path)


def read_checked(path: Path, *, allow_drift: bool = False) -> Scenario:
    """The scenario in a file, read and checked; InputErrors have the file's name."""
    scenario = read_scenario(path)
    try:
        check(scenario, allow_drift=allow_drift)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return scenario


def document_of(scenario: Scenario) -> dict[str, Any]:
    """The fields of a scenario file, with raw states at both ends."""
    problem = scenario.problem.document()
    if thrust := problem.pop("thrust", None):
        given = {"thrust": thrust.pop("model"), **thrust}
        problem |= {name: one for name, one in given.items() if one not in (None, ())}
    if scenario.problem.orbit is not None:  # of which the mean motion follows
        del problem["mean_motion"]
        problem["orbit"] = OrbitDocument.of(scenario.problem.orbit).model_dump()
    fields = {
        "schema": SCHEMA,
        **problem,
        "initial": scenario.initial.tolist(),
        "goal": scenario.goal.tolist(),
    }
    if scenario.ends != "passive":
        fields["ends"] = scenario.ends
    if scenario.craft:
        fields["craft"] = [SpacecraftDocument.of(one) for one in scenario.craft]
    if scenario.obstacles:
        fields["obstacles"] = [ObstacleDocument.of(one) for one in scenario.obstacles]
    if scenario.corridors:
        fields["corridors"] = [CorridorDocument.of(one) for one in scenario.corridors]
    if scenario.waypoints:
        passed = [asdict(one) for one in scenario.waypoints]
        fields["waypoints"] = [{k: v for k, v in one.items() if v is not None} for one in passed]
    if scenario.reference is None:
        return fields
    epoch = scenario.reference.epoch.isoformat().replace("+00:00", "Z")
    return fields | {"reference": asdict(scenario.reference) | {"epoch": epoch}}


def write_scenario(path: Path | str, scenario: Scenario) -> None:
    """Write a scenario file, a line for each state."""
    write_document(Path(path), document_of(scenario))


def scenario_from(fields: Mapping[str, Any], name: str) -> Scenario:
    """The scenario of a file's fields; a missing or wrong one is an InputError with its name."""
    return document_from({"schema": SCHEMA, **fields}, ScenarioDocument).scenario(name)


def write_by_hand(path: Path, fields: Mapping[str, Any]) -> Scenario:
    """Write a scenario file of fields and return the scenario; InputError, no file, if wrong."""
    document = document_from({"schema": SCHEMA, **fields}, ScenarioDocument)
    scenario = document.scenario(stem_of(path))
    write_document(path, document.model_dump(mode="json", by_alias=True, exclude_unset=True))
    return scenario


def json_schema() -> dict[str, Any]:
    """The JSON Schema of scenario files."""
    return {"$schema": DIALECT, **ScenarioDocument.model_json_schema()}
