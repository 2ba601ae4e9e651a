"""What a solved dataset holds, as its card tells it: files, rows, and how good the plans are."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from pipeline.dataset.format.manifest import Manifest, Shard, read_manifest
from pipeline.dataset.reading.shards import refuse_unsolved, solved_table
from pipeline.plan import SOLVED
from pipeline.progress import Progress
from pipeline.storage.folder import Folder

TOLD = ["n_spacecraft", "split", "status", "fuel", "optimality_gap", "min_separation"]
"""Columns that the card has numbers of."""

QUANTILES = (0.5, 0.9, 0.99, 1.0)
"""Of the optimality gap."""


@dataclass(frozen=True)
class File:
    """A shard, as a reader gets it.

    Attributes:
        shard: what it is.
        rows: how many it has.
        stored: its size, bytes.
        in_memory: size of its rows as an Arrow table, bytes.
    """

    shard: Shard
    rows: int
    stored: int
    in_memory: int


@dataclass(frozen=True, eq=False)
class Contents:
    """A solved dataset.

    Attributes:
        manifest: how it was made.
        files: its shards, in order.
        rows: the columns TOLD of all rows.
    """

    manifest: Manifest
    files: Sequence[File]
    rows: pd.DataFrame


def read_contents(folder: Folder, progress: Progress) -> Contents:
    """Read all of a dataset, one shard in memory at a time.

    Raises:
        InputError: where there is no dataset, it is not wholly solved, or a shard is damaged.
    """
    manifest = read_manifest(folder)
    shards = manifest.expected()
    refuse_unsolved(folder, manifest, shards)
    progress.expect(sum(len(shard.rows) for shard in shards))
    files, parts = [], []
    for shard in shards:
        table = solved_table(folder, manifest, shard)
        files.append(File(shard, table.num_rows, folder.size(shard.solved), table.nbytes))
        parts.append(table.select(TOLD).to_pandas())
        progress.done(table.num_rows)
    return Contents(manifest, files, pd.concat(parts, ignore_index=True))


def quality(rows: pd.DataFrame) -> pd.DataFrame:
    """By swarm size: rows of each status, QUANTILES of the gap, mean fuel, least separation."""
    solved = rows[rows["status"] == SOLVED].groupby("n_spacecraft")
    gaps = solved["optimality_gap"].quantile(np.array(QUANTILES)).unstack()
    return (
        rows.groupby("n_spacecraft")
        .size()
        .to_frame("rows")
        .join(solved.size().rename("solved"))
        .join(gaps.set_axis([gap_name(q) for q in QUANTILES], axis="columns"))
        .join(solved["fuel"].mean())
        .join(solved["min_separation"].min())
        .fillna({"solved": 0})
    )


def gap_name(quantile: float) -> str:
    """The column that a quantile of the gap has in ``quality``."""
    return f"gap_{quantile:g}"
