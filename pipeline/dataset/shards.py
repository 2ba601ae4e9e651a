"""Shards on disk: Parquet files that appear whole, with page checksums, and work over them."""

import contextlib
import hashlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TypeVar

import joblib
import pyarrow as pa
import pyarrow.parquet as pq
from filelock import FileLock, Timeout
from joblib.externals.loky.process_executor import TerminatedWorkerError

from pipeline.errors import InputError, ProlearnError
from pipeline.files import published

LOCK = "_lock"
BACKENDS = ("loky", "dask")
TEXT_COLUMNS = ("family", "split", "status")

Task = TypeVar("Task")
Result = TypeVar("Result")


def write_shard(path: Path, table: pa.Table) -> str:
    """Write a shard and return its digest."""
    with published(path) as temporary:
        pq.write_table(
            table,
            temporary,
            compression="zstd",
            use_dictionary=[name for name in TEXT_COLUMNS if name in table.column_names],
            write_page_checksum=True,
        )
        return file_digest(temporary)


def read_shard(path: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """Read a shard, with its checksums verified.

    Raises:
        InputError: where the file is missing or damaged.
    """
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            return file.read(columns=None if columns is None else list(columns))
    except (OSError, pa.ArrowException) as error:
        raise InputError(
            f"{path} cannot be read ({error}); `prolearn solve` redoes damaged shards."
        ) from error


def file_digest(path: Path) -> str:
    """SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@contextlib.contextmanager
def sole_writer(folder: Path) -> Iterator[None]:
    """Hold a dataset folder for writing.

    Raises:
        InputError: where another process holds it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with FileLock(folder / LOCK, timeout=0):
            yield
    except Timeout as error:
        raise InputError(
            f"{folder} is being written by another process; wait for it or give another folder."
        ) from error


def for_each_shard(
    function: Callable[[Task], Result], tasks: Sequence[Task], jobs: int, backend: str
) -> Iterator[Result]:
    """Results of a function over shards, as they are done, on joblib's workers.

    Raises:
        InputError: for an unknown backend.
        ProlearnError: where a worker was killed; finished shards are kept.
    """
    if backend not in BACKENDS:
        raise InputError(f"backend is {backend!r}; expected one of {', '.join(BACKENDS)}.")
    try:
        with joblib.parallel_config(backend=backend):
            parallel = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")
            yield from parallel(joblib.delayed(function)(task) for task in tasks)
    except TerminatedWorkerError as error:
        raise ProlearnError(
            "a worker process was killed, perhaps for want of memory; the shards that were done "
            "are kept: run the same command again, with fewer --jobs if it happens again."
        ) from error
