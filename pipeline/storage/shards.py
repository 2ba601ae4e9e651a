"""Shards and pandas tables as bytes: Parquet with page checksums, checked before it is read."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from pipeline.documents import parse_json
from pipeline.errors import InputError
from pipeline.storage.folder import Folder
from pipeline.text import first_line

if TYPE_CHECKING:
    import pandas as pd  # whose import takes long, and most shards are not for it

TEXT_COLUMNS = ("family", "split", "status")
METADATA_KEY = b"prolearn"  # in the schema's metadata: all that determines the rows, as JSON
TIMED_KEY = b"prolearn_shard"  # metadata of timings: the SHA-256 of their shard

# Most bytes of a row without its lists, and of each value of a list, before compression
ROW_BYTES, VALUE_BYTES = 2**16, 32

MOST_BYTES = 2 * 10**9
MOST_CELLS = 5 * 10**7  # size in memory, and cells, of the largest pandas table that is read
# What the columns of a pandas table may hold
KINDS = (
    *(pa.types.is_integer, pa.types.is_floating, pa.types.is_boolean),
    *(pa.types.is_string, pa.types.is_large_string, pa.types.is_null),
)


@dataclass(frozen=True)
class Size:
    """Limits of a shard: a small file can stand for gigabytes."""

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


def decode(
    content: bytes, most: Size, columns: Sequence[str] | None = None, *, trusted: bool = False
) -> pa.Table:
    """The table in a shard's bytes; InputError where they are damaged or hold too much.

    ``trusted`` says that bytes of the same digest were decoded before: the checks, which take
    longer than reading, are then left out.
    """
    try:
        with pq.ParquetFile(
            pa.BufferReader(content), page_checksum_verification=not trusted
        ) as file:
            if not trusted:
                _refuse_larger(_sound_metadata(file, most.rows), most)
                _refuse_long_texts(content, file.schema_arrow, most)
                _refuse_contradiction(file)
            return file.read(columns=None if columns is None else list(columns), use_threads=False)
    except InputError:
        raise
    except Exception as error:  # Arrow raises of all kinds where a footer is damaged
        raise InputError(f"cannot be read ({first_line(error)})") from error


def read_verified(folder: Folder, name: str, digest: str) -> bytes:
    """The bytes of a shard whose SHA-256 is verified; InputErrors do not name the shard."""
    try:
        content = folder.read(name)
    except OSError as error:
        raise InputError(f"cannot be read ({folder.reason(error)})") from error
    if digest_of(content) != digest:
        raise InputError("does not have the digest that the manifest gives it")
    return content


def digest_of(content: bytes) -> str:
    """SHA-256 of a shard."""
    return hashlib.sha256(content).hexdigest()


def metadata_of(fields: Mapping[str, Any]) -> dict[bytes, bytes]:
    """The schema metadata of a shard, with all that determines its rows."""
    return {METADATA_KEY: json.dumps(fields, sort_keys=True, default=str).encode()}


def read_metadata(table: pa.Table) -> dict[str, Any]:
    """All that determined a shard's rows, from its schema metadata; InputError if unreadable."""
    try:
        return dict(parse_json((table.schema.metadata or {})[METADATA_KEY]))
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"its metadata cannot be read ({first_line(error)})") from error


def has_metadata(table: pa.Table, meta: Mapping[bytes, bytes]) -> bool:
    """Whether a table was made as ``meta`` says; metadata of other programs do not count."""
    return (table.schema.metadata or {}).get(METADATA_KEY) == meta[METADATA_KEY]


def table_bytes(table: "pd.DataFrame") -> bytes:
    """A table as the bytes of a Parquet file, with checksums of its pages."""
    return encode(pa.Table.from_pandas(table, preserve_index=False))


def table_from(content: bytes) -> "pd.DataFrame":
    """Read a table from an untrusted Parquet file; InputError if damaged, too large or none."""
    try:
        _check_size(content)
    except (OSError, pa.ArrowException) as error:
        raise InputError(f"it cannot be read ({error})") from error
    table = decode(content, Size(MOST_CELLS, MOST_CELLS))
    try:
        return table.to_pandas()
    except Exception as error:  # of any kind, where the metadata for pandas are nonsense
        raise InputError(f"it is no pandas table ({error})") from error


def _sound_metadata(file: pq.ParquetFile, most_rows: int) -> pq.FileMetaData:
    """The metadata of a file whose columns are read once; InputError for more rows.

    pyarrow 25 ends the process where a column's statistics are asked for and contradict each other;
    where the column is read first, it raises.
    """
    metadata = file.metadata
    rows, groups = metadata.num_rows, metadata.num_row_groups
    if max(rows, groups) > most_rows:
        raise InputError(f"holds {rows} rows in {groups} groups; expected at most {most_rows} rows")
    file.scan_contents()
    return metadata


def _text_bytes(content: bytes, schema: pa.Schema) -> int:
    """Size in memory of all texts of a file, which may store a text of millions of rows once."""
    text = (pa.types.is_string, pa.types.is_large_string)
    names = [field.name for field in schema if any(fits(field.type) for fits in text)]
    with pq.ParquetFile(pa.BufferReader(content), read_dictionary=names) as file:
        columns = file.read(columns=names, use_threads=False).columns
    parts = [chunk for column in columns for chunk in column.chunks]
    sizes = [pc.sum(pc.take(pc.binary_length(k.dictionary), k.indices)).as_py() for k in parts]
    return sum(size or 0 for size in sizes)


def _refuse_larger(file: pq.FileMetaData, most: Size) -> None:
    groups = [file.row_group(k) for k in range(min(file.num_row_groups, most.rows + 1))]
    columns = range(file.num_columns)
    values = max((sum(g.column(k).num_values for g in groups) for k in columns), default=0)
    stored = sum(group.total_byte_size for group in groups)
    room = file.num_columns * (most.rows * ROW_BYTES + most.values * VALUE_BYTES)
    found = max([file.num_rows, file.num_row_groups, sum(g.num_rows for g in groups)])
    if found > most.rows or values > most.values or stored > room:
        raise InputError(
            f"holds {file.num_rows} rows of up to {values} numbers in {stored} bytes; expected at "
            f"most {most.rows} rows and {most.values} numbers"
        )


def _refuse_long_texts(content: bytes, schema: pa.Schema, most: Size) -> None:
    size = _text_bytes(content, schema)
    if size > most.rows * ROW_BYTES:
        raise InputError(f"holds {size} bytes of text; expected at most {most.rows * ROW_BYTES}")


def _refuse_contradiction(file: pq.ParquetFile) -> None:
    """Refuse a footer whose copies of the metadata, for all readers and for Arrow, differ."""
    for_all, for_arrow = file.metadata.metadata or {}, file.schema_arrow.metadata or {}
    if any(for_all.get(key) != for_arrow.get(key) for key in (METADATA_KEY, TIMED_KEY)):
        raise InputError("is damaged: the two copies of its metadata differ")


def _check_size(content: bytes) -> None:
    """Refuse a Parquet file whose table would take too much memory."""
    with pq.ParquetFile(pa.BufferReader(content)) as file:
        schema, rows = file.schema_arrow, file.metadata.num_rows
        if rows > MOST_CELLS:
            raise _too_large(rows, 8 * rows)
        metadata = _sound_metadata(file, MOST_CELLS)
    for field in schema:
        if not any(fits(field.type) for fits in KINDS):
            raise InputError(f"its column {field.name[:40]!r} is of type {field.type}")
    groups = [metadata.row_group(k) for k in range(metadata.num_row_groups)]
    chunks = [group.column(k) for group in groups for k in range(group.num_columns)]
    cells = max(rows, sum(chunk.num_values for chunk in chunks))
    size = sum(chunk.total_uncompressed_size for chunk in chunks)
    if cells <= MOST_CELLS and size <= MOST_BYTES:
        size = _text_bytes(content, schema)
    if cells > MOST_CELLS or size > MOST_BYTES:
        raise _too_large(cells, size)


def _too_large(cells: int, size: int) -> InputError:
    return InputError(
        f"it has {cells} cells and takes {size / 1e9:.3g} GB in memory; at most {MOST_CELLS} "
        f"and {MOST_BYTES / 1e9:g} GB are read"
    )
