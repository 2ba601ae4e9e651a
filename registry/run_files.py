"""Files of a run that are read again: recorded with checksums, and checked before decoding."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import mlflow
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from pipeline.errors import InputError, ProlearnError
from pipeline.scratch import scratch_folder
from pipeline.storage.shards import Size, decode, digest_of, encode, text_bytes
from registry.running import FAILURES
from registry.store import Store, opened

if TYPE_CHECKING:
    from registry.results import Run

TABLE = "tables/table.parquet"
"""A run's table, among its artifacts."""

FILES = "files"
"""The folder there of what goes with the table."""

DIGEST = "sha256/"
"""Prefix of the tags that hold the SHA-256 of the file whose name follows."""

MOST_BYTES = 2 * 10**9
MOST_CELLS = 5 * 10**7
"""Size in memory, and cells, of the largest table that is read."""

KINDS = (
    pa.types.is_integer,
    pa.types.is_floating,
    pa.types.is_boolean,
    pa.types.is_string,
    pa.types.is_large_string,
    pa.types.is_null,
)
"""What the columns of a table may hold."""

_ARRAYS = re.compile(rf"{FILES}/[\w. -]+\.npz")


def digest_tags(table: bytes, files: Path | None) -> dict[str, str]:
    """Tags of a run with the digests of its table and of the arrays in its folder of files."""
    found = {TABLE: digest_of(table)}
    for path in files.glob("*.npz") if files else ():
        found[f"{FILES}/{path.name}"] = digest_of(path.read_bytes())
    return {DIGEST + name: digest for name, digest in found.items()}


def has_digests(run: "Run") -> bool:
    """Whether a run has checksums of its files; those of earlier versions have none."""
    return DIGEST + TABLE in run.tags


def table_of(run: "Run") -> pd.DataFrame:
    """A run's table: a row for each trial.

    Raises:
        InputError: where its file is damaged, no table, or too large.
        ProlearnError: where it cannot be fetched.
    """
    with opened(create=False) as store, scratch_folder() as scratch:
        content = _fetched(store, run, TABLE, scratch).read_bytes()
    try:
        return table_from(content)
    except InputError as error:
        raise unusable(run, TABLE, error) from error


@contextmanager
def arrays_of(run: "Run") -> Iterator[list[Path]]:
    """The files recorded with a run that hold arrays, for as long as the block lasts.

    Raises:
        InputError: where one is damaged.
        ProlearnError: where one cannot be fetched.
    """
    with scratch_folder() as scratch:
        with opened(create=False) as store:
            if has_digests(run):
                names = [tag.removeprefix(DIGEST) for tag in run.tags if tag.startswith(DIGEST)]
            else:
                names = [found.path for found in store.client.list_artifacts(run.run_id, FILES)]
            names = sorted(name for name in names if _ARRAYS.fullmatch(name))
            paths = [_fetched(store, run, name, scratch) for name in names]
        yield paths


def unusable(run: "Run", name: str, why: object) -> InputError:
    """The error for a file of a run that cannot be used."""
    return InputError(
        f"{name} of run {run.run_id} of {run.experiment} cannot be used ({why}); restore the file, "
        "or run the experiment again."
    )


def _fetched(store: Store, run: "Run", name: str, scratch: Path) -> Path:
    """A file of a run, downloaded and, where the run has its digest, checked."""
    place = {"run_id": run.run_id, "artifact_path": name, "dst_path": str(scratch)}
    try:
        path = Path(mlflow.artifacts.download_artifacts(**place, tracking_uri=store.uri))
        digest = digest_of(path.read_bytes())
    except FAILURES as error:
        raise ProlearnError(
            f"{name} of run {run.run_id} of {run.experiment} cannot be fetched ({error}); restore "
            "the file, or run the experiment again; where the project was moved, see "
            "docs/mlflow.md."
        ) from error
    if digest != run.tags.get(DIGEST + name, digest):
        raise unusable(run, name, "its SHA-256 is not the recorded one")
    return path


def table_bytes(table: pd.DataFrame) -> bytes:
    """A table as the bytes of a Parquet file, with checksums of its pages."""
    return encode(pa.Table.from_pandas(table, preserve_index=False))


def table_from(content: bytes) -> pd.DataFrame:
    """The table in the bytes of a Parquet file of unknown origin.

    Raises:
        InputError: where they are damaged, or the table is none of results or too large.
    """
    try:
        _check_size(content)
    except (OSError, pa.ArrowException) as error:
        raise InputError(f"it cannot be read ({error})") from error
    table = decode(content, Size(MOST_CELLS, MOST_CELLS))
    try:
        return table.to_pandas()
    except Exception as error:  # of any kind, where nonsense stands in the metadata for pandas
        raise InputError(f"it is no table of pandas ({error})") from error


def _check_size(content: bytes) -> None:
    """Refuse a table that is small as a file and too large in memory."""
    with pq.ParquetFile(pa.BufferReader(content)) as file:
        schema, metadata = file.schema_arrow, file.metadata
    for field in schema:
        if not any(fits(field.type) for fits in KINDS):
            raise InputError(f"its column {field.name[:40]!r} is of type {field.type}")
    groups = [metadata.row_group(k) for k in range(metadata.num_row_groups)]
    chunks = [group.column(k) for group in groups for k in range(group.num_columns)]
    cells = max(metadata.num_rows, sum(chunk.num_values for chunk in chunks))
    size = sum(chunk.total_uncompressed_size for chunk in chunks)
    if cells <= MOST_CELLS and size <= MOST_BYTES:
        size = text_bytes(content, schema)
    if cells > MOST_CELLS or size > MOST_BYTES:
        raise InputError(
            f"it has {cells} cells and takes {size / 1e9:.3g} GB in memory; at most {MOST_CELLS} "
            f"and {MOST_BYTES / 1e9:g} GB are read"
        )
