"""The Parquet schema of datasets: columns, metadata, and rows to and from values.

One row for each instance; arrays are lists in row-major order, so that one table can hold several
swarm sizes and every Parquet reader understands them. The schema's metadata has a key ``prolearn``
with the problem and how it was sampled and solved, as JSON.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import prod
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from pydantic import ValidationError

from pipeline.arrays import Array, Float
from pipeline.documents import validated
from pipeline.errors import InputError
from pipeline.orbit.problem import Problem
from pipeline.plan.plan import SOLVED, UNSOLVED, Plan
from pipeline.scenario import Scenario
from pipeline.storage.shards import TIMED_KEY, metadata_of, read_metadata

FAMILY = "prolearn.dataset/"  # what the schema of every version begins with
SCHEMA = f"{FAMILY}2"


@dataclass(frozen=True)
class DataColumn:
    """A column of the data."""

    name: str  # in the file
    type: pa.DataType  # of its values
    meaning: str  # in Markdown
    unit: str = ""  # of its numbers, or nothing
    shape: str = ""  # of its lists of doubles, in row-major order
    nullable: bool = False  # where it depends on a plan, which may not exist

    @property
    def field(self) -> pa.Field:
        """Its field in Arrow's schema."""
        return pa.field(self.name, self.type, nullable=self.nullable)


_plan_column = partial(DataColumn, nullable=True)
TEXT, INTEGER, REAL = pa.string(), pa.int32(), pa.float64()
LIST = pa.list_(pa.field("element", REAL, nullable=False))

SCENARIO_COLUMNS = (
    DataColumn("scenario_id", TEXT, "family, seed, n, split and index in it"),
    DataColumn("n_spacecraft", INTEGER, "n"),
    DataColumn("family", TEXT, "`rings`, ..."),
    DataColumn("split", TEXT, "`train`, `valid` or `test`"),
    DataColumn("initial", LIST, "x y z vx vy vz of each craft at the first node", "m, m/s", "n·6"),
    DataColumn("goal", LIST, "the same at the last node", "m, m/s", "n·6"),
)
STATES = "x y z vx vy vz of each craft at each node"
CONTROLS = "x y z of each craft's thrust acceleration, constant over each interval"
FUEL = "Σ‖u‖₁ over craft and intervals; times Δt it is Δv in m/s"
PLAN_COLUMNS = (
    DataColumn("status", TEXT, "`solved`, or why not: `infeasible` (proven), `unsolved`, `unsafe`"),
    _plan_column("states", LIST, STATES, "m, m/s", "n·T·6"),
    _plan_column("controls", LIST, CONTROLS, "m/s²", "n·(T-1)·3"),
    _plan_column("fuel", REAL, FUEL, "m/s²"),
    _plan_column("fuel_lower_bound", REAL, "proven: no transfer, safe or not, needs less", "m/s²"),
    _plan_column("optimality_gap", REAL, "fuel / fuel_lower_bound - 1"),
    _plan_column("node_collisions", INTEGER, "pairs and nodes within the collision radius"),
    _plan_column("min_separation", REAL, "least distance of any pair at any time", "m"),
    _plan_column("convex_solves", INTEGER, "convex programs that the plan took"),
)
COLUMNS = (*SCENARIO_COLUMNS, *PLAN_COLUMNS)
SCENARIO_FIELDS = [column.field for column in SCENARIO_COLUMNS]
SOLVED_FIELDS = [column.field for column in COLUMNS]

TIMING_FIELDS = [
    pa.field("scenario_id", TEXT, nullable=False),
    pa.field("message", TEXT),
    *(pa.field(stage, REAL) for stage in ("own_optima", "search", "plan", "certificate")),
]


def metadata(
    problem: Problem, settings: Mapping[str, Any], made_with: Mapping[str, str]
) -> dict[bytes, bytes]:
    """The schema metadata of a shard: its problem, how it was drawn and solved, and with what."""
    return metadata_of(
        {"schema": SCHEMA, **problem.document(), **settings, "made_with": dict(made_with)}
    )


def problem_of(table: pa.Table) -> Problem:
    """The problem that a shard's metadata describes; InputError where it describes none."""
    about = read_metadata(table)
    absent = {"orbit", "thrust"} - about.keys()  # not written where they have their default
    try:
        fields = {name: about[name] for name in Problem.__dataclass_fields__.keys() - absent}
        return validated(Problem, fields) and Problem.of(fields)
    except (KeyError, ValidationError) as error:
        raise InputError("its metadata describe no problem") from error


def scenario_table(
    scenarios: Sequence[Scenario], splits: Sequence[str], meta: Mapping[bytes, bytes]
) -> pa.Table:
    """Scenarios as a table of SCENARIO_FIELDS."""
    rows = [
        {
            "scenario_id": scenario.name,
            "n_spacecraft": scenario.n,
            "family": scenario.family,
            "split": split,
            "initial": scenario.initial.ravel(),
            "goal": scenario.goal.ravel(),
        }
        for scenario, split in zip(scenarios, splits, strict=True)
    ]
    return pa.Table.from_pylist(rows, pa.schema(SCENARIO_FIELDS, metadata=dict(meta)))


def solved_table(
    scenarios: pa.Table, plans: Sequence[Plan | str], meta: Mapping[bytes, bytes]
) -> pa.Table:
    """A table of SOLVED_FIELDS: scenarios with their plans, UNSOLVED for a text instead of one."""
    schema = pa.schema([column.field for column in PLAN_COLUMNS])
    found = pa.Table.from_pylist([_plan_row(plan) for plan in plans], schema)
    columns = [*scenarios.columns, *found.columns]
    return pa.Table.from_arrays(columns, schema=pa.schema(SOLVED_FIELDS, metadata=dict(meta)))


def timing_table(scenarios: pa.Table, plans: Sequence[Plan | str], digest: str) -> pa.Table:
    """Timings of the solved shard of a digest; in a file of their own, as each run's differ."""
    rows: list[dict[str, Any]] = []
    for name, plan in zip(scenarios["scenario_id"].to_pylist(), plans, strict=True):
        message, timing = (plan, {}) if isinstance(plan, str) else (plan.message, plan.timing)
        rows.append({"scenario_id": name, "message": message or None, **timing})
    return pa.Table.from_pylist(rows, pa.schema(TIMING_FIELDS, metadata={TIMED_KEY: digest}))


def same_scenarios(table: pa.Table, scenarios: pa.Table) -> bool:
    """Whether two tables have the same scenarios in the same order."""
    names = [field.name for field in SCENARIO_FIELDS]
    known = set(names) <= set(table.column_names)
    return known and table.select(names).equals(scenarios.select(names))


def scenarios_of(table: pa.Table) -> list[Scenario]:
    """The scenarios in the rows of a table."""
    problem = problem_of(table)
    ends = [
        [np.reshape(row.values.to_numpy(), (-1, 6)) for row in table[end]]
        for end in ("initial", "goal")
    ]
    names = table["family"].to_pylist(), table["scenario_id"].to_pylist()
    return [Scenario(problem, *row) for row in zip(*ends, *names, strict=True)]


def stacked(table: pa.Table, column: str, *shape: int) -> Float[Array, "rows ..."]:
    """A column of lists as one array (rows, *shape), without a loop over rows.

    ValueError where a list is longer or shorter.
    """
    flat = table[column].combine_chunks()
    if not pc.all(pc.equal(pc.list_value_length(flat), prod(shape)), min_count=0).as_py():
        raise ValueError(f"{column} has lists of other lengths than {prod(shape)}")
    values = np.array(flat.flatten())  # a copy, since Arrow's memory is read-only
    return values.reshape(table.num_rows, *shape)


def _plan_row(plan: Plan | str) -> dict[str, Any]:
    if isinstance(plan, str):
        return {"status": UNSOLVED}
    row: dict[str, Any] = {"status": plan.status, "convex_solves": plan.convex_solves}
    if plan.status != SOLVED:
        return row
    arrays = {"states": plan.states.ravel(), "controls": plan.controls.ravel()}
    return row | arrays | vars(plan.certificate)  # of which the schema takes its columns
