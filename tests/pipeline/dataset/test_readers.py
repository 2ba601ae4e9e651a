"""What the documentation shows is run as it stands, on a dataset of ours."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest

from pipeline.dataset.making import sample, solve
from pipeline.dataset.reading import solved_rows
from pipeline.dataset.samples import Sample
from pipeline.dataset.schema import SOLVED_FIELDS
from pipeline.expert import Settings
from pipeline.orbit.problem import Problem
from pipeline.parallel.workers import Workers

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs/dataset.md").read_text()
SNIPPETS = re.findall(
    r"```python\n(.*?)```", PAGE.split("## In other programs")[1].split("\n## ")[0], re.DOTALL
)
READERS = ("pyarrow", "pandas", "polars", "duckdb")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two shards of n=10 with a row that has no plan between those that have one."""
    root = tmp_path_factory.mktemp("readers")
    samples = {10: Sample(count=6, shard_rows=4)}
    problem = Problem(max_acceleration=7e-4)
    sample(root / "data/n10", samples, problem, workers=Workers(1))
    solve(root / "data/n10", Settings(), workers=Workers(jobs=1))
    return root


@pytest.mark.parametrize("reader", READERS)
def test_the_line_for_each_reader_gives_the_states_in_their_shape(reader, folder, monkeypatch):
    (snippet,) = (text for text in SNIPPETS if f"import {reader}" in text or f", {reader}" in text)
    monkeypatch.chdir(folder)
    names = {}
    exec(snippet, names)
    rows = solved_rows("data/n10", 10).to_pylist()
    wanted = [np.reshape(row["states"], (10, 11, 6)) for row in rows if row["status"] == "solved"]
    assert 0 < len(wanted) < 6
    assert np.array_equal(names["states"], wanted)
    assert reader in sys.modules


def test_every_column_is_documented():
    table = PAGE.split("## Columns")[1].split("##")[0]
    assert set(re.findall(r"`(\w+)`", table.split("Every scenario")[0])) >= {
        field.name for field in SOLVED_FIELDS
    }
