"""scenario.json (schema prolearn.scenario/1): read with an answer to every mistake, and written."""

from collections.abc import Mapping
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    model_validator,
)

from pipeline.documents import DIALECT, document_from, read_document, write_document
from pipeline.errors import InputError
from pipeline.files import stem_of
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import Reference, mean_motion_at
from pipeline.scenario.ends import End, Number, Positive, Whole, craft_of, end_states
from pipeline.scenario.scenario import Scenario
from pipeline.scenario.soundness import check

SCHEMA = "prolearn.scenario/1"

WHAT = f"a scenario file (schema {SCHEMA})"

YEARS = (1960, 2200)
"""Of an epoch: since there is UTC, and no further than anyone plans."""


def _utc(given: Any) -> datetime:
    """An epoch as a file has it."""
    try:
        epoch = datetime.fromisoformat(given)
    except (TypeError, ValueError):
        epoch = None
    if epoch is None or epoch.tzinfo is None or not YEARS[0] < epoch.year < YEARS[1]:
        raise ValueError("give date, time and zone by ISO 8601, such as 2026-03-01T12:00:00Z")
    return epoch.astimezone(UTC)


class ReferenceDocument(BaseModel):
    """Where and when the reference orbit is; its size follows from mean_motion or altitude.

    The orbit is circular. Angles refer to the Earth's mean equator and equinox of J2000 (EME2000).
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    epoch: Annotated[datetime, BeforeValidator(_utc)] = Field(
        description="Time of the first node by ISO 8601 with a zone, such as 2026-03-01T12:00:00Z."
    )
    inclination_deg: Number = Field(ge=0, le=180, description="Inclination, deg.")
    raan_deg: Number = Field(description="Right ascension of the ascending node, deg.")
    argument_of_latitude_deg: Number = Field(
        description="From the ascending node to the LVLH frame's origin at the epoch, deg."
    )


class ScenarioDocument(BaseModel):
    """What a swarm is asked to do: where each craft starts, and where it must be at the end.

    SI units but for angles, whose names end in _deg. LVLH frame: x radial outward, y along-track,
    z cross-track.
    """

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        json_schema_extra={
            "oneOf": [
                {"required": [name], "properties": {name: {"type": "number"}}}
                for name in ("mean_motion", "altitude")
            ]
        },
    )

    schema_name: Literal["prolearn.scenario/1"] = Field(
        alias="schema", description="Name and version of this format."
    )
    mean_motion: Positive | None = Field(
        None, description="Of the circular reference orbit, rad/s; or give altitude."
    )
    altitude: Positive | None = Field(
        None, description="Of the circular reference orbit above the Earth's equatorial radius, m."
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
        None, description="Limit on each component of the control, m/s²; null for none."
    )
    initial: End = Field(description="Where each craft is at the first node.")
    goal: End = Field(description="Where each craft must be at the last node, in the same order.")
    reference: ReferenceDocument | None = Field(
        None, description="Where and when the reference orbit is, for files in inertial frames."
    )

    @model_validator(mode="after")
    def _one_orbit(self) -> "ScenarioDocument":
        if (self.mean_motion is None) == (self.altitude is None):
            raise ValueError("give one of mean_motion (rad/s) and altitude (m)")
        return self

    @property
    def n(self) -> int:
        """Number of spacecraft."""
        return craft_of(self.initial)

    def scenario(self, name: str) -> Scenario:
        """The scenario that the fields describe."""
        problem = Problem(
            mean_motion=self.mean_motion or mean_motion_at(self.altitude or 0.0),
            time_step=self.time_step,
            nodes=self.nodes,
            collision_radius=self.collision_radius,
            max_acceleration=self.max_acceleration,
        )
        initial, goal = (end_states(end, problem.mean_motion) for end in (self.initial, self.goal))
        where = None if self.reference is None else Reference(**self.reference.model_dump())
        return Scenario(problem, initial, goal, name=name, reference=where)


def read_scenario(path: Path) -> Scenario:
    """The scenario in a file.

    Raises:
        InputError: where the file cannot be read or a field is missing or wrong, by its name.
    """
    document = read_document(path, ScenarioDocument, WHAT)
    try:
        return document.scenario(stem_of(path))
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def read_checked(path: Path, *, allow_drift: bool = False) -> Scenario:
    """The scenario in a file, as ``read_scenario`` and ``check`` let it pass.

    Raises:
        InputError: as they do, with the file's name.
    """
    scenario = read_scenario(path)
    try:
        check(scenario, allow_drift=allow_drift)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return scenario


def document_of(scenario: Scenario) -> dict[str, Any]:
    """The fields of a scenario file, with raw states at both ends."""
    fields = {
        "schema": SCHEMA,
        **asdict(scenario.problem),
        "initial": scenario.initial.tolist(),
        "goal": scenario.goal.tolist(),
    }
    return fields | _reference(scenario.reference)


def _reference(reference: Reference | None) -> dict[str, Any]:
    if reference is None:
        return {}
    epoch = reference.epoch.isoformat().replace("+00:00", "Z")
    return {"reference": asdict(reference) | {"epoch": epoch}}


def write_by_hand(path: Path, fields: Mapping[str, Any]) -> Scenario:
    """Write a scenario file of fields as a person gives them, and the scenario it is.

    Raises:
        InputError: where a field is missing or wrong, by its name; nothing is written then.
    """
    document = document_from({"schema": SCHEMA, **fields}, ScenarioDocument)
    scenario = document.scenario(stem_of(path))
    write_document(path, document.model_dump(mode="json", by_alias=True, exclude_unset=True))
    return scenario


def json_schema() -> dict[str, Any]:
    """The JSON Schema of scenario files."""
    return {"$schema": DIALECT, **ScenarioDocument.model_json_schema()}


def write_scenario(path: Path, scenario: Scenario) -> None:
    """Write a scenario file, a line for each state."""
    write_document(path, document_of(scenario))
