"""plan.json (schema prolearn.plan/2): a plan with its scenario, written and read."""

import math
from collections.abc import Callable, Iterator
from dataclasses import asdict, fields
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from pipeline.documents import DIALECT, Strict, read_document, write_document
from pipeline.errors import InputError, check_choice, check_kind, check_text, is_number
from pipeline.files import path_of
from pipeline.plan.certificate import Certificate
from pipeline.plan.plan import STATUSES, Assignment, Plan
from pipeline.plan.requirements import SeparationKind
from pipeline.scenario import Scenario
from pipeline.scenario.document import ScenarioDocument, document_of
from pipeline.scenario.part_documents import Number, OrbitDocument, State, Whole

SCHEMA = "prolearn.plan/2"
WHAT = f"a plan file (schema {SCHEMA})"
# Fields of a certificate that are left out where they do not apply
OPTIONAL = (
    *("risk", "passive_safety", "largest_share", "smallest_burn", "craft_delta_v_thrusters"),
    *("clearance", "corridor", "waypoint_error", "waypoint_velocity_error"),
)

TEXTS = (".fuel_lower_bound_proof", ".other")  # fields of certificates that are or may be text

Control = Annotated[list[Number], Field(min_length=3, max_length=3)]


class PlanDocument(Strict):
    """The fields of a plan file; version 1 lacks the scenario.

    Where there is an assignment, the scenario is the one that is flown: its goals in the order of
    the craft that take them.
    """

    schema_name: Literal["prolearn.plan/1", "prolearn.plan/2"] = Field(
        alias="schema", description="Name and version of this format."
    )
    scenario: ScenarioDocument | None = Field(
        None, description="What the plan is for, with raw states; version 1 lacks it."
    )
    planner: str = Field(description="Who made the plan.")
    status: Literal["solved", "unsafe", "infeasible", "unsolved"] = Field(
        description="solved: safe and at the goal; unsafe: a pair comes too close, or a limit is "
        "not kept; infeasible: proven that there is no plan; unsolved: none was found."
    )
    message: str = Field("", description="Why, where the status is not solved.")
    times: list[Number] = Field(description="Of the nodes, s since the first.")
    states: list[list[State]] = Field(
        description="By craft and node: x y z vx vy vz, LVLH, m and m/s."
    )
    controls: list[list[Control]] = Field(
        description="By craft and interval: acceleration ux uy uz, LVLH, m/s², held constant."
    )
    certificate: Certificate = Field(description="What the plan costs and how safe it is.")
    convex_solves: Whole = Field(0, description="Joint convex programs that the plan took.")
    timing: dict[str, float] = Field(default_factory=dict, description="By stage, s.")
    assignment: Assignment | None = Field(
        None, description="Who takes which goal, where that was chosen; the scenario has it so."
    )
    separation: SeparationKind = Field(
        "continuous",
        description="When craft were to be kept apart: continuous, at all times; nodes, at the "
        "nodes only. Left out where it is continuous.",
    )
    world: OrbitDocument | None = Field(
        None,
        description="The scenario's orbit, where the plan is as flown about it in all terms of "
        "gravity, J2 and drag; left out where states are of linear motion.",
    )

    @field_validator("certificate", mode="before")
    @classmethod
    def _written_out(cls, given: Any) -> Any:
        """Restore an infinite gap, null in JSON, and goal_velocity_error, absent in old files."""
        if not isinstance(given, dict):
            return given
        gap = {"optimality_gap": math.inf} if given.get("optimality_gap", 0) is None else {}
        return {"goal_velocity_error": math.nan} | given | gap

    @field_validator("certificate", "assignment", "timing", mode="wrap")
    @classmethod
    def _numbers(cls, given: Any, validated: Callable[[Any], Any]) -> Any:
        """Refuse text, booleans and what is not finite where numbers are expected."""
        found = validated(given)
        for place, value in _leaves(given):
            text = place.endswith(TEXTS) and isinstance(value, str)
            if not text and value is not None and not (is_number(value) and math.isfinite(value)):
                raise ValueError(
                    f"{place.lstrip('.')} is {value!r}: expected a finite number, without quotes"
                )
        return found

    @model_validator(mode="after")
    def _one_shape(self) -> "PlanDocument":
        n, T = len(self.states), len(self.times)
        asked = self.scenario
        if asked is None and self.schema_name == SCHEMA:
            raise ValueError(f"scenario is missing, which {SCHEMA} has: plan again")
        if asked is not None and (n, T) != (asked.n, asked.nodes):
            raise ValueError(f"the plan has {n} craft and {T} nodes, its scenario has others")
        if asked is not None and not np.allclose(self.times, asked.time_step * np.arange(T)):
            raise ValueError("times are not those of the nodes of its scenario, k·time_step")
        rows = [{len(craft) for craft in part} for part in (self.states, self.controls)]
        if len(self.controls) != n or rows != [{T}, {T - 1}]:
            raise ValueError(f"give each of {n} craft {T} states and {T - 1} controls")
        if self.world is not None and (asked is None or asked.orbit != self.world):
            raise ValueError("world is another orbit than the scenario's: plan again")
        if self.assignment is not None and sorted(self.assignment.slots) != [*range(n)]:
            raise ValueError(f"assignment.slots is no order of the {n} goals")
        return self

    def plan(self, scenario: Scenario) -> Plan:
        """The plan that the other fields describe, for the scenario."""
        given: dict[str, Any] = {"scenario": scenario, "as_flown": self.world is not None}
        given |= {name: np.array(getattr(self, name)) for name in ("states", "controls")}
        others = (field.name for field in fields(Plan) if field.name not in given)
        return Plan(**given, **{name: getattr(self, name) for name in others})


def _leaves(given: Any, place: str = "") -> Iterator[tuple[str, Any]]:
    """Yield each scalar of a JSON value with its path."""
    if isinstance(given, dict):
        parts = [(f"{place}.{name}", one) for name, one in given.items()]
    elif isinstance(given, list):
        parts = [(f"{place}[{k}]", one) for k, one in enumerate(given)]
    else:
        yield place, given
        return
    for where, one in parts:
        yield from _leaves(one, where)


def plan_document(plan: Plan) -> dict[str, Any]:
    """The fields of a plan file; what is infinite or absent becomes null."""
    problem, found = plan.scenario.problem, plan.certificate
    check_choice("status", plan.status, STATUSES)
    for name in ("planner", "message"):  # of a planner from outside
        check_text(name, getattr(plan, name))
    chosen = {} if plan.assignment is None else {"assignment": asdict(plan.assignment)}
    asked: dict[str, Any] = {}
    if plan.separation == "nodes":
        asked["separation"] = plan.separation
    if plan.as_flown and problem.orbit is not None:
        asked["world"] = OrbitDocument.of(problem.orbit).model_dump()
    if not (np.isfinite(plan.states).all() and np.isfinite(plan.controls).all()):
        raise InputError("states or controls of the plan are not finite; expected numbers.")
    claims = asdict(found) | {"optimality_gap": plan.optimality_gap}
    if found.passive_safety is not None:
        claims["passive_safety"] = found.passive_safety.document()
    if math.isnan(found.goal_velocity_error):  # as of early files, which lack it
        del claims["goal_velocity_error"]
    given = {name: claim for name in OPTIONAL if (claim := claims.pop(name)) not in (None, ())}
    for name, value in claims.items():
        if isinstance(value, float) and not math.isfinite(value):
            claims[name] = None
    return {
        "schema": SCHEMA,
        "scenario": document_of(plan.scenario),
        "planner": plan.planner,
        "status": plan.status,
        "message": plan.message,
        **asked,
        "times": (np.arange(problem.nodes) * problem.time_step).tolist(),
        "states": plan.states.tolist(),
        "controls": plan.controls.tolist(),
        "certificate": claims | given,
        "convex_solves": plan.convex_solves,
        "timing": dict(plan.timing),
        **chosen,
    }


def write_plan(path: Path | str, plan: Plan) -> None:
    """Write a plan file, a line for each node of each craft."""
    check_kind("plan", plan, Plan)
    write_document(path_of(path), plan_document(plan))


def read_plan(path: Path | str) -> Plan:
    """The plan in a file, with its certificate as claimed there.

    Raises:
        InputError: where the file cannot be read, a field is missing or wrong, by its name, or the
            scenario is missing, as in files of version 1.
    """
    path = path_of(path)
    document = read_document(path, PlanDocument, WHAT)
    if document.scenario is None:
        raise InputError(
            f"{path} has schema prolearn.plan/1, which leaves out the scenario; expected {SCHEMA}: "
            "plan again with `prolearn plan`."
        )
    return document.plan(document.scenario.scenario_of(path))


def json_schema() -> dict[str, Any]:
    """The JSON Schema of plan files."""
    made = {"$schema": DIALECT, **PlanDocument.model_json_schema()}
    certificate = made["$defs"]["Certificate"]  # by what ``_written_out`` accepts
    gap = certificate["properties"]["optimality_gap"]
    gap["anyOf"] = [{"type": gap.pop("type")}, {"type": "null"}]
    certificate["required"].remove("goal_velocity_error")
    return made
