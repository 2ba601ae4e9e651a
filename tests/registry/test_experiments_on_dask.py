"""Experiments with a network on a real Dask cluster that loses a worker."""

from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest
from clusters import Cluster, kill

from cli.jobs.experiments import evaluate, flights, transfer_times
from cli.settings import Evaluation, Flights, TransferTimes
from pipeline.parallel.workers import Workers
from pipeline.progress import Progress
from pipeline.training.loop import Trained
from registry.results import Recorded, experiment_run, table_of
from registry.training import DatasetInfo

pytestmark = pytest.mark.system


class AfterOne(Progress):
    """Does something once the first part is done."""

    def __init__(self, does: Callable[[], object]) -> None:
        self.does, self.parts = does, 0

    def done(self, units: int = 1, note: str = "", *, failed: int | None = None) -> None:
        self.parts += units
        if self.parts == 1:
            self.does()


def test_a_cluster_that_loses_a_worker_gives_the_rows_of_this_machine(
    recorded: Callable[..., object],
    solved: Path,
    trained_lstm: Trained,
    on_solved: DatasetInfo,
    cluster: Cluster,
) -> None:
    recorded(trained_lstm, on_solved)
    cluster.start_workers()
    cluster.await_workers()
    there, data = Workers(scheduler=cluster.address), str(solved)
    progress = AfterOne(lambda: kill(cluster.workers[0]))
    asked = Evaluation(data=data, trials=3, timed=1)
    same(
        evaluate(asked, workers=there.with_progress(progress)), evaluate(asked, workers=Workers(1))
    )
    assert progress.parts > 2

    times = TransferTimes(data=data, n=3, nodes="6", trials=2)
    same(transfer_times(times, workers=there), transfer_times(times, workers=Workers(1)))
    fly = Flights(models="lstm1", data=data, n=3, trials=1, flights=1)
    same(flights(fly, workers=there), flights(fly, workers=Workers(1)))


def same(one: Recorded, other: Recorded) -> None:
    """Both runs have the same rows, but for times."""
    tables = [table_of(experiment_run(done.run_id)) for done in (one, other)]
    left, right = (table.drop(columns="seconds", errors="ignore") for table in tables)
    assert one.run_id != other.run_id
    pd.testing.assert_frame_equal(left, right)
