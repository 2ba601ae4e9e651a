"""Several trainings and trials at once, on processes of this machine and on a Dask cluster."""

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import optuna
import pytest
from clusters import Cluster, kill

from cli.jobs.train import train_model, train_models, trained_before
from cli.jobs.training import TrainingTask
from cli.jobs.tune import tune
from cli.settings import TrainingSettings, TuningSettings
from pipeline.errors import InputError, ProlearnError
from pipeline.parallel.workers import Workers
from pipeline.progress import Progress
from registry.models import ModelVersion, load

pytestmark = pytest.mark.system

ASKED = (("ff1", 0), ("ff1", 1))


def weights(version: ModelVersion) -> tuple[str, int, str, dict[str, float]]:
    """What must not depend on where a network was trained."""
    measured = {k: v for k, v in version.metrics.items() if "seconds" not in k}
    return version.arch, version.training_seed, load(version)[0].digest, measured


@pytest.fixture
def how(folder: Path, solved: Path) -> TrainingSettings:
    return TrainingSettings(data=str(solved), n=3, epochs=2, device="cpu")


class Kills(Progress):
    """Kills a worker of a cluster as soon as anything is done."""

    def __init__(self, cluster: Cluster) -> None:
        self.cluster, self.complete = cluster, 0

    def done(self, units: int = 1, note: str = "", *, failed: int | None = None) -> None:
        self.complete += units
        if self.complete == 1:
            kill(self.cluster.workers[0])


def trials(
    how: TrainingSettings, path: Path, workers: Workers
) -> list[tuple[int, float | None, dict[str, Any]]]:
    """Number, value and parameters of each trial of a search that is kept in a new file."""
    asked = {"data": how.data, "n": how.n, "device": "cpu", "epochs": 1, "storage": path}
    tune(TuningSettings(arch="ff1", trials=5, at_once=3, **asked), workers=workers)
    study = optuna.load_study(study_name=None, storage=f"sqlite:///{path}")
    return [(one.number, one.value, one.params) for one in study.trials]


def test_trainings_and_trials_at_once_are_those_of_one_after_the_other(
    how: TrainingSettings, cluster: Cluster, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    alone = [weights(train_model(*one, how)[0]) for one in ASKED]
    # The data are given by a path from the current folder, which is not that of the cluster.
    asked = [TrainingTask.of(*one, replace(how, data=os.path.relpath(how.data))) for one in ASKED]
    with monkeypatch.context() as elsewhere:
        elsewhere.chdir("/")
        cluster.start_workers()
    for workers in (Workers(jobs=2), Workers(scheduler=cluster.address)):
        found = train_models(asked, workers)
        assert [weights(version) for version, _ in found] == alone
        assert all(contest.reason for _, contest in found)
        newest = trained_before(*ASKED[1], how)
        assert newest is not None
        assert newest[0].version == found[1][0].version

    one = trials(how, folder / "one.db", Workers(1))
    assert all(value is not None for _, value, _ in one)
    assert trials(how, folder / "two.db", Workers(2)) == one
    progress = Kills(cluster)
    there = Workers(scheduler=cluster.address, progress=progress)
    assert trials(how, folder / "there.db", there) == one
    assert progress.complete == 5


@pytest.mark.parametrize(
    ("change", "found"), [({"digest": "0" * 64}, "other"), ({"data": "/nowhere"}, "no such")]
)
def test_a_worker_that_reads_other_data_or_none_is_refused(
    how: TrainingSettings, change: dict[str, str], found: str
) -> None:
    asked = [replace(TrainingTask.of("ff1", k, how), **change) for k in (0, 1)]
    with pytest.raises(ProlearnError, match=f"{found} data on a worker"):
        train_models(asked, Workers(jobs=1))


def test_data_without_the_size_are_refused_before_a_store_is_made(
    fresh: Path, solved: Path
) -> None:
    with pytest.raises(InputError, match="no scenarios of n=7"):
        train_model("ff1", 0, TrainingSettings(data=str(solved), n=7, device="cpu"))
    assert not list(fresh.glob("mlflow.db*"))
