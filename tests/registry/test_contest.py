"""Trainings that are killed between registration and the contest with the champion, and resumed.

The kills come before one commit of the database after the other, from the version's own on.
"""

import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from cli.jobs.train import train_model, trained_before
from cli.settings import TrainingSettings
from registry.models import list_versions
from registry.store import connect

pytestmark = pytest.mark.system

DIES_AT_EACH_COMMIT = """
import shutil
from pathlib import Path
from sqlalchemy import event
from sqlalchemy.engine import Engine
from blank import leave_blank
from kills import die, kills, run_again
from cli.jobs.train import train_model, trained_before
from cli.settings import TrainingSettings

leave_blank()
data = Path({data!r})
how = TrainingSettings(data=str(data), n=3, epochs=1, device="cpu")

def dies_at(step):
    registered, written, commits = False, False, 0
    @event.listens_for(Engine, "before_cursor_execute")
    def sees(connection, cursor, statement, *_):
        nonlocal registered, written
        registered |= "INSERT INTO model_versions" in statement
        written |= statement.startswith(("INSERT", "UPDATE", "DELETE"))
    @event.listens_for(Engine, "commit")
    def commit(connection):
        nonlocal written, commits
        commits, written = commits + (registered and written), False
        if commits > step:
            die()

def killed(step):
    shutil.copyfile("before.db", "mlflow.db")
    dies_at(step)
    train_model("ff1", 0, how)

def resumed():
    if trained_before("ff1", 0, how) is None:
        train_model("ff1", 0, how)

shutil.copyfile("mlflow.db", "before.db")
for step in kills(killed):
    run_again(resumed)
    shutil.copyfile("mlflow.db", f"{{step:02d}}.db")
"""


def after_kills(folder: Path, data: Path, child: Callable[[str], int]) -> list[Path]:
    """Databases after a kill at each step and a resumed training."""
    assert child(DIES_AT_EACH_COMMIT.format(data=str(data))) == 0
    return sorted(folder.glob("[0-9][0-9].db"))


def versions(folder: Path, database: Path) -> dict[int, tuple[tuple[str, ...], str]]:
    """Aliases and outcome of the contest, by version."""
    shutil.copyfile(database, folder / "mlflow.db")
    return {v.version: (v.aliases, v.contest) for v in list_versions()}


def test_the_first_version_is_champion_wherever_its_training_was_killed(
    folder: Path, solved: Path, child: Callable[[str], int]
) -> None:
    connect()
    after = after_kills(folder, solved, child)
    assert len(after) > 3
    for database in after:
        ((aliases, contest),) = versions(folder, database).values()
        assert aliases == ("champion",)
        assert contest == "the first version of its model"


def test_a_better_version_takes_the_champions_place_wherever_its_training_was_killed(
    folder: Path, solved: Path, child: Callable[[str], int], register: Callable[..., object]
) -> None:
    register(50.0)
    after = after_kills(folder, solved, child)
    assert len(after) > 3
    held = [versions(folder, database) for database in after]
    assert {aliases for one in held for aliases, _ in [one[1]]} == {()}
    assert {aliases for one in held for aliases, _ in [one[2]]} == {("champion",)}
    assert held[0][2][1].startswith("of 6 validation scenarios")
    assert all(one[2][1] for one in held)
    assert {len(one) for one in held} == {2}


def test_what_was_trained_on_another_device_was_not_trained_on_this_one(
    folder: Path, solved: Path
) -> None:
    """The record says cuda; without a wish for a device it counts all the same."""
    how = TrainingSettings(data=str(solved), n=3, epochs=1, device="cpu")
    version, _ = train_model("ff1", 0, how)
    assert trained_before("ff1", 0, how)
    with closing(sqlite3.connect(folder / "mlflow.db")) as database, database:
        database.execute("UPDATE params SET value = 'cuda:0' WHERE key = 'device'")
    assert trained_before("ff1", 0, how) is None
    assert trained_before("ff1", 0, replace(how, device="auto"))[0].version == version.version


def test_what_was_trained_before_is_no_copy_under_another_name(folder: Path, solved: Path) -> None:
    how = TrainingSettings(data=str(solved), n=3, epochs=1, device="cpu")
    version, _ = train_model("ff1", 0, how)
    connect().client.copy_model_version(version.uri, "prolearn-ff1-prod")
    assert trained_before("ff1", 0, how)[0].uri == version.uri


def test_what_was_trained_from_data_that_streamed_was_not_trained_from_all_of_them(
    folder: Path, solved: Path
) -> None:
    how = TrainingSettings(data=str(solved), n=3, epochs=1, device="cpu")
    streaming = replace(how, memory=1e-5)  # 10 kB, of a few instances
    whole, _ = train_model("ff1", 0, how)
    assert trained_before("ff1", 0, how)[0].version == whole.version
    assert trained_before("ff1", 0, streaming) is None
    streamed, _ = train_model("ff1", 0, streaming)
    assert whole.params["mixed"] == "all" and int(streamed.params["mixed"]) > 0
    assert trained_before("ff1", 0, streaming)[0].version == streamed.version
    assert trained_before("ff1", 0, replace(how, memory=1.0))[0].version == whole.version
