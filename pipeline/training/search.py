"""Hyperparameter search as an Optuna study, which several processes may share."""

import warnings
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Thread
from typing import TYPE_CHECKING, Any

from filelock import FileLock
from sqlalchemy.exc import SQLAlchemyError

from pipeline.errors import InputError, ProlearnError, missing_extra_hint
from pipeline.files import make_folder, refuse_dataset
from pipeline.networks.encoding import INTERIORS
from pipeline.text import first_line, sqlite_url

if TYPE_CHECKING:
    from optuna import Study, Trial

HEARTBEAT_SECONDS = 60
GRACE_SECONDS = 180  # a trial without a heartbeat for so long counts as dead

SPACE: Mapping[str, Callable[["Trial", str], Any]] = {
    "learning_rate": lambda trial, name: trial.suggest_float(name, 1e-4, 2e-2, log=True),
    "batch_size": lambda trial, name: trial.suggest_categorical(name, (16, 32, 64, 128, 256)),
    "dropout": lambda trial, name: trial.suggest_float(name, 0.0, 0.5),
    "interior": lambda trial, name: trial.suggest_categorical(name, tuple(INTERIORS)),
}
"""How a trial draws each field of a recipe. The collision weight is not searched: the distance from
the expert's plans, which the search minimizes, says nothing about collisions."""


@contextmanager
def open_study(path: Path, name: str) -> Iterator["Study"]:
    """The study of a name in an SQLite file; either is created where it is missing.

    Searches whose trials can be compared have the same name. InputError where Optuna is missing, or
    the path is a folder, below a file, or new in a dataset's folder. ProlearnError where the file
    fails, in the block too.
    """
    with missing_extra_hint():
        import optuna
    if path.is_dir():
        raise InputError(f"--storage is the folder {path}; expected Optuna's SQLite file.")
    if not path.exists():
        refuse_dataset(path)
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    try:
        make_folder(path.parent)
    except OSError as error:
        raise InputError(
            f"--storage is {path}, whose folder cannot be made ({error.strerror}); expected a file "
            "in a folder that can be written to."
        ) from error
    try:
        # Several processes must not make its tables at once. The heartbeat is experimental.
        with FileLock(f"{path}.lock"), warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            storage = optuna.storages.RDBStorage(
                sqlite_url(path),
                heartbeat_interval=HEARTBEAT_SECONDS,
                grace_period=GRACE_SECONDS,
            )
            study = optuna.create_study(study_name=name, storage=storage, load_if_exists=True)
        yield study
    except (optuna.exceptions.OptunaError, SQLAlchemyError) as error:
        reason = first_line(error.__cause__ or error)[:300]
        raise ProlearnError(
            f"The storage of trials {path} failed ({reason}); expected Optuna's SQLite file "
            "on a disk with space: move it away, or name another with --storage."
        ) from error


def completed_trials(study: "Study") -> int:
    """Number of completed trials."""
    return sum(trial.state.name == "COMPLETE" for trial in study.get_trials(deepcopy=False))


@contextmanager
def drawn_trials(
    study: "Study", path: Path, count: int, *, seed: int, unused: Collection[str] = ()
) -> Iterator[dict[int, dict[str, Any]]]:
    """New trials by number, as fields of a recipe from SPACE without the ``unused`` ones.

    Their draws depend on the trials completed by now and not on each other's results, so neither on
    the order in which they are run nor on who runs them. After the block those without a result are
    marked as failed. ``path`` is the study's file.
    """
    import optuna

    trials: list[Trial] = []
    try:
        # Optuna warns of heartbeats, which it means for another way to run trials.
        with FileLock(f"{path}.lock"), warnings.catch_warnings(action="ignore"):
            optuna.storages.fail_stale_trials(study)
            # A search that is continued must not draw the same trials again.
            seed += len(study.trials)
            study.sampler = optuna.samplers.TPESampler(seed=seed, constant_liar=True)
            trials.extend(study.ask() for _ in range(count))
            drawn = {name: draw for name, draw in SPACE.items() if name not in unused}
            fields = {
                trial.number: {name: draw(trial, name) for name, draw in drawn.items()}
                for trial in trials
            }
        with _heartbeats(study, trials):
            yield fields
    finally:
        for trial in trials:
            study.tell(trial, state=optuna.trial.TrialState.FAIL, skip_if_finished=True)


@contextmanager
def _heartbeats(study: "Study", trials: Sequence["Trial"]) -> Iterator[None]:
    """Record heartbeats of trials in the storage as long as the block lasts."""
    ended = Event()

    def beat() -> None:
        while not ended.wait(HEARTBEAT_SECONDS):
            for trial in trials:
                study._storage.record_heartbeat(trial._trial_id)

    for trial in trials:
        study._storage.record_heartbeat(trial._trial_id)
    thread = Thread(target=beat, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
