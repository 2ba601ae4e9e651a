"""Several trainings at once, on processes of this machine and on a Dask cluster."""

from pathlib import Path

import pytest
from clusters import Cluster

from cli.jobs.train import AskedTraining, train_model, train_models, trained_before
from cli.settings import TrainingSettings
from pipeline.errors import InputError, ProlearnError
from pipeline.parallel.workers import Workers
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


def test_trainings_at_once_give_the_networks_of_one_after_the_other(
    how: TrainingSettings, cluster: Cluster
) -> None:
    alone = [weights(train_model(*one, how)[0]) for one in ASKED]
    asked = [AskedTraining.of(*one, how) for one in ASKED]
    cluster.start_workers()
    for workers in (Workers(jobs=2), Workers(scheduler=cluster.address)):
        found = train_models(asked, workers)
        assert [weights(version) for version, _ in found] == alone
        assert all(contest.reason for _, contest in found)
        newest = trained_before(*ASKED[1], how)
        assert newest is not None
        assert newest[0].version == found[1][0].version


def test_a_worker_that_reads_other_data_is_refused(
    how: TrainingSettings,
) -> None:
    asked = [AskedTraining("ff1", seed, how, "0" * 64) for seed in (0, 1)]
    with pytest.raises(ProlearnError, match="other data on a worker"):
        train_models(asked, Workers(jobs=1))


def test_data_without_the_size_are_refused_before_a_store_is_made(
    fresh: Path, solved: Path
) -> None:
    with pytest.raises(InputError, match="no scenarios of n=7"):
        train_model("ff1", 0, TrainingSettings(data=str(solved), n=7, device="cpu"))
    assert not list(fresh.glob("mlflow.db*"))
