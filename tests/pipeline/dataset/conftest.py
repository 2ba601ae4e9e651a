"""A small solved dataset, made once and copied."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import fsspec
import pytest

from pipeline.dataset.making import sample, solve
from pipeline.dataset.samples import Sample
from pipeline.expert import Settings
from pipeline.orbit.problem import Problem
from pipeline.parallel.workers import Workers

SAMPLES = {2: Sample(count=7, shard_rows=3), 3: Sample(count=6, shard_rows=3, seed=5)}
"""Five shards, the last of n=2 not full."""


@pytest.fixture(scope="session")
def solved_once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dataset") / "data"
    sample(folder, SAMPLES, Problem(), workers=Workers(1))
    solve(folder, Settings(), workers=Workers(jobs=1))
    return folder


@pytest.fixture
def solved(solved_once: Path, tmp_path: Path) -> Path:
    """A folder of its own with a solved dataset."""
    return Path(shutil.copytree(solved_once, tmp_path / "data"))


@pytest.fixture
def in_memory() -> Iterator[str]:
    """A folder in this process's memory, by URL."""
    yield "memory://prolearn-test/data"
    files = fsspec.filesystem("memory")
    if files.exists("/prolearn-test"):
        files.rm("/prolearn-test", recursive=True)
