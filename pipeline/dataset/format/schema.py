"""The Parquet schema of datasets: columns, metadata, and rows to and from values.

One row an instance; arrays are lists in row-major order, so that swarm sizes mix in one table
and every Parquet reader understands them. The schema's metadata has a key ``prolearn`` with the
problem and how it was sampled and solved, as JSON.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.orbit.problem import Problem
from pipeline.plan import SOLVED, Plan
from pipeline.scenario import Scenario

SCHEMA = "prolearn.dataset/2"
METADATA_KEY = b"prolearn"

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


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of a scenario.

    Attributes:
        status: as in a plan.
        message: why there is no plan, or nothing.
        plan: the plan, unless the expert failed before it had any.
    """

    status: str
    message: str = ""
    plan: Plan | None = None


def metadata(
    problem: Problem, settings: Mapping[str, Any], made_with: Mapping[str, str]
) -> dict[bytes, bytes]:
    """The schema metadata of a shard: its problem, how it was drawn and solved, and with what."""
    document = {"schema": SCHEMA, **asdict(problem), **settings, "made_with": dict(made_with)}
    return {METADATA_KEY: json.dumps(document, sort_keys=True).encode()}


def problem_of(schema: pa.Schema) -> Problem:
    """The problem that a shard's metadata describes."""
    document = json.loads(schema.metadata[METADATA_KEY])
    return Problem(**{name: document[name] for name in Problem.__dataclass_fields__})


def scenario_table(
    scenarios: Sequence[Scenario], splits: Sequence[str], meta: Mapping[bytes, bytes]
) -> pa.Table:
    """Scenarios as a table of SCENARIO_FIELDS."""
    rows = [_scenario_row(s, split) for s, split in zip(scenarios, splits, strict=True)]
    return pa.Table.from_pylist(rows, pa.schema(SCENARIO_FIELDS, metadata=dict(meta)))


def solved_table(
    scenarios: pa.Table, outcomes: Sequence[Outcome], meta: Mapping[bytes, bytes]
) -> pa.Table:
    """A table of SOLVED_FIELDS: scenarios with what became of them."""
    found = pa.Table.from_pylist(
        [_outcome_row(one) for one in outcomes], pa.schema(SOLVED_FIELDS[len(SCENARIO_FIELDS) :])
    )
    columns = [*scenarios.columns, *found.columns]
    return pa.Table.from_arrays(columns, schema=pa.schema(SOLVED_FIELDS, metadata=dict(meta)))


def timing_table(scenarios: pa.Table, outcomes: Sequence[Outcome]) -> pa.Table:
    """A table of TIMING_FIELDS, which lies beside the data since no two runs agree on it."""
    rows = [
        {
            "scenario_id": name,
            "message": one.message or None,
            **(one.plan.timing if one.plan else {}),
        }
        for name, one in zip(scenarios["scenario_id"].to_pylist(), outcomes, strict=True)
    ]
    return pa.Table.from_pylist(rows, pa.schema(TIMING_FIELDS))


def has_metadata(table: pa.Table, meta: Mapping[bytes, bytes]) -> bool:
    """Whether a table says that it was made like this, whatever other readers say beside it."""
    return (table.schema.metadata or {}).get(METADATA_KEY) == meta[METADATA_KEY]


def same_scenarios(table: pa.Table, scenarios: pa.Table) -> bool:
    """Whether a table's rows are those scenarios, in that order."""
    names = [field.name for field in SCENARIO_FIELDS]
    return set(names) <= set(table.column_names) and table.select(names).equals(
        scenarios.select(names)
    )


def scenarios_of(table: pa.Table) -> list[Scenario]:
    """The scenarios in the rows of a table."""
    problem = problem_of(table.schema)
    families, names = table["family"].to_pylist(), table["scenario_id"].to_pylist()
    ends = [
        [np.reshape(row.values.to_numpy(), (-1, 6)) for row in table[end]]
        for end in ("initial", "goal")
    ]
    return [
        Scenario(problem, initial, goal, family, name)
        for initial, goal, family, name in zip(*ends, families, names, strict=True)
    ]


def stacked(table: pa.Table, column: str, *shape: int) -> Float[Array, "rows ..."]:
    """A column of lists as one array (rows, *shape), without a loop over rows."""
    flat = table[column].combine_chunks()
    values = np.array(flat.flatten())  # a copy, since Arrow's memory is read-only
    return values.reshape(table.num_rows, *shape)


def _scenario_row(scenario: Scenario, split: str) -> dict[str, Any]:
    return {
        "scenario_id": scenario.name,
        "n_spacecraft": scenario.n,
        "family": scenario.family,
        "split": split,
        "initial": scenario.initial.ravel(),
        "goal": scenario.goal.ravel(),
    }


def _outcome_row(outcome: Outcome) -> dict[str, Any]:
    plan = outcome.plan
    row: dict[str, Any] = {"status": outcome.status, "convex_solves": plan and plan.convex_solves}
    if plan is None or outcome.status != SOLVED:
        return row
    arrays = {"states": plan.states.ravel(), "controls": plan.controls.ravel()}
    return row | arrays | vars(plan.certificate)  # of which the schema takes its columns
