"""Pandas tables as the bytes of Parquet files, which are checked before they are read."""

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from pipeline.errors import InputError
from pipeline.storage.shards import Size, decode, encode, sound_metadata, text_bytes

MOST_BYTES = 2 * 10**9
MOST_CELLS = 5 * 10**7  # size in memory, and cells, of the largest table that is read

KINDS = (
    *(pa.types.is_integer, pa.types.is_floating, pa.types.is_boolean),
    *(pa.types.is_string, pa.types.is_large_string, pa.types.is_null),
)
"""What the columns of a table may hold."""


def table_bytes(table: pd.DataFrame) -> bytes:
    """A table as the bytes of a Parquet file, with checksums of its pages."""
    return encode(pa.Table.from_pandas(table, preserve_index=False))


def table_from(content: bytes) -> pd.DataFrame:
    """The table in an untrusted Parquet file; InputError if damaged, too large or no table."""
    try:
        _check_size(content)
    except (OSError, pa.ArrowException) as error:
        raise InputError(f"it cannot be read ({error})") from error
    table = decode(content, Size(MOST_CELLS, MOST_CELLS))
    try:
        return table.to_pandas()
    except Exception as error:  # of any kind, where the metadata for pandas are nonsense
        raise InputError(f"it is no pandas table ({error})") from error


def _check_size(content: bytes) -> None:
    """Refuse a table that is small as a file and too large in memory."""
    with pq.ParquetFile(pa.BufferReader(content)) as file:
        schema, rows = file.schema_arrow, file.metadata.num_rows
        if rows > MOST_CELLS:
            raise _too_large(rows, 8 * rows)
        metadata = sound_metadata(file, MOST_CELLS)
    for field in schema:
        if not any(fits(field.type) for fits in KINDS):
            raise InputError(f"its column {field.name[:40]!r} is of type {field.type}")
    groups = [metadata.row_group(k) for k in range(metadata.num_row_groups)]
    chunks = [group.column(k) for group in groups for k in range(group.num_columns)]
    cells = max(rows, sum(chunk.num_values for chunk in chunks))
    size = sum(chunk.total_uncompressed_size for chunk in chunks)
    if cells <= MOST_CELLS and size <= MOST_BYTES:
        size = text_bytes(content, schema)
    if cells > MOST_CELLS or size > MOST_BYTES:
        raise _too_large(cells, size)


def _too_large(cells: int, size: int) -> InputError:
    return InputError(
        f"it has {cells} cells and takes {size / 1e9:.3g} GB in memory; at most {MOST_CELLS} "
        f"and {MOST_BYTES / 1e9:g} GB are read"
    )
