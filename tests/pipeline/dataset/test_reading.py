"""What is read is what the manifest says, whatever somebody did to the files."""

import random

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from forged import forge

import prolearn
from pipeline.dataset.reading import solved_examples, solved_rows
from pipeline.dataset.schema import problem_of
from pipeline.errors import InputError
from pipeline.storage.shards import METADATA_KEY, Size, decode, encode

SHARD = "n=3/part-00000.parquet"
MEND = r"mend the dataset with `prolearn verify .* --repair`"


def test_any_flipped_bit_of_a_shard_is_refused_in_a_sentence(solved):
    chance, path = random.Random(0), solved / SHARD
    whole = path.read_bytes()
    footer = int.from_bytes(whole[-8:-4], "little") + 8
    places = [len(whole) - 1 - chance.randrange(footer) for _ in range(60)]
    for place in [*places, *(chance.randrange(len(whole)) for _ in range(40))]:
        damaged = bytearray(whole)
        damaged[place] ^= 1 << chance.randrange(8)
        path.write_bytes(damaged)
        with pytest.raises(InputError, match=MEND):
            solved_rows(solved, 3)
        with pytest.raises(InputError, match=MEND):
            solved_examples(solved, 3, "train")


def test_statistics_that_contradict_each_other_do_not_end_the_process(solved):
    """Every list of whole numbers of a footer, such as a histogram of levels, as one longer."""
    whole = (solved / SHARD).read_bytes()
    begin = len(whole) - 8 - int.from_bytes(whole[-8:-4], "little")
    lists = [k for k in range(begin, len(whole) - 8) if whole[k] in (0x16, 0x26, 0x36)]
    refused = 0
    for place in lists:
        damaged = bytearray(whole)
        damaged[place] += 0x10
        try:
            decode(bytes(damaged), Size(rows=1000, values=10**6))
        except InputError:
            refused += 1
    assert refused > 10


def test_a_collision_radius_that_a_bit_has_changed_is_refused(solved):
    """In the footer of a shard, as JSON: 15.0 becomes 14.0."""
    for path in solved.glob("n=3/*.parquet"):
        table = pq.read_table(path, partitioning=None)
        told = table.schema.metadata[METADATA_KEY]
        assert told.count(b'"collision_radius": 15.0') == 1
        told = told.replace(b'radius": 15.0', b'radius": 14.0')
        path.write_bytes(encode(table.replace_schema_metadata({METADATA_KEY: told})))
        assert problem_of(pq.read_table(path, partitioning=None)).collision_radius == 14.0
    with pytest.raises(InputError, match=MEND):
        solved_rows(solved, 3)


def test_shards_that_are_swapped_are_refused(solved):
    one, other = (solved / f"n=2/part-0000{k}.parquet" for k in (0, 1))
    first, second = one.read_bytes(), other.read_bytes()
    one.write_bytes(second)
    other.write_bytes(first)
    with pytest.raises(InputError, match=MEND):
        solved_rows(solved, 2)


def test_a_manifest_with_other_settings_than_the_shards_is_refused(solved):
    forge(solved, lambda manifest: manifest["problem"].update(collision_radius=14.0))
    with pytest.raises(InputError, match=r"other settings than the manifest has.*--repair"):
        solved_rows(solved, 3)


def test_a_stream_refuses_a_shard_that_changes_between_two_passes(solved):
    stream = solved_examples(solved, 3, "train", memory=1.0)
    assert sum(len(part) for part in stream.parts()) == len(stream)
    path = solved / SHARD
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    with pytest.raises(InputError, match=MEND):
        list(stream.parts())


def bomb(values):
    """A shard of one row whose list is so long; equal numbers take no room in a file."""
    flat = pa.array(np.zeros(values))
    table = pa.table({"states": pa.ListArray.from_arrays([0, values], flat)})
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, compression="zstd", write_page_checksum=True)
    return sink.getvalue().to_pybytes()


def test_a_few_bytes_that_stand_for_many_numbers_are_refused_before_they_take_memory():
    content = bomb(3_000_000)
    assert len(content) < 5_000
    usual, pool = pa.default_memory_pool(), pa.proxy_memory_pool(pa.default_memory_pool())
    pa.set_memory_pool(pool)
    try:
        with pytest.raises(InputError, match=r"3000000 numbers .* at most 4 rows and 500"):
            decode(content, Size(rows=4, values=500))
        assert pool.max_memory() < 1e6
    finally:
        pa.set_memory_pool(usual)


def test_two_copies_of_metadata_that_differ_are_damage():
    content = encode(pa.table({"a": [1]}).replace_schema_metadata({METADATA_KEY: b'{"n": 3}'}))
    with pytest.raises(InputError, match="two copies"):
        decode(content.replace(b'{"n": 3}', b'{"n": 2}'), Size(rows=1, values=1))


def test_a_text_of_gigabytes_is_refused():
    table = pa.table({"scenario_id": ["x" * 50_000_000]})
    with pytest.raises(InputError, match="expected at most 1 rows"):
        decode(encode(table), Size(rows=1, values=10))


def test_one_long_text_in_many_rows_is_refused_before_it_takes_memory():
    rows = 200
    long = pa.DictionaryArray.from_arrays(np.zeros(rows, np.int32), ["x" * 1_000_000])
    content = encode(pa.table({"family": long.cast(pa.string())}))
    assert len(content) < 5_000
    usual, pool = pa.default_memory_pool(), pa.proxy_memory_pool(pa.default_memory_pool())
    pa.set_memory_pool(pool)
    try:
        with pytest.raises(InputError, match="holds 200000000 bytes of text"):
            decode(content, Size(rows=rows, values=rows))
        assert pool.max_memory() < 1e7
    finally:
        pa.set_memory_pool(usual)


def test_more_rows_than_there_may_be_are_refused():
    table = pa.table({"scenario_id": ["x"] * 1000})
    with pytest.raises(InputError, match=r"holds 1000 rows .*; expected at most 999 rows"):
        decode(encode(table), Size(rows=999, values=1000))


def test_from_python_what_is_asked_for_is_read_and_what_is_not_there_refused(solved):
    rows = prolearn.read_dataset(solved, 3, "valid", ["fuel", "scenario_id"])
    assert rows.column_names == ["fuel", "scenario_id"]
    assert rows["scenario_id"][0].as_py() == "rings-s5-n3-valid-000000"
    for split, columns, said in (
        ("tset", None, "split is 'tset'; expected train or valid or test"),
        ("valid", ["feul"], "column is 'feul'; expected scenario_id or"),
        ("test", None, "has no rows of n=3 in its test split; expected some"),
    ):
        with pytest.raises(InputError, match=said):
            prolearn.read_dataset(solved, 3, split, columns)
