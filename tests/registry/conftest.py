"""A tracking store made once and copied, and a small network trained once."""

import shutil
import socket
import sqlite3
import sys
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from blank import leave_blank
from forked import Forked
from noisy import network
from short_transfer import PROBLEM

from pipeline.dataset.examples import Examples
from pipeline.dataset.making import sample, solve
from pipeline.dataset.manifest import read_manifest
from pipeline.dataset.samples import Sample
from pipeline.expert import Settings
from pipeline.networks.architecture import recipe_for
from pipeline.networks.model import Model
from pipeline.networks.recipes import Recipe
from pipeline.orbit.transfer import fly, minimum_energy
from pipeline.parallel.workers import Workers
from pipeline.scenario import draw
from pipeline.training.loop import Epoch, Trained, train
from registry.models import ModelVersion
from registry.store import connect
from registry.training import DatasetInfo, record_training

CRAFT = 3

PLACES = {
    "experiments": "artifact_location",
    "runs": "artifact_uri",
    "logged_models": "artifact_location",
    "model_versions": "storage_location",
}
"""Columns of a store with the places of files, by table."""

Once = Callable[[object, Callable[[], Any]], Any]
Recorded = Callable[..., ModelVersion]
"""`once` and `recorded`, as fixtures."""


def examples(count: int, first: int) -> Examples:
    """Minimum-energy transfers between random rings."""
    problem = PROBLEM
    drawn = [draw("rings", 0, CRAFT, first + k, problem) for k in range(count)]
    initial = np.stack([s.initial for s in drawn])
    goal = np.stack([s.goal for s in drawn])
    return Examples(
        problem, initial, goal, fly(initial, minimum_energy(initial, goal, problem), problem)
    )


@pytest.fixture(scope="session", autouse=True)
def known_schema() -> None:
    """MLflow reads all its migrations whenever a store is opened, to find which is the newest."""
    from mlflow.store.db import utils

    utils._get_latest_schema_revision = cache(utils._get_latest_schema_revision)


@pytest.fixture(scope="session", autouse=True)
def known_statements() -> None:
    """SQLAlchemy compiles each statement of MLflow's once for all stores, and not for each anew."""
    from mlflow.store.db import utils

    create, shared = utils.create_sqlalchemy_engine, dict[str, Any]()

    def created(uri: str) -> Any:
        engine = create(uri)
        for name in ("dialect", "_compiled_cache"):  # whose entries are of a dialect
            setattr(engine, name, shared.setdefault(name, getattr(engine, name)))
        return engine

    utils.create_sqlalchemy_engine = created


@pytest.fixture(autouse=True)
def undrawn(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are blank, but in tests marked ``drawn``."""
    if "drawn" not in request.keywords:
        leave_blank(monkeypatch)


@pytest.fixture(scope="session")
def recipe() -> Recipe:
    return recipe_for("ff1", "tuned")


@pytest.fixture(scope="session")
def trained(recipe: Recipe) -> Trained:
    few = replace(recipe, epochs=2)
    return train("ff1", few, examples(20, 0), examples(5, 20), seed=3, device="cpu")


@pytest.fixture(scope="session")
def trained_lstm(recipe: Recipe) -> Trained:
    few = replace(recipe, epochs=1)
    return train("lstm1", few, examples(8, 0), examples(4, 20), seed=3, device="cpu")


@pytest.fixture(scope="session")
def dataset() -> DatasetInfo:
    return DatasetInfo("data/paper", "0123456789abcdef" * 4, train_instances=20, valid_instances=5)


@pytest.fixture
def folder(tmp_path: Path, migrated: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A current folder of its own, with a space in its name, that has a store."""
    here = tmp_path / "my project"
    here.mkdir()
    shutil.copyfile(migrated, here / "mlflow.db")
    monkeypatch.chdir(here)
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    return here


@pytest.fixture(scope="session")
def kept() -> dict[object, tuple[Path, Path, Any]]:
    """Cache of filled stores, by how they were filled: original folder, its copy, and result."""
    return {}


@pytest.fixture
def once(
    folder: Path,
    kept: dict[object, tuple[Path, Path, Any]],
    tmp_path_factory: pytest.TempPathFactory,
) -> Once:
    """Function that fills a new store, or copies the store that an identical call filled before.

    To write one training takes MLflow and Matplotlib a quarter of a second.
    """
    from mlflow.tracking._tracking_service.utils import _artifact_repos_cache

    def done(what: object, work: Callable[[], Any]) -> Any:
        if (folder / "mlflow.db.lock").exists():  # no longer new
            return work()
        if what not in kept:
            result, copy = work(), tmp_path_factory.mktemp("once") / "project"
            kept[what] = folder, shutil.copytree(folder, copy), result
            return result
        before, copy, result = kept[what]
        shutil.copytree(copy, folder, dirs_exist_ok=True)
        with closing(sqlite3.connect(folder / "mlflow.db")) as database, database:
            for table, place in PLACES.items():
                change = f"UPDATE {table} SET {place} = replace({place}, ?, ?)"
                database.execute(change, (before.as_uri(), folder.as_uri()))
        _artifact_repos_cache.clear()  # MLflow's places of files by run, whatever the store
        connect()  # as the work has
        return result

    return done


@pytest.fixture
def recorded(once: Once) -> Recorded:
    """Function that records a training run, or copies the run recorded by an identical call."""

    def record(trained: Trained, *given: Any) -> ModelVersion:
        how = trained.recipe, trained.seed, *given
        what = trained.model.architecture, trained.model.digest, repr(how)
        version: ModelVersion = once(what, lambda: record_training(trained, *given))
        return version

    return record


@pytest.fixture
def fresh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A current folder without a store."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    return tmp_path


@pytest.fixture(scope="session")
def solved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small dataset, drawn and solved by the expert."""
    path = tmp_path_factory.mktemp("data") / "small"
    one = Sample(count=24, shares=(0.5, 0.25, 0.25))
    sample(path, {CRAFT: one}, PROBLEM, workers=Workers(1))
    solve(path, Settings(), workers=Workers(jobs=1))
    return path


@pytest.fixture
def on_solved(solved: Path) -> DatasetInfo:
    """That dataset, as what a network was trained on."""
    return DatasetInfo(str(solved), read_manifest(solved).digest(CRAFT), 12, 6)


@pytest.fixture
def register(
    recorded: Recorded, recipe: Recipe, solved: Path
) -> Callable[..., tuple[ModelVersion, Model]]:
    """Register a network with so much noise on its answers."""

    def one(scale: float, data: str = "") -> tuple[ModelVersion, Model]:
        model = network(scale)
        trained = Trained(model, recipe, 0, (Epoch(1, 1.0, 1.0, 0.1),), 1, 0.1, "cpu")
        used = DatasetInfo(data or str(solved), read_manifest(solved).digest(CRAFT), 12, 6)
        return recorded(trained, used), model

    return one


@pytest.fixture
def child(forked: Forked, folder: Path) -> Callable[[str], int]:
    """Run code in a process of its own, in the folder of the store; its exit status."""

    def run(code: str) -> int:
        done = forked.run((), folder, code=code)
        print(done.stderr, file=sys.stderr)
        return done.returncode

    return run


@pytest.fixture
def free_port() -> int:
    """A port on loopback that nothing listens on."""
    with closing(socket.create_server(("127.0.0.1", 0))) as probe:
        port: int = probe.getsockname()[1]
    return port
