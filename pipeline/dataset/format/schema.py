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
from pipeline.storage.shards import TIMED_KEY, metadata_of, told_by

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


def timing_schema(digest: str) -> pa.Schema:
    """The schema of the timings of a solved shard with a digest."""
    return pa.schema(TIMING_FIELDS, metadata={TIMED_KEY: digest})


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
    return metadata_of(
        {"schema": SCHEMA, **asdict(problem), **settings, "made_with": dict(made_with)}
    )


def problem_of(table: pa.Table) -> Problem:
    """The problem that a shard's metadata describes.

    Raises:
        InputError: where it describes none.
    """
    told = told_by(table)
    try:
        fields = {name: told[name] for name in Problem.__dataclass_fields__}
        return TypeAdapter(Problem).validate_python(fields) and Problem(**fields)
    except (KeyError, ValidationError) as error:
        raise InputError("its metadata describe no problem") from error


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


def timing_table(scenarios: pa.Table, outcomes: Sequence[Outcome], digest: str) -> pa.Table:
    """A table of TIMING_FIELDS, which lies beside the data since no two runs agree on it.

    Args:
        scenarios: of the shard.
        outcomes: what became of them.
        digest: of the solved shard.
    """
    rows = [
        {
            "scenario_id": name,
            "message": one.message or None,
            **(one.plan.timing if one.plan else {}),
        }
        for name, one in zip(scenarios["scenario_id"].to_pylist(), outcomes, strict=True)
    ]
    return pa.Table.from_pylist(rows, timing_schema(digest))


def same_scenarios(table: pa.Table, scenarios: pa.Table) -> bool:
    """Whether a table's rows are those scenarios, in that order."""
    names = [field.name for field in SCENARIO_FIELDS]
    return set(names) <= set(table.column_names) and table.select(names).equals(
        scenarios.select(names)
    )


def scenarios_of(table: pa.Table) -> list[Scenario]:
    """The scenarios in the rows of a table."""
    problem = problem_of(table)
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
