"""scenario.json (schema prolearn.scenario/1): read with an answer to every mistake, and written."""

import json
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError, model_validator

from pipeline.errors import InputError
from pipeline.files import write_text
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import mean_motion_at
from pipeline.scenario.scenario import Scenario

SCHEMA = "prolearn.scenario/1"

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
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path} cannot be read ({error}); expected a scenario file.") from error
    try:
        return ScenarioDocument.model_validate(json.loads(text)).scenario(path.stem)
    except json.JSONDecodeError as error:
        raise InputError(f"{path} is not JSON: {error}; expected schema {SCHEMA}.") from error
    except ValidationError as error:
        raise InputError(f"{path}: {_first_fault(error)} (schema {SCHEMA}).") from error
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def write_scenario(path: Path, scenario: Scenario) -> None:
    """Write a scenario file."""
    problem = scenario.problem
    document = {
        "schema": SCHEMA,
        "mean_motion": problem.mean_motion,
        "time_step": problem.time_step,
        "nodes": problem.nodes,
        "collision_radius": problem.collision_radius,
        "max_acceleration": problem.max_acceleration,
        "initial": scenario.initial.tolist(),
        "goal": scenario.goal.tolist(),
    }
    write_text(path, json.dumps(document, indent=1) + "\n")


def _first_fault(error: ValidationError) -> str:
    """Field and fault of the first error, such as ``initial[2][5] is nan: ...``."""
    fault = error.errors(include_url=False)[0]
    where = "".join(f"[{k}]" if isinstance(k, int) else f".{k}" for k in fault["loc"])
    what = fault["msg"].removeprefix("Value error, ")
    what = what[0].lower() + what[1:]
    if not where:
        return what
    if fault["type"] == "missing":
        return f"{where.lstrip('.')} is missing"
    if fault["type"] == "extra_forbidden":
        return f"{where.lstrip('.')} is not a field of this schema; remove it"
    given = fault["input"]
    shown = f" is {given!r}" if isinstance(given, str | int | float | bool | None) else ""
    return f"{where.lstrip('.')}{shown}: {what}"
