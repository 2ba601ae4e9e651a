"""Shards as bytes: Parquet with page checksums that are verified on read."""

import hashlib
from collections.abc import Sequence
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from pipeline.errors import InputError
from pipeline.storage.folder import Folder

TEXT_COLUMNS = ("family", "split", "status")


def encode(table: pa.Table) -> bytes:
    """A table as the bytes of a shard; the same table gives the same bytes."""
    sink = pa.BufferOutputStream()
    pq.write_table(
        table,
        sink,
        compression="zstd",
        use_dictionary=[name for name in TEXT_COLUMNS if name in table.column_names],
        write_page_checksum=True,
    )
    return sink.getvalue().to_pybytes()


def decode(content: bytes) -> pa.Table:
    """The table in a shard's bytes.

    Raises:
        InputError: where they are damaged.
    """
    try:
        return _table(pa.BufferReader(content), None)
    except (OSError, pa.ArrowException) as error:
        raise InputError(f"it cannot be read ({error})") from error


def read_shard(folder: Folder, name: str, columns: Sequence[str] | None = None) -> pa.Table:
    """Read a shard, or some of its columns, with its checksums verified.

    Raises:
        InputError: where the file is missing or damaged.
    """
    try:
        with folder.opened(name) as file:
            return _table(file, None if columns is None else list(columns))
    except (OSError, pa.ArrowException) as error:
        raise InputError(
            f"{name} in {folder} cannot be read ({folder.told(error)}); mend the dataset with "
            f"`prolearn verify {folder} --repair`."
        ) from error


def digest_of(content: bytes) -> str:
    """SHA-256 of a shard."""
    return hashlib.sha256(content).hexdigest()


def _table(source: Any, columns: list[str] | None) -> pa.Table:
    with pq.ParquetFile(source, page_checksum_verification=True) as file:
        return file.read(columns=columns)
