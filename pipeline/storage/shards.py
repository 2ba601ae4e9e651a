"""Shards as bytes: Parquet with page checksums, whose metadata says what the rows are."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from pipeline.documents import parsed
from pipeline.errors import InputError

TEXT_COLUMNS = ("family", "split", "status")

METADATA_KEY = b"prolearn"
"""In the schema's metadata: all that decides the rows, as JSON."""

TIMED_KEY = b"prolearn_shard"
"""In the metadata of timings: the SHA-256 digest of the shard that they belong to."""

ROW_BYTES, VALUE_BYTES = 2**16, 32
"""Most that a row takes beside its lists, and each value of a list, before compression."""


@dataclass(frozen=True)
class Size:
    """The most that a shard may hold; a few bytes of Parquet can stand for gigabytes.

    Attributes:
        rows: rows.
        values: numbers in any one column.
    """

    rows: int
    values: int


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


def decode(content: bytes, most: Size, columns: Sequence[str] | None = None) -> pa.Table:
    """The table in a shard's bytes, or some of its columns.

    Raises:
        InputError: where they are damaged, or hold more than they may.
    """
    source = pa.BufferReader(content)
    try:
        with pq.ParquetFile(source, page_checksum_verification=True) as file:
            _refuse_larger(file.metadata, most)
            _refuse_long_texts(content, file.schema_arrow, most)
            _refuse_contradiction(file)
            return file.read(columns=None if columns is None else list(columns))
    except InputError:
        raise
    except Exception as error:  # Arrow raises of all kinds where a footer is damaged
        raise InputError(f"cannot be read ({_one_line(error)})") from error


def digest_of(content: bytes) -> str:
    """SHA-256 of a shard."""
    return hashlib.sha256(content).hexdigest()


def metadata_of(fields: Mapping[str, Any]) -> dict[bytes, bytes]:
    """The schema metadata of a shard with all that decides its rows."""
    return {METADATA_KEY: json.dumps(fields, sort_keys=True, default=str).encode()}


def told_by(table: pa.Table) -> dict[str, Any]:
    """What a shard's metadata says decided its rows.

    Raises:
        InputError: where it says nothing that can be read.
    """
    try:
        return dict(parsed((table.schema.metadata or {})[METADATA_KEY]))
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"its metadata cannot be read ({_one_line(error)})") from error


def has_metadata(table: pa.Table, meta: Mapping[bytes, bytes]) -> bool:
    """Whether a table says that it was made like this, whatever other readers say beside it."""
    return (table.schema.metadata or {}).get(METADATA_KEY) == meta[METADATA_KEY]


def _refuse_larger(file: pq.FileMetaData, most: Size) -> None:
    groups = [file.row_group(k) for k in range(min(file.num_row_groups, most.rows + 1))]
    values = [0] * file.num_columns
    for group in groups:
        for k in range(file.num_columns):
            values[k] += group.column(k).num_values
    stored = sum(group.total_byte_size for group in groups)
    room = file.num_columns * (most.rows * ROW_BYTES + most.values * VALUE_BYTES)
    found = max([file.num_rows, file.num_row_groups, sum(g.num_rows for g in groups)])
    if found > most.rows or max(values, default=0) > most.values or stored > room:
        raise InputError(
            f"holds {file.num_rows} rows of up to {max(values, default=0)} numbers in "
            f"{stored} bytes; expected at most {most.rows} rows and {most.values} numbers"
        )


def _refuse_long_texts(content: bytes, schema: pa.Schema, most: Size) -> None:
    size = text_bytes(content, schema)
    if size > most.rows * ROW_BYTES:
        raise InputError(f"holds {size} bytes of text; expected at most {most.rows * ROW_BYTES}")


def text_bytes(content: bytes, schema: pa.Schema) -> int:
    """Size in memory of all texts of a file, which may hold one text once for millions of rows."""
    text = (pa.types.is_string, pa.types.is_large_string)
    names = [field.name for field in schema if any(fits(field.type) for fits in text)]
    with pq.ParquetFile(pa.BufferReader(content), read_dictionary=names) as file:
        columns = file.read(columns=names).columns
    parts = [chunk for column in columns for chunk in column.chunks]
    sizes = [pc.sum(pc.take(pc.binary_length(k.dictionary), k.indices)).as_py() for k in parts]
    return sum(size or 0 for size in sizes)


def _refuse_contradiction(file: pq.ParquetFile) -> None:
    """A footer has the metadata twice, for all readers of Parquet and for Arrow."""
    for_all, for_arrow = file.metadata.metadata or {}, file.schema_arrow.metadata or {}
    if any(for_all.get(key) != for_arrow.get(key) for key in (METADATA_KEY, TIMED_KEY)):
        raise InputError("is damaged: the two copies of its metadata differ")


def _one_line(error: Exception) -> str:
    return next(iter(str(error).strip().splitlines()), type(error).__name__)
