"""The MLflow tracking store: opened safely, an SQLite file checked, failures as sentences.

A process that writes runs holds a lock file, whose token is in a tag of each run. Whoever opens
the store next and finds a lock file that nobody holds closes the runs with its tag.
"""

import hashlib
import logging
import os
import platform
import sqlite3
import ssl
import tempfile
import urllib.error
import urllib.request
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from errno import EACCES, EPERM, EROFS
from http.client import HTTPException
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import mlflow
from filelock import FileLock, Timeout
from mlflow.entities import ViewType
from mlflow.exceptions import MlflowException
from mlflow.telemetry import set_telemetry_client
from sqlalchemy import create_engine, event
from sqlalchemy.exc import SQLAlchemyError

from pipeline.errors import InputError, ProlearnError
from pipeline.files import refuse_dataset, refuse_undecodable
from pipeline.parallel.processes import waiting_signals
from pipeline.scratch import TOKEN, clear_dead, clear_scratch, held_lock_file
from pipeline.text import first_line, public, public_url, sqlite_url
from registry.entities import pages

DEFAULT_URI = "sqlite:///mlflow.db"

TRAINING = "prolearn-training"
EVALUATION = "prolearn-evaluation"
WARMSTART = "prolearn-warmstart"
TRANSFER_TIMES = "prolearn-transfer-times"
FLIGHTS = "prolearn-flights"
EXPERIMENTS = (TRAINING, EVALUATION, WARMSTART, TRANSFER_TIMES, FLIGHTS)

TUNING = "prolearn-tuning"  # made when it is first needed: ``opened(TUNING)``
REACH_SECONDS = 4.0  # within which a tracking server must give any answer

# Settings of MLflow for this process, where the user has chosen none
PROCESS_DEFAULTS = {
    "MLFLOW_DISABLE_TELEMETRY": "true",
    "MLFLOW_HTTP_REQUEST_MAX_RETRIES": "2",
    "MLFLOW_HTTP_REQUEST_BACKOFF_FACTOR": "1",
    "MLFLOW_HTTP_REQUEST_TIMEOUT": "30",
    "MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR": "false",
    "MLFLOW_SUPPRESS_PRINTING_URL_TO_STDOUT": "true",
    "MLFLOW_UV_AUTO_DETECT": "false",
}
# Where MLflow would write instead of our run and model: set in its projects, and for traces
ELSEWHERE = "MLFLOW_RUN_ID", "MLFLOW_ACTIVE_MODEL_ID"
# Log levels of loggers of MLflow and its libraries, by name
LOG_LEVELS = {
    **dict.fromkeys(("mlflow", "alembic"), logging.WARNING),
    # It warns where there is no pip, as in environments of uv, which does not affect a model.
    "mlflow.utils.environment": logging.ERROR,
    # What it logs with a traceback it raises too, and the person gets it as a sentence.
    "mlflow.store.db.utils": logging.CRITICAL,
    # It logs one where an interrupt has closed the database amid a query.
    "sqlalchemy.pool": logging.CRITICAL,
}
LOCK_SECONDS = 120.0  # that another process may take to set up a fresh store; a few are usual
WRITER = "writer."  # prefix of the tag that has the token of a process that writes a run
# What MLflow raises where a store fails, or its files are where it cannot reach them
FAILURES = (MlflowException, SQLAlchemyError, OSError, ImportError)
ADVICE = "move it away, or set MLFLOW_TRACKING_URI to another file"


@dataclass(frozen=True)
class Store:
    """An open tracking store."""

    uri: str  # where it is; an SQLite file by its absolute path
    client: Any  # MLflow's, for it
    experiments: Mapping[str, str]  # ids by name

    @property
    def folder(self) -> Path:
        """The folder of an SQLite file; where the store is a server, the current one."""
        return database_path(self.uri).parent if self.uri.startswith("sqlite:") else Path.cwd()

    @property
    def locks(self) -> tuple[Path, str]:
        """Folder and prefix of the lock files of processes that write runs."""
        if self.uri.startswith("sqlite:"):
            path = database_path(self.uri).resolve()
            return path.parent / "mlruns" / ".running", f"{path.name}-"
        store = hashlib.sha256(self.uri.encode()).hexdigest()[:12]
        return Path(tempfile.gettempdir()), f"prolearn-run-{store}-"


def connect(*more: str, create: bool = True) -> Store:
    """The tracking store, with EXPERIMENTS and ``more`` in it.

    Runs and temporary folders that killed commands left open are closed and removed. An SQLite
    store that is not there yet is made, or, without ``create``, an InputError, as is one that is
    corrupt or something else's.
    """
    _prepare_process()
    uri = os.environ.get("MLFLOW_TRACKING_URI") or DEFAULT_URI
    with store_errors(uri):
        store = _connect(uri, create, (*EXPERIMENTS, *more))
        with suppress(*FAILURES):
            clear_dead(*store.locks, lambda name: _close(store.client, name))
    clear_scratch()
    return store


@contextmanager
def opened(*more: str, create: bool = True) -> Iterator[Store]:
    """The tracking store, whose failures in the block become a ProlearnError."""
    with _unset(ELSEWHERE):
        store = connect(*more, create=create)
        with store_errors(store.uri):
            yield store


@contextmanager
def _unset(names: Sequence[str]) -> Iterator[None]:
    """Remove environment variables inside the block, and restore them after it."""
    given = {name: os.environ.pop(name) for name in names if name in os.environ}
    try:
        yield
    finally:
        os.environ.update(given)


@contextmanager
def store_errors(uri: str) -> Iterator[None]:
    """Turn MLflow's errors into a ProlearnError about ``uri``, InputError for a damaged file."""
    try:
        yield
    except FAILURES as error:
        if uri.startswith("sqlite:"):
            path = database_path(uri)
            _check_sound(path)
            if getattr(getattr(error, "orig", None), "sqlite_errorcode", 0) != sqlite3.SQLITE_FULL:
                _check_made(path)
        reason = public(_reason(error), uri)[:300]
        raise ProlearnError(
            f"The tracking store {public_url(uri)} failed ({reason}); expected one that can be "
            "read and written: check MLFLOW_TRACKING_URI, the server and the space on the disk."
        ) from error


def _reason(error: BaseException) -> str:
    """The cause of an error in one line; for several files that MLflow cannot fetch, the last's."""
    lines = str(error).splitlines()
    return first_line(lines[-1] if lines and lines[0].endswith(":") else error)


@contextmanager
def recorded_run(
    store: Store, experiment: str, name: str, tags: Mapping[str, str], *, again: str | None = None
) -> Iterator[str]:
    """An MLflow run, new or of the id ``again``: FINISHED after the block, or FAILED."""
    folder, prefix = store.locks
    with held_lock_file(folder, prefix, keep_on_error=True) as process:
        key = f"{WRITER}{process[-TOKEN:]}"
        with mlflow.start_run(
            run_id=again,
            experiment_id=store.experiments[experiment],
            run_name=name,
            tags={**tags, key: platform.node() or "unknown"},
            nested=True,
            log_system_metrics=False,
        ) as run:
            yield run.info.run_id
        with suppress(*FAILURES):  # a tag that stays does no harm
            store.client.delete_tag(run.info.run_id, key)


def _close(client: Any, name: str) -> None:
    """Mark as KILLED the runs that the dead holder of a lock file was writing, and nobody else."""
    key = f"{WRITER}{name[-TOKEN:]}"
    experiments = [found.experiment_id for found in pages(client.search_experiments)]
    query = {"experiment_ids": experiments, "filter_string": f"tags.`{key}` LIKE '%'"}
    for run in list(pages(client.search_runs, **query)):
        writers = [tag for tag in run.data.tags if tag.startswith(WRITER)]
        if run.info.status == "RUNNING" and writers == [key]:
            client.set_terminated(run.info.run_id, "KILLED")
        client.delete_tag(run.info.run_id, key)


def _prepare_process() -> None:
    for name, value in PROCESS_DEFAULTS.items():
        os.environ.setdefault(name, value)
    set_telemetry_client()  # reads its switch anew
    if "MLFLOW_LOGGING_LEVEL" not in os.environ:
        for name, level in LOG_LEVELS.items():
            if (log := logging.getLogger(name)).level != level:  # a change slows all loggers down
                log.setLevel(level)


def _connect(uri: str, create: bool, names: Sequence[str]) -> Store:
    if uri.startswith("sqlite:"):
        path, (_, mark, query) = database_path(uri), uri.partition("?")
        locations = {name: (path.parent / "mlruns" / name).as_uri() for name in names}
        with _guarded(path, create=create) as whole:
            if not whole:
                _set_up(path)
            return _open(f"{sqlite_url(path)}{mark}{query}", locations, path if create else None)
    if uri.startswith("file:") or ("://" not in uri and uri != "databricks"):
        raise InputError(
            f"MLFLOW_TRACKING_URI is {public_url(uri)!r}; expected sqlite:///FILE or the "
            "address of a tracking server, since MLflow no longer keeps runs in folders."
        )
    if uri.startswith(("http://", "https://")):
        _check_reachable(uri)
    try:
        return _open(uri, dict.fromkeys(names))
    except ValueError as error:  # as of a port that is no number
        raise InputError(
            f"MLFLOW_TRACKING_URI is {public_url(uri)!r}, which cannot be used "
            f"({public(first_line(error), uri)}); expected the address of a server: correct it."
        ) from error


def _set_up(path: Path) -> None:
    """Create or migrate MLflow's tables in an SQLite file, each migration in one transaction.

    MLflow's own connection commits parts of a step, from which no later process can continue. Here
    each step is one transaction, so that the next process repeats the one that a kill undid.
    """
    from mlflow.store.db import utils  # slow to import, and only files need it

    engine = create_engine(sqlite_url(path))
    event.listen(engine, "connect", lambda made, _: setattr(made, "isolation_level", None))
    event.listen(engine, "begin", lambda connection: connection.exec_driver_sql("BEGIN"))
    try:
        if not utils._all_tables_exist(engine):
            with waiting_signals():  # Alembic takes Ctrl-C for a failure of the database
                utils._initialize_tables(engine)
    finally:
        engine.dispose()


def _open(uri: str, locations: Mapping[str, str | None], written: Path | None = None) -> Store:
    """Open the tracking store at a URI; ``written`` is its SQLite file where runs will be added."""
    given = os.environ.get("MLFLOW_TRACKING_URI")
    mlflow.set_tracking_uri(uri)
    # MLflow writes the address into the environment, where it would outlive a change of folder.
    if given is None:
        os.environ.pop("MLFLOW_TRACKING_URI", None)
    else:
        os.environ["MLFLOW_TRACKING_URI"] = given
    client = mlflow.MlflowClient(tracking_uri=uri)
    ours = {"view_type": ViewType.ALL, "filter_string": "name LIKE 'prolearn-%'"}
    there = {one.name: one for one in pages(client.search_experiments, **ours)}
    if written is not None:
        for name in there.keys() & locations.keys():
            _refuse_copy(written, there[name].artifact_location)
    ids = {
        name: _experiment(client, name, where, there.get(name)) for name, where in locations.items()
    }
    return Store(uri, client, ids)


def _experiment(client: Any, name: str, location: str | None, found: Any) -> str:
    """Id of an experiment, made where none was found, whoever else is making it."""
    if found is None:
        try:
            return str(client.create_experiment(name, artifact_location=location))
        except MlflowException as error:
            if error.error_code != "RESOURCE_ALREADY_EXISTS":
                raise
            found = client.get_experiment_by_name(name)
    if found.lifecycle_stage != "active":
        raise InputError(
            f"The experiment {name} was deleted; expected it in the tracking store: bring it "
            f"back with `mlflow experiments restore -x {found.experiment_id}`."
        )
    return str(found.experiment_id)


def _refuse_copy(database: Path, location: str) -> None:
    """InputError where runs of a moved or copied project would put files into the old one."""
    if not location.startswith("file:"):
        return
    old = Path(unquote(urlsplit(location).path)).parent.parent
    beside = old.resolve() == database.parent.resolve()
    if not beside and (not old.exists() or (old / database.name).exists()):
        raise InputError(
            f"{database} keeps the files of its runs in {old}; expected them beside it, where it "
            "was not moved or copied: run the lines of docs/mlflow.md, After moving a project."
        )


def _check_reachable(uri: str) -> None:
    """Refuse a server that does not answer; any answer at all counts as one."""
    try:
        # urllib takes a password for a part of the host's name; health needs none.
        health = f"{public_url(uri).rstrip('/')}/health"
        urllib.request.urlopen(health, timeout=REACH_SECONDS).close()
    except urllib.error.HTTPError:
        return
    except (OSError, ValueError, HTTPException) as error:
        reason = getattr(error, "reason", error)
        if isinstance(reason, ssl.SSLError):  # it answers; MLflow has its own rules for these
            return
        raise ProlearnError(
            f"The tracking server {public_url(uri)} does not answer ({public(reason, uri)}); "
            "expected a reachable MLflow server: start it, or correct or unset MLFLOW_TRACKING_URI."
        ) from error


def database_path(uri: str) -> Path:
    """Absolute path of the file behind an ``sqlite:///`` address.

    InputError for an address without, and for a path that is not UTF-8, which SQLite lacks.
    """
    name = unquote(uri.partition(":///")[2].partition("?")[0])
    if not name or name == ":memory:":
        raise InputError(
            f"MLFLOW_TRACKING_URI is {public_url(uri)!r}; expected a file, such as "
            "sqlite:///mlflow.db, since a store in memory is lost when the command ends."
        )
    path = Path(name).absolute()
    refuse_undecodable(path)
    return path


@contextmanager
def _guarded(path: Path, *, create: bool) -> Iterator[bool]:
    """Hold the lock beside a database that MLflow may open, create and migrate in the block.

    Yields whether all tables are there. Migrations of a fresh file collide when several processes
    start them at once. Without ``create`` a file beside which no lock can be made is read without.
    InputError where the file is missing and not to be made, or is no store of MLflow.
    """
    if not path.exists():
        if not create:
            raise InputError(
                f"There is no tracking store at {path}; expected one with results in it: run "
                "`prolearn train` here first, change the folder, or set MLFLOW_TRACKING_URI."
            )
        refuse_dataset(path)
        path.parent.mkdir(parents=True, exist_ok=True)
    try:
        with ExitStack() as held:
            try:
                held.enter_context(FileLock(f"{path}.lock", timeout=LOCK_SECONDS))
            except OSError as error:
                if create or error.errno not in (EACCES, EPERM, EROFS):
                    raise
            yield _check_database(path)
    except Timeout as error:
        raise ProlearnError(
            f"{path}.lock has been held for {LOCK_SECONDS:g} s; expected the process that sets up "
            "the tracking store to be done by now: end it and try again."
        ) from error


def _check_database(path: Path) -> bool:
    """Whether a file has all of MLflow's tables; InputError where it has others than MLflow's."""
    from mlflow.store.db.utils import Base  # slow to import, and only files need it

    try:
        tables = {name for (name,) in _read(path, "SELECT name FROM sqlite_master")}
    except sqlite3.DatabaseError as error:
        if error.sqlite_errorcode == sqlite3.SQLITE_READONLY_ROLLBACK:
            return False  # a killed writer's: SQLite rolls its change back once it may write
        raise InputError(
            f"{path} cannot be read ({error}); expected an SQLite tracking store: {ADVICE}."
        ) from error
    if tables and not tables & {"experiments", "alembic_version"}:
        raise InputError(
            f"{path} is an SQLite database of something else; expected MLflow's: {ADVICE}."
        )
    return {*Base.metadata.tables} <= tables


def _check_sound(path: Path) -> None:
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


def _check_made(path: Path) -> None:
    """Raise InputError for a failed store that lacks tables and holds no runs.

    Earlier versions of prolearn left those behind where they were killed.
    """
    from mlflow.store.db.base_sql_model import Base

    with suppress(sqlite3.OperationalError):  # no table of runs, locked, or a disk that fails
        tables = {name for (name,) in _read(path, "SELECT name FROM sqlite_master")}
        lacking = tables and not {*Base.metadata.tables} <= tables
        if lacking and not _read(path, "SELECT run_uuid FROM runs LIMIT 1"):
            raise InputError(
                f"{path} was left half made by a command that was killed, and holds no runs; "
                "expected a whole tracking store: delete it and run the same command again."
            )


def _read(path: Path, query: str) -> list[tuple[str]]:
    """The rows that a query gives; none of a file that is missing or empty."""
    if not path.exists() or (path.is_file() and path.stat().st_size == 0):
        return []
    with closing(sqlite3.connect(f"{path.as_uri()}?mode=ro", uri=True)) as database:
        return database.execute(query).fetchall()
