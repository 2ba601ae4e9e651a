import logging
import os
import shutil
import socket
import sqlite3
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from urllib.parse import quote

import mlflow
import pytest
from forked import Forked
from mlflow.tracking import fluent
from processes import SOON
from rights import read_only, room_until_told
from sqlalchemy import create_engine

from pipeline.errors import InputError, ProlearnError
from pipeline.training.loop import Trained
from pipeline.training.search import open_study
from registry.entities import metrics_of
from registry.models import list_versions, load
from registry.store import EXPERIMENTS, TRAINING, connect, opened, recorded_run, store_errors
from registry.training import DatasetInfo, record_training


def test_the_default_store_is_mlflow_db_in_the_current_folder(folder: Path) -> None:
    store = connect()

    assert store.uri == f"sqlite:///{folder / 'mlflow.db'}"
    assert set(store.experiments) == set(EXPERIMENTS)
    with closing(sqlite3.connect(folder / "mlflow.db")) as database:
        names = {name for (name,) in database.execute("SELECT name FROM experiments")}
    assert names >= {"prolearn-training", "prolearn-evaluation", "prolearn-warmstart"}


def test_the_environment_variable_decides_and_stays_as_it_is(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "elsewhere").mkdir()
    shutil.copyfile(folder / "mlflow.db", folder / "elsewhere" / "runs.db")
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "sqlite:///elsewhere/runs.db")

    assert connect().uri == f"sqlite:///{folder / 'elsewhere' / 'runs.db'}"
    assert os.environ["MLFLOW_TRACKING_URI"] == "sqlite:///elsewhere/runs.db"


def test_a_run_and_a_model_in_the_environment_as_in_mlflow_s_projects_are_left_alone(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    client = connect().client
    theirs = client.create_run(client.create_experiment("theirs"))
    model = client.create_logged_model(theirs.info.experiment_id).model_id
    monkeypatch.setenv("MLFLOW_RUN_ID", theirs.info.run_id)
    monkeypatch.setenv("MLFLOW_ACTIVE_MODEL_ID", model)
    fluent._ACTIVE_MODEL_CONTEXT.reset()  # as in a new process
    with opened() as store, recorded_run(store, TRAINING, "ours", {}) as run_id:
        store.client.log_batch(run_id, metrics=metrics_of({"loss": 1.0}))
    assert client.get_run(run_id).info.experiment_id == store.experiments[TRAINING]
    assert client.get_run(theirs.info.run_id).data.tags == theirs.data.tags
    assert not client.get_logged_model(model).metrics
    assert os.environ["MLFLOW_RUN_ID"] == theirs.info.run_id  # for what a program does later


def test_a_new_store_or_study_goes_into_no_datasets_folder(
    solved: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = sorted(solved.iterdir())
    monkeypatch.chdir(solved)
    with pytest.raises(InputError, match="is a dataset's folder; expected another place"):
        connect()
    with pytest.raises(InputError, match="is a dataset's folder; expected another place"):
        open_study(solved / "optuna.db", "any").__enter__()
    assert sorted(solved.iterdir()) == before


def test_a_change_of_folder_is_a_change_of_store(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = connect().uri
    other = tmp_path / "other"
    other.mkdir()
    shutil.copyfile(folder / "mlflow.db", other / "mlflow.db")
    monkeypatch.chdir(other)

    second = connect(create=False)  # to write runs into a copy is refused

    assert second.uri != first
    assert mlflow.get_tracking_uri() == second.uri == f"sqlite:///{other / 'mlflow.db'}"


@pytest.mark.parametrize("name", ["per%20cent", "question?mark=1"])
def test_a_folder_whose_name_means_something_in_an_address_keeps_its_store(
    folder: Path,
    name: str,
    trained: Trained,
    dataset: DatasetInfo,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    here = folder.rename(folder.with_name(name))
    monkeypatch.chdir(here)
    made = record_training(trained, dataset)
    assert [*here.parent.iterdir()] == [here] and connect().folder == here

    monkeypatch.chdir(here.parent)
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{quote(str(here / 'mlflow.db'))}")
    assert list_versions() == [made]


@pytest.mark.parametrize("create", [True, False])
def test_a_folder_whose_name_is_not_utf_8_is_refused_and_gets_no_store(
    fresh: Path, create: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = fresh / os.fsdecode(b"lat\xe9")
    here.mkdir()
    monkeypatch.chdir(here)
    with pytest.raises(InputError, match="is not UTF-8; expected one that is"):
        connect(create=create)
    assert list(here.iterdir()) == []


def test_without_a_home_which_mlflow_needs_a_sentence_says_so(fresh: Path) -> None:
    code = (
        "import pwd\ndef unknown(number):\n    raise KeyError(number)\npwd.getpwuid = unknown\n"
        "from cli.main import app; app()"
    )
    command = [sys.executable, "-c", code, "models", "list"]
    given = {key: value for key, value in os.environ.items() if key != "HOME"}
    done = subprocess.run(command, capture_output=True, text=True, env=given)
    said = "prolearn: there is no home folder; expected HOME to name one: set it.\n"
    assert (done.returncode, done.stderr) == (2, said)


def test_a_user_without_a_name_as_in_a_container_is_recorded_by_number_without_a_word(
    fresh: Path, forked: Forked
) -> None:
    code = (
        "import pwd\ndef unknown(number):\n    raise KeyError(number)\npwd.getpwuid = unknown\n"
        "import importlib, registry\nimportlib.reload(registry)\n"
        "from mlflow.tracking.context.registry import resolve_tags\n"
        "print(resolve_tags()['mlflow.user'])"
    )
    names = {"LOGNAME", "USER", "LNAME", "USERNAME"}
    given = {key: value for key, value in os.environ.items() if key not in names}
    given["HOME"] = str(fresh)
    done = forked.run((), fresh, given, code=code)
    assert (done.stdout, done.stderr) == (f"{os.getuid()}\n", "")


def test_without_pip_a_training_is_recorded_without_a_word(
    folder: Path,
    trained: Trained,
    dataset: DatasetInfo,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("mlflow.utils.environment._get_package_version", lambda name: None)
    record_training(trained, dataset)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("place", ["s3://bucket", "mlflow-artifacts:/1", "file:///files"])
def test_runs_may_keep_their_files_in_another_place(folder: Path, place: str) -> None:
    client = mlflow.MlflowClient(tracking_uri=f"sqlite:///{folder / 'mlflow.db'}")
    made = client.create_experiment(TRAINING, artifact_location=place)
    assert connect().experiments[TRAINING] == made


def test_connecting_twice_finds_the_same_experiments(folder: Path) -> None:
    assert connect().experiments == connect().experiments


def test_several_processes_may_start_a_fresh_store_at_once(fresh: Path, forked: Forked) -> None:
    code = "from registry.store import connect; print(sorted(connect().experiments.values()))"
    with ThreadPoolExecutor() as threads:
        ended = [*threads.map(lambda _: forked.run((), fresh, code=code), range(2))]

    assert [done.returncode for done in ended] == [0, 0], ended
    assert len({done.stdout for done in ended}) == 1
    assert [done.stderr for done in ended] == ["", ""], "MLflow must not chatter"
    with closing(sqlite3.connect(fresh / "mlflow.db")) as database:
        (count,) = database.execute(
            "SELECT count(*) FROM experiments WHERE name LIKE 'prolearn-%'"
        ).fetchone()
    assert count == 5


def test_reading_a_store_that_is_not_there_names_the_command_that_makes_one(fresh: Path) -> None:
    with pytest.raises(InputError, match=r"no tracking store at .*mlflow\.db.*prolearn train"):
        list_versions()
    assert not (fresh / "mlflow.db").exists()


def test_a_store_in_a_place_that_is_read_only_is_read_and_not_written(
    folder: Path, trained: Trained, dataset: DatasetInfo
) -> None:
    made = record_training(trained, dataset)
    (folder / "mlflow.db.lock").unlink()
    before = sorted(folder.rglob("*"))
    with read_only(folder):
        assert list_versions() == [made]
        assert load("ff1")[1] == made
        with pytest.raises(ProlearnError, match=r"Permission denied.*can be read and written"):
            connect()
    assert sorted(folder.rglob("*")) == before


def test_a_file_that_is_no_database_gives_a_sentence(fresh: Path) -> None:
    (fresh / "mlflow.db").write_bytes(b"these are notes, not a database\n" * 100)
    with pytest.raises(InputError, match=r"mlflow\.db cannot be read .*MLFLOW_TRACKING_URI"):
        connect()


def test_a_damaged_database_gives_a_sentence(folder: Path) -> None:
    content = bytearray((folder / "mlflow.db").read_bytes())
    for page in range(4096 * 3, len(content), 4096):
        content[page : page + 64] = b"\xff" * 64
    (folder / "mlflow.db").write_bytes(content)
    with pytest.raises(InputError, match=r"(damaged|cannot be read)"):
        connect()


def bytes_read() -> int:
    """By this process, from disk or from the system's cache."""
    counts = Path("/proc/self/io").read_text().split()
    return int(counts[counts.index("rchar:") + 1])


@pytest.mark.skipif(not Path("/proc/self/io").exists(), reason="needs Linux's count of bytes")
def test_opening_a_large_store_reads_little_of_it(folder: Path) -> None:
    connect()  # what is read once is read now
    before = bytes_read()
    connect()
    small = bytes_read() - before
    with closing(sqlite3.connect(folder / "mlflow.db")) as database:
        database.execute("CREATE TABLE much (data BLOB)")
        database.executemany("INSERT INTO much VALUES (randomblob(10000))", [()] * 3000)
        database.commit()

    before = bytes_read()
    connect()

    assert (folder / "mlflow.db").stat().st_size > 30e6
    assert bytes_read() - before < small + 5e6


def damage(database: Path, table: str) -> None:
    """Overwrite the page on which a table begins."""
    with closing(sqlite3.connect(database)) as opened:
        (size,) = opened.execute("PRAGMA page_size").fetchone()
        query = "SELECT rootpage FROM sqlite_master WHERE name = ?"
        (page,) = opened.execute(query, (table,)).fetchone()
    content = bytearray(database.read_bytes())
    content[(page - 1) * size : page * size] = b"\xff" * size
    database.write_bytes(content)


def test_damage_that_opening_does_not_meet_is_named_when_an_operation_does(folder: Path) -> None:
    store = connect()
    with recorded_run(store, EXPERIMENTS[0], "x", {}) as run_id:
        store.client.log_param(run_id, "seed", 0)
    damage(folder / "mlflow.db", "params")

    connect()
    with pytest.raises(InputError, match=r"mlflow\.db is damaged .*restore a copy"), opened():
        store.client.get_run(run_id)


def test_a_failure_of_a_sound_store_is_not_called_damage(folder: Path) -> None:
    with pytest.raises(ProlearnError, match="failed") as caught, opened() as store:
        store.client.get_run("0" * 32)
    assert not isinstance(caught.value, InputError)


def test_the_database_of_something_else_is_left_alone(fresh: Path) -> None:
    with closing(sqlite3.connect(fresh / "mlflow.db")) as database:
        database.execute("CREATE TABLE holidays (day TEXT)")
        database.commit()
    before = (fresh / "mlflow.db").read_bytes()
    with pytest.raises(InputError, match="something else"):
        connect()
    assert (fresh / "mlflow.db").read_bytes() == before


def test_a_folder_in_place_of_the_database_gives_a_sentence(fresh: Path) -> None:
    (fresh / "mlflow.db").mkdir()
    with pytest.raises(InputError, match="cannot be read"):
        connect()


def test_a_store_of_another_schema_is_not_touched_and_named(folder: Path) -> None:
    with closing(sqlite3.connect(folder / "mlflow.db")) as database:
        database.execute("UPDATE alembic_version SET version_num = '451aebb31d03'")
        database.commit()
    with pytest.raises(ProlearnError, match="out-of-date database schema"):
        connect()


@pytest.mark.parametrize(
    "uri", ["./mlruns", "file:///tmp/mlruns", "sqlite://", "sqlite:///:memory:"]
)
def test_an_address_that_keeps_nothing_is_refused(
    uri: str, fresh: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MLFLOW_TRACKING_URI", uri)
    with pytest.raises(InputError, match=r"MLFLOW_TRACKING_URI is .*sqlite:///"):
        connect()


def test_a_server_that_is_away_is_named_within_seconds_without_its_password(
    fresh: Path, monkeypatch: pytest.MonkeyPatch, free_port: int
) -> None:
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"http://me:secret@127.0.0.1:{free_port}")
    started = time.monotonic()
    with pytest.raises(ProlearnError, match=f"127.0.0.1:{free_port} does not answer") as caught:
        connect()
    assert time.monotonic() - started < SOON
    assert "secret" not in str(caught.value)


def test_a_server_that_accepts_and_says_nothing_is_named_within_seconds(
    fresh: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("registry.store.REACH_SECONDS", 1.0)
    with closing(socket.create_server(("127.0.0.1", 0))) as silent:
        monkeypatch.setenv("MLFLOW_TRACKING_URI", f"http://127.0.0.1:{silent.getsockname()[1]}")
        started = time.monotonic()
        with pytest.raises(ProlearnError, match="does not answer"):
            connect()
    assert time.monotonic() - started < SOON


def test_a_deleted_experiment_is_named_with_the_command_that_restores_it(folder: Path) -> None:
    store = connect()
    store.client.delete_experiment(store.experiments["prolearn-warmstart"])
    with pytest.raises(
        InputError, match=r"prolearn-warmstart was deleted.*mlflow experiments restore"
    ):
        connect()


def test_a_full_disk_is_told_as_a_failure_of_the_store() -> None:
    with (
        pytest.raises(ProlearnError, match=r"No space left on device.*space on the disk"),
        store_errors("sqlite:///mlflow.db"),
    ):
        raise OSError(28, "No space left on device")


def test_a_disk_that_is_full_before_the_store_is_made_is_not_taken_for_an_earlier_kill(
    fresh: Path,
) -> None:
    with (
        pytest.raises(ProlearnError, match=r"disk is full.*space on the disk") as caught,
        store_errors("sqlite:///mlflow.db"),
        create_engine("sqlite:///mlflow.db").connect() as database,
    ):
        database.exec_driver_sql("CREATE TABLE runs (run_uuid)")
        database.exec_driver_sql("PRAGMA max_page_count = 2")
        database.exec_driver_sql("CREATE TABLE experiments (name)")
    assert not isinstance(caught.value, InputError)


def test_a_full_disk_is_said_to_be_why_files_of_the_store_are_not_fetched(folder: Path) -> None:
    with opened() as store, recorded_run(store, TRAINING, "some", {}) as run_id:
        store.client.log_text(run_id, "text", "file.txt")
    with (
        room_until_told() as full,
        pytest.raises(ProlearnError, match=r"File too large.*space on the disk"),
        opened() as store,
    ):
        full()
        mlflow.artifacts.download_artifacts(run_id=run_id, dst_path=str(folder))


def test_a_cursor_that_an_interrupt_leaves_in_a_closed_database_is_not_reported(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    connect()
    with create_engine("sqlite://").connect() as connection:
        result = connection.exec_driver_sql("select 1 union select 2")
        assert result.fetchone() == (1,)
        connection.invalidate()  # as an interrupt does
        result.close()
    assert capsys.readouterr().err == ""


def test_settings_of_the_user_are_kept(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "6")
    monkeypatch.setenv("MLFLOW_LOGGING_LEVEL", "DEBUG")
    logging.getLogger("mlflow").setLevel(logging.DEBUG)

    connect()

    assert mlflow.environment_variables.MLFLOW_HTTP_REQUEST_MAX_RETRIES.get() == 6
    assert logging.getLogger("mlflow").level == logging.DEBUG
