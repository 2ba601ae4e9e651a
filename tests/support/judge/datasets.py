"""Whether a folder of Parquet files holds what a solved dataset is meant to."""

import json
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq

from judge.plans import judge_plan

Row = dict[str, Any]
"""The columns of a row, or the fields of a file's metadata, by name."""

SCENARIO = ("scenario_id", "n_spacecraft", "family", "split", "initial", "goal", "status")
PLAN = (
    "states",
    "controls",
    "fuel",
    "fuel_lower_bound",
    "optimality_gap",
    "node_collisions",
    "min_separation",
)
"""Columns that a solved row has a value in, and no other row."""

SPLITS = {"train", "valid", "test"}
STATUSES = {"solved", "unsafe", "infeasible", "unsolved"}
PROBLEM = ("mean_motion", "time_step", "nodes", "collision_radius", "max_acceleration")


@dataclass(frozen=True)
class DatasetReport:
    """How many rows there are by status and by split, and all that is wrong, in words."""

    statuses: Mapping[str, int]
    splits: Mapping[str, int]
    faults: tuple[str, ...]


def judge_dataset(folder: Path) -> DatasetReport:
    """Judge every row of every Parquet file whose path has no name that begins with _ or a dot."""
    faults: list[str] = []
    rows: list[Row] = []
    problems = set()
    for file in sorted(folder.rglob("*.parquet")):
        place = file.relative_to(folder)
        if any(part.startswith(("_", ".")) for part in place.parts):
            continue
        about, columns, found = _read(file)
        missing = [name for name in (*SCENARIO, *PLAN, "convex_solves") if name not in columns]
        if missing:
            faults.append(f"{place} has no {', '.join(missing)}")
            continue
        rows += found
        problems.add(tuple(about[name] for name in PROBLEM))
        for row in found:
            if place.parts[0] != f"n={row['n_spacecraft']}":
                faults.append(f"{row['scenario_id']} of n={row['n_spacecraft']} is in {place}")
            faults += [f"{row['scenario_id']} {what}" for what in _row_faults(row, about)]
    if not rows:
        faults.append("there are no rows")
    if len(problems) > 1:
        faults.append("files are of different problems")
    faults += _shared(rows)
    statuses, splits = (Counter(row[name] for row in rows) for name in ("status", "split"))
    return DatasetReport(statuses, splits, tuple(faults))


def _read(file: Path) -> tuple[Row, list[str], list[Row]]:
    """Metadata, columns and rows of a file, its checksums checked."""
    with pq.ParquetFile(file, page_checksum_verification=True) as opened:
        table = opened.read()
    return json.loads(table.schema.metadata[b"prolearn"]), table.column_names, table.to_pylist()


def _row_faults(row: Row, about: Row) -> Iterator[str]:
    n, T = row["n_spacecraft"], about["nodes"]
    for name, known in (("status", STATUSES), ("split", SPLITS)):
        if row[name] not in known:
            yield f"has {name} {row[name]!r}"
    solved = row["status"] == "solved"
    due = {name for name in PLAN if solved and not (n == 1 and name == "min_separation")}
    there = {name for name in PLAN if row[name] is not None}
    if there != due:
        yield f"is {row['status']} and has {', '.join(sorted(there)) or 'nothing'}"
        return
    try:
        ends = {end: np.reshape(row[end], (n, 6)) for end in ("initial", "goal")}
        if not solved:
            return
        plan = {
            "states": np.reshape(row["states"], (n, T, 6)),
            "controls": np.reshape(row["controls"], (n, T - 1, 3)),
            "certificate": {name: row[name] for name in PLAN[2:]},
        }
        at_nodes = about["separation"] == "nodes"
        yield from judge_plan({**about, **ends}, plan, at_nodes=at_nodes).wrong
    except ValueError as error:
        yield f"cannot be judged: {error}"


def _shared(rows: list[Row]) -> Iterator[str]:
    """Names that two rows have, and scenarios of two splits, whatever order their craft are in."""
    for name, count in Counter(row["scenario_id"] for row in rows).items():
        if count > 1:
            yield f"{count} rows are called {name}"
    seen: dict[tuple[tuple[float, ...], ...], Row] = {}
    for row in rows:
        ends = np.reshape([row["initial"], row["goal"]], (2, -1, 6))
        swarm = tuple(sorted(map(tuple, np.concatenate(ends, axis=1).tolist())))
        other = seen.setdefault(swarm, row)
        if other["split"] != row["split"]:
            yield (
                f"{row['scenario_id']} of {row['split']} is {other['scenario_id']} "
                f"of {other['split']}"
            )
