import os
import signal
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import mlflow
import numpy as np
import pandas as pd
import pytest
from forked import Forked, Started
from processes import SOON
from tracking import end, serve

from pipeline.errors import ProlearnError
from pipeline.networks.model import load as load_network
from pipeline.training.loop import Trained
from registry.models import load, resolve
from registry.results import latest, record, table_of
from registry.store import EVALUATION, connect, opened, recorded_run
from registry.training import DatasetInfo, record_training

pytestmark = pytest.mark.system


@pytest.fixture
def server(
    folder: Path, free_port: int, forked: Forked, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Started]:
    """``mlflow server`` on loopback with artifacts behind it, as the tracking store."""
    monkeypatch.setenv("TMPDIR", str(folder))  # for lock files that outlive the server
    monkeypatch.setattr(tempfile, "tempdir", None)
    with serve(
        forked, folder, free_port, "server", "--artifacts-destination", "./behind"
    ) as process:
        monkeypatch.setenv("MLFLOW_TRACKING_URI", f"http://127.0.0.1:{free_port}")
        yield process


class EndsTheServer:
    """A setting during whose recording the server goes away."""

    def __init__(self, process: Started) -> None:
        self.process = process

    def __str__(self) -> str:
        end(self.process)
        return "gone"


def test_a_server_does_all_that_a_file_does_and_its_end_loses_no_weights(
    server: Started,
    folder: Path,
    trained: Trained,
    dataset: DatasetInfo,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    initial, goal = np.random.default_rng(0).normal(0, 100, (2, 2, 5, 6))
    wanted = trained.model.predict(initial, goal)

    version = record_training(trained, dataset)
    assert resolve("ff1@champion").uri == version.uri == "models:/prolearn-ff1/1"
    np.testing.assert_array_equal(load("ff1")[0].predict(initial, goal), wanted)
    states = mlflow.pyfunc.load_model(version.uri).predict({"initial": initial, "goal": goal})
    np.testing.assert_array_equal(states, wanted)
    table = pd.DataFrame({"n": [2, 3]})
    record(EVALUATION, table, params={})
    pd.testing.assert_frame_equal(table_of(latest(EVALUATION)), table)
    assert (folder / "behind").is_dir() and not (folder / "mlruns").exists()

    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "1")  # a few seconds less
    started = time.monotonic()
    with pytest.raises(ProlearnError, match=r"127\.0\.0\.1.*kept in .*unregistered"):
        dying = replace(trained, device=EndsTheServer(server))
        record_training(dying, dataset)
    assert time.monotonic() - started < SOON
    (kept,) = (folder / "unregistered").iterdir()
    np.testing.assert_array_equal(load_network(kept).predict(initial, goal), wanted)


DIES = """
import os, signal
from registry.store import recorded_run
from registry.store import EVALUATION, connect

with recorded_run(connect(), EVALUATION, "killed", {}):
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_server_has_runs_of_this_machine_closed_and_is_named_without_its_password(
    server: Started, folder: Path, child: Callable[[str], int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Runs that a killed process left open are closed; the password in an address is used."""
    store = connect()
    elsewhere = store.client.create_run(
        store.experiments[EVALUATION], run_name="elsewhere", tags={"writer.0123": "far"}
    )
    assert elsewhere.info.status == "RUNNING"
    with recorded_run(store, EVALUATION, "mine", {}):
        assert child(DIES) == -signal.SIGKILL
        connect()
        found = store.client.search_runs([store.experiments[EVALUATION]])
        assert {run.info.run_name: run.info.status for run in found} == {
            "elsewhere": "RUNNING",
            "mine": "RUNNING",
            "killed": "KILLED",
        }
    assert list(folder.glob("prolearn-*")) == []

    uri = os.environ["MLFLOW_TRACKING_URI"].replace("://", "://robot:pa55word@")
    monkeypatch.setenv("MLFLOW_TRACKING_URI", uri)
    run_id = record(EVALUATION, pd.DataFrame({"n": [2]}), params={"data": uri})
    assert latest(EVALUATION).run_id == run_id
    assert "pa55word" not in str(latest(EVALUATION).params)

    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "0")
    with pytest.raises(ProlearnError, match=r"http://127\.0\.0\.1.* failed") as caught, opened():
        end(server)
        mlflow.MlflowClient().search_experiments()
    assert "pa55word" not in str(caught.value)


def test_weights_are_kept_where_the_server_is_away_from_the_start(
    fresh: Path,
    free_port: int,
    monkeypatch: pytest.MonkeyPatch,
    trained: Trained,
    dataset: DatasetInfo,
) -> None:
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"http://127.0.0.1:{free_port}")
    started = time.monotonic()
    with pytest.raises(ProlearnError, match=r"does not answer.*kept in") as caught:
        record_training(trained, dataset)
    assert time.monotonic() - started < SOON
    (kept,) = (fresh / "unregistered").iterdir()
    assert str(kept) in str(caught.value)
    initial, goal = np.random.default_rng(0).normal(0, 100, (2, 2, 5, 6))
    np.testing.assert_array_equal(
        load_network(kept).predict(initial, goal), trained.model.predict(initial, goal)
    )
