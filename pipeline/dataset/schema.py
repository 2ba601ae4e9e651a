"""The Parquet schema of datasets: columns, metadata, and rows to and from values.

One row an instance; arrays are lists in row-major order, so that swarm sizes mix in one table
and every Parquet reader understands them. The schema's metadata has a key ``prolearn`` with the
problem and how it was sampled and solved, as JSON.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import Float
from pydantic import TypeAdapter, ValidationError

from pipeline.arrays import Array
from pipeline.errors import InputError
from pipeline.orbit.problem import Problem
from pipeline.plan import SOLVED, Plan
from pipeline.scenario import Scenario
from pipeline.storage.shards import TIMED_KEY, metadata_of, read_metadata

FAMILY = "prolearn.dataset/"
"""What the schema of every version begins with."""

SCHEMA = f"{FAMILY}2"

NUMBERS = pa.list_(pa.field("element", pa.float64(), nullable=False))

SCENARIO_FIELDS = [
    pa.field("scenario_id", pa.string(), nullable=False),
    pa.field("n_spacecraft", pa.int32(), nullable=False),
    pa.field("family", pa.string(), nullable=False),
    pa.field("split", pa.string(), nullable=False),
    pa.field("initial", NUMBERS, nullable=False),
    pa.field("goal", NUMBERS, nullable=False),
]

SOLVED_FIELDS = [
    *SCENARIO_FIELDS,
    pa.field("status", pa.string(), nullable=False),
    pa.field("states", NUMBERS),
    pa.field("controls", NUMBERS),
    pa.field("fuel", pa.float64()),
    pa.field("fuel_lower_bound", pa.float64()),
    pa.field("optimality_gap", pa.float64()),
    pa.field("node_collisions", pa.int32()),
    pa.field("min_separation", pa.float64()),
    pa.field("convex_solves", pa.int32()),
]
"""What depends on a plan is null where there is none."""

TIMING_FIELDS = [
    pa.field("scenario_id", pa.string(), nullable=False),
    pa.field("message", pa.string()),
    *(pa.field(stage, pa.float64()) for stage in ("own_optima", "search", "plan", "certificate")),
]

SHAPES = {"initial": "n·6", "goal": "n·6", "states": "n·T·6", "controls": "n·(T-1)·3"}
"""Shapes of the lists of doubles."""

MEANINGS = {
    "scenario_id": ("", "family, seed, n, split and index in it"),
    "n_spacecraft": ("", "n"),
    "family": ("", "`rings`, ..."),
    "split": ("", "`train`, `valid` or `test`"),
    "initial": ("m, m/s", "x y z vx vy vz of each craft at the first node"),
    "goal": ("m, m/s", "the same at the last node"),
    "status": ("", "`solved`, or why not: `infeasible` (proven), `unsolved`, `unsafe`"),
    "states": ("m, m/s", "x y z vx vy vz of each craft at each node"),
    "controls": (
        "m/s²",
        "x y z of each craft's thrust acceleration, constant over each interval",
    ),
    "fuel": ("m/s²", "Σ‖u‖₁ over craft and intervals; times Δt it is Δv in m/s"),
    "fuel_lower_bound": ("m/s²", "proven: no transfer, safe or not, needs less"),
    "optimality_gap": ("", "fuel / fuel_lower_bound - 1"),
    "node_collisions": ("", "pairs and nodes within the collision radius"),
    "min_separation": ("m", "least distance of any pair at any time"),
    "convex_solves": ("", "convex programs that the plan took"),
}
"""Unit and meaning of each column, in Markdown."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """The expert's result for a scenario.

    Attributes:
        status: as in a plan.
        message: why there is no plan, or nothing.
        plan: the plan, unless the expert failed before it had any.
    """

    status: str
    message: str = ""
    plan: Plan | None = None


def column_type(field: pa.Field) -> str:
    """Arrow's name of a column's type, or the shape of its lists."""
    return f"list of {SHAPES[field.name]} doubles" if field.name in SHAPES else str(field.type)


def metadata(
    problem: Problem, settings: Mapping[str, Any], made_with: Mapping[str, str]
) -> dict[bytes, bytes]:
    """The schema metadata of a shard: its problem, how it was drawn and solved, and with what."""
    return metadata_of(
        {"schema": SCHEMA, **asdict(problem), **settings, "made_with": dict(made_with)}
    )


def problem_of(table: pa.Table) -> Problem:
    """The problem that a shard's metadata describes; InputError where it describes none."""
    about = read_metadata(table)
    try:
        fields = {name: about[name] for name in Problem.__dataclass_fields__}
        return TypeAdapter(Problem).validate_python(fields) and Problem(**fields)
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
    scenarios: pa.Table, outcomes: Sequence[Outcome], meta: Mapping[bytes, bytes]
) -> pa.Table:
    """A table of SOLVED_FIELDS: scenarios with their outcomes."""
    found = pa.Table.from_pylist(
        [_outcome_row(one) for one in outcomes], pa.schema(SOLVED_FIELDS[len(SCENARIO_FIELDS) :])
    )
    columns = [*scenarios.columns, *found.columns]
    return pa.Table.from_arrays(columns, schema=pa.schema(SOLVED_FIELDS, metadata=dict(meta)))


def timing_table(scenarios: pa.Table, outcomes: Sequence[Outcome], digest: str) -> pa.Table:
    """A table of TIMING_FIELDS, kept beside the data since no two runs agree on it.

    Args:
        scenarios: of the shard.
        outcomes: of its scenarios.
        digest: of the solved shard.
    """
    names = scenarios["scenario_id"].to_pylist()
    rows = [
        {"scenario_id": k, "message": one.message or None, **(one.plan.timing if one.plan else {})}
        for k, one in zip(names, outcomes, strict=True)
    ]
    return pa.Table.from_pylist(rows, pa.schema(TIMING_FIELDS, metadata={TIMED_KEY: digest}))


def same_scenarios(table: pa.Table, scenarios: pa.Table) -> bool:
    """Whether a table's rows are those scenarios, in that order."""
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
    """A column of lists as one array (rows, *shape), without a loop over rows."""
    flat = table[column].combine_chunks()
    values = np.array(flat.flatten())  # a copy, since Arrow's memory is read-only
    return values.reshape(table.num_rows, *shape)


def _outcome_row(outcome: Outcome) -> dict[str, Any]:
    plan = outcome.plan
    row: dict[str, Any] = {"status": outcome.status, "convex_solves": plan and plan.convex_solves}
    if plan is None or outcome.status != SOLVED:
        return row
    arrays = {"states": plan.states.ravel(), "controls": plan.controls.ravel()}
    return row | arrays | vars(plan.certificate)  # of which the schema takes its columns
