"""scenario.json (schema prolearn.scenario/1): reading, validation of fields, and writing."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, model_validator

from pipeline.documents import DIALECT, Strict, document_from, read_document, write_document
from pipeline.errors import check_kind, error_context
from pipeline.files import path_of, stem_of
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import Reference, mean_motion_at
from pipeline.orbit.thrust import Objective, Thrust
from pipeline.scenario.part_documents import (
    ANGLES,
    CorridorDocument,
    End,
    NoBurn,
    ObstacleDocument,
    OrbitDocument,
    Positive,
    ReferenceDocument,
    SpacecraftDocument,
    Triple,
    WaypointDocument,
    Whole,
    count_of,
    end_states,
    given_fields,
    one_of,
)
from pipeline.scenario.scenario import EndKind, Scenario
from pipeline.scenario.spacecraft import Spacecraft
from pipeline.scenario.validation import check

SCHEMA = "prolearn.scenario/1"
WHAT = f"a scenario file (schema {SCHEMA})"


class ScenarioDocument(
    Strict, json_schema_extra=one_of(mean_motion="number", altitude="number", orbit="object")
):
    """A transfer of a swarm: where each craft starts, and where it must be at the end.

    SI units but for angles, whose names end in _deg. LVLH frame: x radial outward, y along-track,
    z cross-track.
    """

    schema_name: Literal["prolearn.scenario/1"] = Field(
        alias="schema", description="Name and version of this format."
    )
    mean_motion: Positive | None = Field(
        None, description="Mean motion of the circular reference orbit, rad/s; or give altitude."
    )
    altitude: Positive | None = Field(
        None,
        description="Altitude of the circular reference orbit above the equatorial radius, m.",
    )
    orbit: OrbitDocument | None = Field(
        None, description="A reference orbit that is no circle, or has perturbations."
    )
    time_step: Positive = Field(
        Problem.time_step, description="Length of an interval of constant control, s."
    )
    nodes: Whole = Field(
        Problem.nodes, ge=3, description="Number of time nodes, both ends included."
    )
    collision_radius: Positive = Field(
        Problem.collision_radius, description="Separation that craft must exceed at all times, m."
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
        description="Minimum impulse bit: least Δv of a thruster's burn in an interval, m/s.",
    )
    no_burn: NoBurn = ()
    objective: Objective = Field(
        "total",
        description="What is minimized: total, the fuel of all craft; fair, the largest share of "
        "its delta_v that a craft burns.",
    )
    craft: list[SpacecraftDocument] = Field(
        [], description="Properties of each craft; empty where all are alike."
    )
    waypoints: list[WaypointDocument] = Field(
        [], description="Places that craft must pass on their way, in the order of each craft."
    )
    obstacles: list[ObstacleDocument] = Field(
        [], description="Bodies that craft keep clear of at all times and no plan moves."
    )
    corridors: list[CorridorDocument] = Field(
        [], description="Boxes and approach cones that craft stay inside of for some time."
    )
    initial: End = Field(description="Where each craft is at the first node.")
    goal: End = Field(description="Where each craft must be at the last node, in the same order.")
    reference: ReferenceDocument | None = Field(
        None, description="Where and when the reference orbit is, for inertial states and flights."
    )
    ends: EndKind = Field(
        "passive",
        description="passive: at both ends craft are on orbits that do not drift; any: they may "
        "drift, as in a rendezvous.",
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
        return count_of(self.initial)

    def scenario(self, name: str) -> Scenario:
        """The scenario that the fields describe."""
        orbit = None if self.orbit is None else self.orbit.orbit()
        given = orbit.mean_motion if orbit else self.mean_motion
        thrust = Thrust(
            self.thrust, self.max_acceleration_norm, self.min_delta_v, self.no_burn, self.objective
        )
        problem = Problem(
            mean_motion=given or mean_motion_at(self.altitude or 0.0),
            time_step=self.time_step,
            nodes=self.nodes,
            collision_radius=self.collision_radius,
            max_acceleration=self.max_acceleration,
            orbit=orbit,
            thrust=thrust,
        )
        where = None if self.reference is None else Reference(**self.reference.model_dump())
        return Scenario(
            problem,
            end_states(self.initial, problem),
            end_states(self.goal, problem.starting_at(problem.intervals)),
            name=name,
            reference=where,
            ends=self.ends,
            craft=_each("craft", self.craft, lambda one: Spacecraft(**one.model_dump())),
            waypoints=tuple(way for one in self.waypoints for way in one.waypoints(problem)),
            obstacles=tuple(one.obstacle() for one in self.obstacles),
            corridors=_each("corridors", self.corridors, CorridorDocument.corridor),
        )

    def scenario_of(self, path: Path) -> Scenario:
        """The scenario, whose InputErrors name the file."""
        with error_context(path):
            return self.scenario(stem_of(path))


def _each(name: str, documents: Sequence[Any], made: Callable[[Any], Any]) -> tuple[Any, ...]:
    """What is made of each entry of a field; InputErrors have its path."""
    found = []
    for k, one in enumerate(documents):
        with error_context(f"{name}[{k}]"):
            found.append(made(one))
    return tuple(found)


def read_scenario(path: Path | str) -> Scenario:
    """The scenario in a file; InputError names a field that is missing or wrong."""
    path = path_of(path)
    return read_document(path, ScenarioDocument, WHAT).scenario_of(path)


def read_checked(path: Path, *, allow_drift: bool = False) -> Scenario:
    """The scenario in a file, checked by ``check``; InputErrors have the file's name."""
    scenario = read_scenario(path)
    with error_context(path):
        check(scenario, allow_drift=allow_drift)
    return scenario


def document_of(scenario: Scenario) -> dict[str, Any]:
    """The fields of a scenario file, with raw states at both ends."""
    problem = scenario.problem.document()
    if thrust := problem.pop("thrust", None):
        given = {"thrust": thrust.pop("model"), **thrust}
        problem |= {name: one for name, one in given.items() if one not in (None, ())}
    if scenario.problem.orbit is not None:  # which determines the mean motion
        del problem["mean_motion"]
        problem["orbit"] = OrbitDocument.of(scenario.problem.orbit).model_dump()
    parts = {
        "ends": None if scenario.ends == "passive" else scenario.ends,
        "craft": [given_fields(one) for one in scenario.craft],
        "obstacles": [ObstacleDocument.of(one) for one in scenario.obstacles],
        "corridors": [CorridorDocument.of(one) for one in scenario.corridors],
        "waypoints": [given_fields(one) for one in scenario.waypoints],
        "reference": scenario.reference and given_fields(scenario.reference),
    }
    return {
        "schema": SCHEMA,
        **problem,
        "initial": scenario.initial.tolist(),
        "goal": scenario.goal.tolist(),
        **{name: part for name, part in parts.items() if part},
    }


def write_scenario(path: Path | str, scenario: Scenario) -> None:
    """Write a scenario file, a line for each state."""
    check_kind("scenario", scenario, Scenario)
    write_document(path_of(path), document_of(scenario))


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
