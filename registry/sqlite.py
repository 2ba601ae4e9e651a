"""An SQLite store before MLflow opens it: found, checked, and opened by one process at a time."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from pipeline.errors import InputError, ProlearnError
from pipeline.urls import public_url

LOCK_SECONDS = 120.0
"""How long another process may take to set up a fresh store; a few seconds is usual."""

ADVICE = "move it away, or set MLFLOW_TRACKING_URI to another file"


def database_path(uri: str) -> Path:
    """Absolute path of the file behind an ``sqlite:///`` address; InputError for one without."""
    name = uri.partition(":///")[2].partition("?")[0]
    if not name or name == ":memory:":
        raise InputError(
            f"MLFLOW_TRACKING_URI is {public_url(uri)!r}; expected a file, such as "
            "sqlite:///mlflow.db, since a store in memory is lost when the command ends."
        )
    return Path(name).absolute()


@contextmanager
def guarded(path: Path, *, create: bool) -> Iterator[None]:
    """Hold the lock beside a database that MLflow may open, create and set up in the block.

    MLflow's migrations of a fresh file collide when several processes start them at once. An
    InputError says where the file is missing and not to be made, or is no store of MLflow.
    """
    if not path.exists():
        if not create:
            raise InputError(
                f"There is no tracking store at {path}; expected one with results in it: run "
                "`prolearn train` here first, change the folder, or set MLFLOW_TRACKING_URI."
            )
        path.parent.mkdir(parents=True, exist_ok=True)
    try:
        with FileLock(f"{path}.lock", timeout=LOCK_SECONDS):
            check_database(path)
            yield
    except Timeout as error:
        raise ProlearnError(
            f"{path}.lock has been held for {LOCK_SECONDS:g} s; expected the process that sets up "
            "the tracking store to be done by now: end it and try again."
        ) from error


def check_database(path: Path) -> None:
    """InputError for a file whose tables are not MLflow's; a missing or empty one will be one."""
    try:
        tables = {name for (name,) in _read(path, "SELECT name FROM sqlite_master")}
    except sqlite3.DatabaseError as error:
        if error.sqlite_errorcode == sqlite3.SQLITE_READONLY_ROLLBACK:
            return  # of a killed writer, whose half a change SQLite takes back once it may write
        raise InputError(
            f"{path} cannot be read ({error}); expected an SQLite tracking store: {ADVICE}."
        ) from error
    if tables and not tables & {"experiments", "alembic_version"}:
        raise InputError(
            f"{path} is an SQLite database of something else; expected a tracking store of "
            f"MLflow: {ADVICE}."
        )


def check_whole(path: Path) -> None:
    """Raise InputError for a database that is damaged; all is read, so this is for a failed one."""
    try:
        ((verdict,),) = _read(path, "PRAGMA quick_check(1)") or [("ok",)]
    except sqlite3.OperationalError:  # locked, or a disk that fails: no word on the content
        return
    except sqlite3.DatabaseError as error:
        verdict = str(error)
    if verdict != "ok":
        raise InputError(
            f"{path} is damaged ({verdict.splitlines()[-1]}); expected a sound SQLite tracking "
            f"store: restore a copy, {ADVICE}."
        )


def _read(path: Path, query: str) -> list[tuple[str]]:
    """The rows that a query gives; none of a file that is missing or empty."""
    if not path.exists() or (path.is_file() and path.stat().st_size == 0):
        return []
    with closing(sqlite3.connect(f"{path.as_uri()}?mode=ro", uri=True)) as database:
        return database.execute(query).fetchall()
