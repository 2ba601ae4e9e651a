"""Files of runs that are read again: recorded with digests, checked before they are decoded."""

import re
from pathlib import Path

import mlflow
import pandas as pd

from pipeline.errors import InputError, ProlearnError
from pipeline.storage.shards import digest_of
from registry.running import FAILURES
from registry.runs import Run
from registry.store import Store
from registry.table_file import table_from

TABLE = "tables/table.parquet"
"""A run's table, among its artifacts."""

FILES = "files"
"""The folder there of what goes with the table."""

DIGEST = "sha256/"
"""What a tag begins with that has the SHA-256 of the file whose name follows."""

_ARRAYS = re.compile(rf"{FILES}/[\w. -]+\.npz")


def digest_tags(table: bytes, files: Path | None) -> dict[str, str]:
    """Tags of a run with the digests of its table and of the arrays in its folder of files."""
    found = {TABLE: digest_of(table)}
    for path in files.glob("*.npz") if files else ():
        found[f"{FILES}/{path.name}"] = digest_of(path.read_bytes())
    return {DIGEST + name: digest for name, digest in found.items()}


def has_digests(run: Run) -> bool:
    """Whether a run says what its files were; those of earlier versions do not."""
    return DIGEST + TABLE in run.tags


def read_table(store: Store, run: Run, scratch: Path) -> pd.DataFrame:
    """A run's table, by way of a temporary folder: a row for each trial.

    Raises:
        InputError: where the file is damaged, no table, or too large.
        ProlearnError: where it cannot be fetched.
    """
    content = _fetched(store, run, TABLE, scratch).read_bytes()
    try:
        return table_from(content)
    except InputError as error:
        raise unusable(run, TABLE, error) from error


def fetch_arrays(store: Store, run: Run, scratch: Path) -> list[Path]:
    """The files of a run that hold arrays, downloaded into a temporary folder.

    Raises:
        InputError: where one is damaged.
        ProlearnError: where one cannot be fetched.
    """
    if has_digests(run):
        names = [tag.removeprefix(DIGEST) for tag in run.tags if tag.startswith(DIGEST)]
    else:
        names = [found.path for found in store.client.list_artifacts(run.run_id, FILES)]
    names = sorted(name for name in names if _ARRAYS.fullmatch(name))
    return [_fetched(store, run, name, scratch) for name in names]


def unusable(run: Run, name: str, why: object) -> InputError:
    """What is said of a file of a run that is of no use."""
    return InputError(
        f"{name} of run {run.run_id} of {run.experiment} cannot be used ({why}); restore the file, "
        "or run the experiment again."
    )


def _fetched(store: Store, run: Run, name: str, scratch: Path) -> Path:
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
