"""scenario.json (schema prolearn.scenario/1): read with an answer to every mistake, and written."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, model_validator

from pipeline.documents import read_document, write_document
from pipeline.errors import InputError
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import mean_motion_at
from pipeline.scenario.scenario import Scenario

SCHEMA = "prolearn.scenario/1"

WHAT = f"a scenario file (schema {SCHEMA})"

Positive = Annotated[FiniteFloat, Field(gt=0)]
State = Annotated[list[FiniteFloat], Field(min_length=6, max_length=6)]


class ScenarioDocument(BaseModel):
    """The fields of a scenario file; unknown ones are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    schema_name: Literal["prolearn.scenario/1"] = Field(alias="schema")
    mean_motion: Positive | None = None
    altitude: Positive | None = None
    time_step: Positive = Problem.time_step
    nodes: int = Field(default=Problem.nodes, ge=3)
    collision_radius: Positive = Problem.collision_radius
    max_acceleration: Positive | None = None
    initial: list[State] = Field(min_length=1)
    goal: list[State] = Field(min_length=1)

    @model_validator(mode="after")
    def _one_orbit(self) -> "ScenarioDocument":
        if (self.mean_motion is None) == (self.altitude is None):
            raise ValueError("give one of mean_motion (rad/s) and altitude (m)")
        return self

    def scenario(self, name: str) -> Scenario:
        """The scenario that the fields describe."""
        problem = Problem(
            mean_motion=self.mean_motion or mean_motion_at(self.altitude or 0.0),
            time_step=self.time_step,
            nodes=self.nodes,
            collision_radius=self.collision_radius,
            max_acceleration=self.max_acceleration,
        )
        return Scenario(problem, np.array(self.initial), np.array(self.goal), name=name)


def read_scenario(path: Path) -> Scenario:
    """The scenario in a file.

    Raises:
        InputError: where the file cannot be read or a field is missing or wrong, by its name.
    """
    document = read_document(path, ScenarioDocument, WHAT)
    try:
        return document.scenario(path.stem)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def document_of(scenario: Scenario) -> dict[str, Any]:
    """The fields of a scenario file."""
    return {
        "schema": SCHEMA,
        **asdict(scenario.problem),
        "initial": scenario.initial.tolist(),
        "goal": scenario.goal.tolist(),
    }


def write_scenario(path: Path, scenario: Scenario) -> None:
    """Write a scenario file, a line for each state."""
    write_document(path, document_of(scenario))
