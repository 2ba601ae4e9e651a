"""Runs whose process was killed are closed by the next command; those that are written are not."""

import signal
import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest
from rights import read_only

from cli.jobs.tune import tune
from cli.settings import TuningSettings
from pipeline.errors import ProlearnError
from registry.store import EVALUATION, connect, recorded_run

pytestmark = pytest.mark.system

DIES = "import os, signal; os.kill(os.getpid(), signal.SIGKILL)"

RECORDS = f"""
from registry.store import recorded_run
from registry.store import EVALUATION, connect

with recorded_run(connect(), EVALUATION, "outer", {{}}):
    with recorded_run(connect(), EVALUATION, "inner", {{}}):
        {DIES}
"""

Child = Callable[[str], int]


def runs(folder: Path) -> list[tuple[str, str]]:
    """Name and status of every run, as they stand in the database."""
    with closing(sqlite3.connect(folder / "mlflow.db")) as database:
        return database.execute("SELECT name, status FROM runs").fetchall()


def left(folder: Path) -> list[object]:
    """Lock files of runs that are left in a store, and its tags that name a run's process."""
    with closing(sqlite3.connect(folder / "mlflow.db")) as database:
        tags = database.execute("SELECT key FROM tags WHERE key LIKE 'writer.%'").fetchall()
    return [*(folder / "mlruns" / ".running").iterdir(), *tags]


def test_runs_of_a_killed_process_are_closed_by_the_next_that_opens_the_store(
    folder: Path, child: Child
) -> None:
    assert child(RECORDS) == -signal.SIGKILL
    assert {status for _, status in runs(folder)} == {"RUNNING"}
    connect()
    assert sorted(runs(folder)) == [("inner", "KILLED"), ("outer", "KILLED")]
    assert left(folder) == []


def test_a_run_that_is_being_written_stays_open_whoever_opens_the_store(
    folder: Path, child: Child
) -> None:
    with recorded_run(connect(), EVALUATION, "mine", {}):
        assert child("from registry.store import connect; connect()") == 0
        connect()
        assert runs(folder) == [("mine", "RUNNING")]
    assert runs(folder) == [("mine", "FINISHED")]
    assert left(folder) == []


def test_several_commands_that_start_at_once_close_a_run_without_a_word(
    folder: Path, child: Child
) -> None:
    together = """
import os
from registry.store import connect

waiting, go = os.pipe()
children = []
for _ in range(4):
    children.append(os.fork())
    if children[-1] == 0:
        os.close(go)
        os.read(waiting, 1)  # until all are there
        try:
            connect()
        except BaseException:
            os._exit(9)
        os._exit(0)
os.close(go)
assert [os.waitpid(one, 0)[1] for one in children] == [0] * 4
"""
    assert child(RECORDS) == -signal.SIGKILL
    assert child(together) == 0
    assert {status for _, status in runs(folder)} == {"KILLED"}
    assert left(folder) == []


def test_a_run_that_fails_in_an_orderly_way_is_failed_and_nothing_else(folder: Path) -> None:
    with pytest.raises(ZeroDivisionError), recorded_run(connect(), EVALUATION, "mine", {}):
        1 / 0  # noqa: B018
    connect()
    assert runs(folder) == [("mine", "FAILED")]
    assert left(folder) == []


def test_a_run_that_two_processes_write_is_open_until_the_last_of_them_ends(
    folder: Path, child: Child
) -> None:
    store = connect()
    with recorded_run(store, EVALUATION, "search", {}) as run_id:
        pass
    shares = f"""
from registry.store import recorded_run
from registry.store import EVALUATION, connect

with recorded_run(connect(), EVALUATION, "search", {{}}, again={run_id!r}):
    {DIES}
"""
    with recorded_run(store, EVALUATION, "search", {}, again=run_id):
        assert child(shares) == -signal.SIGKILL
        connect()
        assert runs(folder) == [("search", "RUNNING")]
    assert runs(folder) == [("search", "FINISHED")]
    assert child(shares) == child(shares) == -signal.SIGKILL
    connect()
    assert runs(folder) == [("search", "KILLED")]
    assert left(folder) == []


def test_a_search_that_was_killed_is_closed_with_its_trial_and_can_be_gone_on_with(
    folder: Path, child: Child, solved: Path
) -> None:
    asked = {"arch": "ff1", "data": str(solved), "n": 3, "device": "cpu", "epochs": 1}
    options = TuningSettings(trials=2, at_once=2, **asked)
    killed = """
import os, signal
from cli.jobs.tune import tune
from cli.settings import TuningSettings
from pipeline.parallel.workers import Workers
from pipeline.progress import Progress

class Dies(Progress):
    def done(self, *_, **__):
        os.kill(os.getpid(), signal.SIGKILL)

tune(TuningSettings(**SETTINGS), workers=Workers(1, progress=Dies()))
"""
    for _ in range(2):  # the second time the search is reopened
        assert child(killed.replace("SETTINGS", repr(vars(options)))) == -signal.SIGKILL
        assert "RUNNING" in dict(runs(folder)).values()
        connect()
        assert "RUNNING" not in dict(runs(folder)).values()
        options = replace(options, trials=options.trials + 1)
    with closing(sqlite3.connect(folder / "optuna.db")) as database:
        running = "SELECT count(*) FROM trials WHERE state = 'RUNNING'"
        assert database.execute(running).fetchone() == (2,), "what the killed had in hand"
        database.execute("UPDATE trial_heartbeats SET heartbeat = datetime('now', '-181 seconds')")
        database.commit()
        found = tune(options)
        assert database.execute(running).fetchone() == (0,)
    status = connect().client.get_run(found.run_id).info.status
    assert (found.trials, status) == (4, "FINISHED")
    assert left(folder) == []


def test_a_store_that_cannot_be_written_to_keeps_its_open_runs_and_fails_in_a_sentence(
    folder: Path, child: Child
) -> None:
    assert child(RECORDS) == -signal.SIGKILL
    with read_only(folder), pytest.raises(ProlearnError, match="can be read and written"):
        connect()
    connect()
    assert {status for _, status in runs(folder)} == {"KILLED"}
