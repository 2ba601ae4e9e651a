"""Kill -9 while MLflow creates the tables of a new store: the next command completes it."""

import signal
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from forked import Forked
from kills import run_script
from sqlalchemy import Engine, event

from pipeline.errors import InputError, ProlearnError
from registry.store import connect

pytestmark = pytest.mark.system

SCRIPT = """
from kills import die, kills
from sqlalchemy import Engine, event
from registry.store import connect

def killed(step):
    left = [40 * step]

    @event.listens_for(Engine, "before_cursor_execute")
    def count(*_):
        left[0] -= 1
        if left[0] < 0:
            die()

    connect()

print(len([*kills(killed)]))
"""
"""Program that opens the store again and again, each time killed 40 SQL statements later."""


def columns(path: Path) -> set[tuple[str, str]]:
    """Every table of a database with every column."""
    query = "SELECT m.name, c.name FROM sqlite_master m, pragma_table_info(m.name) c"
    with closing(sqlite3.connect(path)) as database:
        return {*database.execute(query)}


def test_a_fresh_store_that_was_killed_again_and_again_is_made_in_the_end(
    fresh: Path, migrated: Path, forked: Forked
) -> None:
    assert int(run_script(forked, SCRIPT)) > 5
    assert columns(fresh / "mlflow.db") == columns(migrated)
    assert connect(create=False).experiments


HALF = """
from kills import die
from mlflow.store.db.utils import _initialize_tables
from sqlalchemy import Engine, create_engine, event

@event.listens_for(Engine, "before_cursor_execute")
def kill(connection, cursor, statement, *_):
    if "DROP TABLE tags" in statement:
        die()

_initialize_tables(create_engine("sqlite:///mlflow.db"))
"""


@pytest.fixture
def half_made(fresh: Path, forked: Forked) -> Path:
    """A store that was killed amid a step of MLflow's own, which then cannot be done again."""
    assert forked.run((), fresh, code=HALF).returncode == -signal.SIGKILL
    return fresh / "mlflow.db"


def test_a_half_made_store_of_an_earlier_version_is_named_and_may_be_deleted(
    half_made: Path,
) -> None:
    before = half_made.read_bytes()
    with pytest.raises(InputError, match=r"mlflow\.db was left half made .*no runs.* delete it"):
        connect()
    assert half_made.read_bytes() == before


def test_a_half_made_store_with_a_run_in_it_is_not_to_be_deleted(half_made: Path) -> None:
    with closing(sqlite3.connect(half_made)) as database:
        database.execute("INSERT INTO runs (run_uuid, experiment_id) VALUES ('a', 0)")
        database.commit()
    with pytest.raises(ProlearnError, match="failed") as caught:
        connect()
    assert not isinstance(caught.value, InputError)


def test_ctrl_c_ends_a_command_when_its_store_is_made(fresh: Path, migrated: Path) -> None:
    def interrupt(connection: object, cursor: object, statement: str, *_: object) -> None:
        if "DROP TABLE tags" in statement:
            signal.raise_signal(signal.SIGINT)

    event.listen(Engine, "before_cursor_execute", interrupt)
    try:
        with pytest.raises(KeyboardInterrupt):
            connect()
    finally:
        event.remove(Engine, "before_cursor_execute", interrupt)
    assert columns(fresh / "mlflow.db") == columns(migrated)
    assert connect().experiments
