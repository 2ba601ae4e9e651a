"""What a solved dataset holds, as its card tells it: files, rows, and how good the plans are."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import pyarrow as pa

from pipeline.dataset.format.manifest import Manifest, Shard, read_manifest
from pipeline.errors import InputError
from pipeline.plan import SOLVED
from pipeline.progress import Progress
from pipeline.storage.folder import Folder
from pipeline.storage.shards import decode, digest_of

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
    for shard in shards:
        if shard.solved not in manifest.shards:
            raise InputError(
                f"{folder} is not solved ({shard.solved}); run `prolearn solve {folder}` first."
            )
    progress.expect(sum(len(shard.rows) for shard in shards))
    files, parts = [], []
    for shard in shards:
        content, table = _read(folder, manifest, shard)
        files.append(File(shard, table.num_rows, len(content), table.nbytes))
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


def _read(folder: Folder, manifest: Manifest, shard: Shard) -> tuple[bytes, pa.Table]:
    """A shard that is what the manifest says."""
    try:
        content = folder.read(shard.solved)
        if digest_of(content) != manifest.shards[shard.solved]:
            raise InputError("it does not have the digest that the manifest gives it")
        return content, decode(content)
    except (OSError, InputError) as error:
        raise InputError(
            f"{shard.solved} in {folder} is damaged ({error}); mend the dataset with "
            f"`prolearn verify {folder} --repair`."
        ) from error
