"""Node states and controls of a plan as a table: CSV and Parquet, a row for each craft and node."""

import json
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as csv
import pyarrow.parquet as pq

from pipeline.files import STDIO, published
from pipeline.plan import Plan
from pipeline.plan.document import plan_document
from pipeline.plan.judge import check_states

METADATA_KEY = b"prolearn"
STATE, CONTROL = ("x", "y", "z", "vx", "vy", "vz"), ("ux", "uy", "uz")
# Fields of a plan file that a table has as columns; the others are its metadata
BESIDE = ("times", "states", "controls")


def table_of(plan: Plan) -> pa.Table:
    """Craft, node, time_s, state (m, m/s, LVLH) and the control (m/s²) that begins at the node.

    At the last node no control begins: it is null there. The schema's metadata has a key
    ``prolearn``: the plan file's JSON without its arrays, certificate and scenario included.

    Raises:
        InputError: where the plan's states are not what its controls lead to.
    """
    check_states(plan)
    n, T = plan.states.shape[:2]
    node = np.tile(np.arange(T), n)
    columns = {
        "craft": pa.array(np.repeat(np.arange(n), T), pa.int32()),
        "node": pa.array(node, pa.int32()),
        "time_s": pa.array(node * plan.scenario.problem.time_step),
    }
    columns |= {name: pa.array(plan.states[..., k].ravel()) for k, name in enumerate(STATE)}
    held = np.concatenate([plan.controls, np.zeros((n, 1, 3))], axis=1)
    for k, name in enumerate(CONTROL):
        columns[name] = pa.array(held[..., k].ravel(), mask=node == T - 1)
    rest = {k: v for k, v in plan_document(plan).items() if k not in BESIDE}
    return pa.table(columns, metadata={METADATA_KEY: json.dumps(rest).encode()})


def write_csv(plan: Plan, path: Path) -> None:
    """Write the table as CSV, with a header line; the file appears whole, or on stdout."""
    table, options = table_of(plan), csv.WriteOptions(quoting_header="none")
    if path == STDIO:
        csv.write_csv(table, pa.PythonFile(sys.stdout.buffer, "w"), options)
        return
    with published(path) as temporary:
        csv.write_csv(table, temporary, options)


def write_parquet(plan: Plan, path: Path) -> None:
    """Write the table as Parquet, with page checksums; the file appears whole."""
    with published(path) as temporary:
        pq.write_table(table_of(plan), temporary, write_page_checksum=True)
