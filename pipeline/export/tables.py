"""Node states and controls of a plan as a table: CSV and Parquet, a row for each craft and node."""

import json
from pathlib import Path

import numpy as np

from pipeline.arrays import Array
from pipeline.files import published, write_rows
from pipeline.plan import Plan
from pipeline.plan.document import plan_document
from pipeline.plan.judge import check_states

METADATA_KEY = b"prolearn"
STATE, CONTROL = ("x", "y", "z", "vx", "vy", "vz"), ("ux", "uy", "uz")
BESIDE = ("times", "states", "controls")  # columns of a table; other fields are metadata


def columns_of(plan: Plan) -> dict[str, Array]:
    """Craft, node, time_s, state (m, m/s, LVLH) and the control (m/s²) that begins at the node.

    At the last node no control begins: it is NaN there. InputError where the states are not what
    the controls lead to.
    """
    check_states(plan)
    n, T = plan.states.shape[:2]
    node = np.tile(np.arange(T, dtype=np.int32), n)
    craft = np.repeat(np.arange(n, dtype=np.int32), T)
    columns = {"craft": craft, "node": node, "time_s": node * plan.scenario.problem.time_step}
    held = np.concatenate([plan.controls, np.full((n, 1, 3), np.nan)], axis=1)
    for names, values in ((STATE, plan.states), (CONTROL, held)):
        columns |= dict(zip(names, values.reshape(n * T, -1).T, strict=True))
    return columns


def write_csv(plan: Plan, path: Path) -> None:
    """Write the table as CSV, with a header line; the file appears whole, or on stdout."""
    columns = columns_of(plan)
    write_rows(path, columns, zip(*(values.tolist() for values in columns.values()), strict=True))


def write_parquet(plan: Plan, path: Path) -> None:
    """Write the table as Parquet, with page checksums; the file appears whole.

    What is NaN is null. The schema's metadata has a key ``prolearn``: the plan file's JSON without
    its arrays, certificate and scenario included.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns = {
        name: pa.array(values, from_pandas=True) for name, values in columns_of(plan).items()
    }
    rest = {k: v for k, v in plan_document(plan).items() if k not in BESIDE}
    table = pa.table(columns, metadata={METADATA_KEY: json.dumps(rest).encode()})
    # Arrow opens only files whose names are UTF-8.
    with published(path) as temporary, temporary.open("wb") as file:
        pq.write_table(table, file, write_page_checksum=True)
