"""Tables of results as bytes, of whatever origin."""

import io
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pipeline.errors import InputError
from pipeline.storage.shards import table_bytes, table_from

TABLE = pd.DataFrame(
    {
        "planner": ["expert", "ff1"],
        "n": [10, 30],
        "fuel": [0.0494, np.inf],
        "min_separation": [15.2, np.nan],
        "safe": [True, False],
        "nullable": pd.array([1, None], dtype="Int64"),
        "answered": pd.array([None, True], dtype="boolean"),
        "odd": [None, True],
    }
)


def written(table: pa.Table, **options: Any) -> bytes:
    sink = io.BytesIO()
    pq.write_table(table, sink, compression="zstd", **options)
    return sink.getvalue()


def test_a_table_comes_back_as_it_went_in_and_other_tools_read_it() -> None:
    content = table_bytes(TABLE)
    pd.testing.assert_frame_equal(table_from(content), TABLE)
    pd.testing.assert_frame_equal(pd.read_parquet(io.BytesIO(content)), TABLE)


def test_a_file_of_an_earlier_version_is_read() -> None:
    sink = io.BytesIO()
    TABLE.to_parquet(sink, index=False)
    pd.testing.assert_frame_equal(table_from(sink.getvalue()), TABLE)


def test_a_flipped_bit_in_the_data_is_found_or_does_not_matter() -> None:
    content = table_bytes(TABLE)
    last = pq.read_metadata(io.BytesIO(content)).row_group(0).column(TABLE.shape[1] - 1)
    end = last.data_page_offset + last.total_compressed_size
    refused = 0
    for bit in np.random.default_rng(0).choice(np.arange(32, 8 * end), 300, replace=False):
        damaged = bytearray(content)
        damaged[bit // 8] ^= 1 << bit % 8
        try:
            pd.testing.assert_frame_equal(table_from(bytes(damaged)), TABLE)
        except InputError:
            refused += 1
    assert refused > 100


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 0.999])
def test_what_is_cut_off_is_refused(share: float) -> None:
    content = table_bytes(TABLE)
    with pytest.raises(InputError, match="cannot be read"):
        table_from(content[: int(share * len(content))])


def one_text_a_million_times() -> pa.Table:
    indices = pa.array(np.zeros(10**6, np.int32))
    return pa.table({"planner": pa.DictionaryArray.from_arrays(indices, ["x" * 10**6])})


LARGE: dict[str, Callable[[], pa.Table]] = {
    "rows": lambda: pa.table({"n": pa.array(np.zeros(6 * 10**7, np.int8))}),
    "columns": lambda: pa.table({f"c{k}": pa.array(np.zeros(10**6, np.int8)) for k in range(60)}),
    "text": one_text_a_million_times,
}


@pytest.mark.parametrize("made", LARGE.values(), ids=LARGE.keys())
def test_what_is_small_as_a_file_and_too_large_in_memory_is_refused(
    made: Callable[[], pa.Table],
) -> None:
    content = written(made(), store_schema=False)
    assert len(content) < 500_000
    with pytest.raises(InputError, match=r"cells and takes .* GB in memory; at most"):
        table_from(content)


@pytest.mark.parametrize(
    "values",
    [pa.array([[1]]), pa.array([b"bytes"]), pa.array([{"a": 1}]), pa.array([1], pa.timestamp("s"))],
    ids=lambda values: str(values.type),
)
def test_a_column_of_what_no_result_is_is_refused_by_name(values: pa.Array) -> None:
    with pytest.raises(InputError, match="column 'odd' is of type"):
        table_from(written(pa.table({"odd": values})))


@pytest.mark.parametrize(
    "nonsense",
    [b"{", b"[" * 100_000, b'{"index_columns": [{"kind": 1}]}', b'{"columns": 1}', b"[]"],
)
def test_nonsense_in_the_metadata_for_pandas_is_refused_or_does_not_matter(nonsense: bytes) -> None:
    table = pa.table({"n": [1]}).replace_schema_metadata({b"pandas": nonsense})
    try:
        assert list(table_from(written(table))["n"]) == [1]
    except InputError as error:
        assert "it is no pandas table" in str(error)
