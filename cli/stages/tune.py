"""Search for better hyperparameters with Optuna: a trial a nested run, on validation data alone."""

import hashlib
import json
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mlflow
from filelock import FileLock
from mlflow.exceptions import MlflowException
from sqlalchemy.exc import SQLAlchemyError

from pipeline.dataset.reading.examples import ExampleSource
from pipeline.dataset.storage.folder import Where
from pipeline.dataset.storage.manifest import read_manifest
from pipeline.errors import InputError, ProlearnError
from pipeline.networks.architecture import find
from pipeline.networks.recipes import Recipe, recipe_for
from pipeline.progress import SILENT, Progress
from pipeline.provenance import made_with
from pipeline.training.loop import train
from pipeline.training.search import SPACE, Between
from pipeline.training.sources import sources
from pipeline.training.validation import POSITION_RMSE, position_rmse
from registry.environment import TRAINED_BY, environment_tags
from registry.sqlite import database_path
from registry.store import (
    TUNING,
    Store,
    explained,
    log_metrics,
    log_params,
    metrics_now,
    opened,
    recorded_run,
    with_experiment,
)
from registry.story import DatasetInfo, curve_metrics, story_of

if TYPE_CHECKING:
    from optuna import Study, Trial

STORAGE = "optuna.db"

OBJECTIVES = (POSITION_RMSE, "best_valid_loss")
"""Metrics of a training that a search may make small, as its architecture says."""

PARENT = "mlflow_run_id"
"""Under this name a study remembers its MLflow run."""

HEARTBEAT_SECONDS = 60
GRACE_SECONDS = 180
"""A trial that has not been heard of for so long has died."""


@dataclass(frozen=True)
class Tuning:
    """What is searched, and on what.

    Attributes:
        arch: the architecture.
        recipe: the recipe that trials start from.
        learn: examples to learn from.
        valid: examples that decide.
        dataset: where they are from.
        seed: of the search and, the same in each trial, of the training.
        device: "auto" or a device's name.
    """

    arch: str
    recipe: Recipe
    learn: ExampleSource
    valid: ExampleSource
    dataset: DatasetInfo
    seed: int
    device: str

    def __post_init__(self) -> None:
        """Refuse an objective that no trial records."""
        if self.objective not in OBJECTIVES:
            raise InputError(
                f"architecture {self.arch!r} names {self.objective!r} as its objective; expected "
                f"one of {', '.join(OBJECTIVES)}."
            )

    @property
    def objective(self) -> str:
        """The metric that the search makes small."""
        return find(self.arch).objective

    @property
    def name(self) -> str:
        """The same for searches whose trials can be compared: on the same data, by this code."""
        r, data = self.recipe, self.dataset.digest[:12]
        code = made_with(*TRAINED_BY)
        versions = hashlib.sha256(json.dumps(dict(code), sort_keys=True).encode()).hexdigest()[:8]
        return f"{self.arch}-{r.name}-n{self.learn.n}-{r.epochs}ep-{data}-{versions}"


@dataclass(frozen=True)
class Tuned:
    """What a search has found so far.

    Attributes:
        study: its name in the storage.
        storage: the SQLite file.
        run_id: MLflow's run that holds those of the trials.
        trials: how many are complete.
        objective: the metric that counts.
        value: the least of it.
        best: recipe fields of the best trial.
    """

    study: str
    storage: Path
    run_id: str
    trials: int
    objective: str
    value: float
    best: Mapping[str, Any]

    @property
    def told(self) -> str:
        """The least of the metric in words."""
        if self.objective == POSITION_RMSE:
            return f"{self.value:.4g} m from the expert's positions"
        return f"{self.value:.4g} of {self.objective}"


def tune(
    arch: str,
    recipe: str,
    data: Where,
    *,
    trials: int,
    n: int,
    seed: int = 0,
    device: str = "auto",
    epochs: int | None = None,
    storage: Path | None = None,
    progress: Progress = SILENT,
) -> Tuned:
    """Train with ever better settings until so many trials are complete, earlier ones included.

    Args:
        arch: name of the architecture.
        recipe: name of the recipe to start from.
        data: a solved dataset; its test split stays untouched.
        trials: trials in all.
        n: swarm size to train on.
        seed: of the search and of each training.
        device: "auto" or a device's name.
        epochs: most epochs of a trial, or the recipe's.
        storage: SQLite file of the study; optuna.db beside the tracking store by default.
        progress: told of each trial that is left to do.

    Raises:
        InputError: for an unknown name, a missing dataset, trials < 1, or without Optuna.
        ProlearnError: where the tracking store or the storage fails, or no trial came to an end.
    """
    if trials < 1:
        raise InputError(f"trials is {trials}; expected at least 1.")
    optuna = _optuna()
    followed = recipe_for(arch, recipe)
    followed = followed if epochs is None else replace(followed, epochs=epochs)
    learn, valid = sources(followed, data, n, seed=seed)
    dataset = DatasetInfo(str(data), read_manifest(data).digest(n), len(learn), len(valid))
    search = Tuning(arch, followed, learn, valid, dataset, seed, device)
    with opened() as opened_store:
        store = with_experiment(opened_store, TUNING)
        path = (storage or _storage_beside(store)).absolute()
        with _explained(optuna, path):
            study = _study(optuna, path, search)
            with _parent(store, study, search) as run_id:
                _search(optuna, study, store, search, trials, run_id, progress)
            return _found(optuna, study, search, path, run_id)


def _optuna() -> Any:
    try:
        import optuna
    except ImportError as error:
        raise InputError(
            "optuna is not installed; expected the packages of prolearn's extra `tune`: "
            "pip install 'prolearn[tune]'."
        ) from error
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    return optuna


def _storage_beside(store: Store) -> Path:
    sqlite = store.uri.startswith("sqlite:")
    return (database_path(store.uri).parent if sqlite else Path.cwd()) / STORAGE


@contextmanager
def _explained(optuna: Any, path: Path) -> Iterator[None]:
    """Turn failures of the storage into one sentence about it."""
    try:
        yield
    except (optuna.exceptions.OptunaError, SQLAlchemyError) as error:
        reason = str(error.__cause__ or error).strip().splitlines()[0]
        raise ProlearnError(
            f"The storage of trials {path} failed ({reason[:300]}); expected Optuna's SQLite file "
            "on a disk with space: move it away, or name another with --storage."
        ) from error


def _study(optuna: Any, path: Path, search: Tuning) -> "Study":
    path.parent.mkdir(parents=True, exist_ok=True)
    # Several processes must not make its tables at once. Optuna calls its heartbeat experimental.
    with FileLock(f"{path}.lock"), warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        kept = optuna.storages.RDBStorage(
            f"sqlite:///{path}", heartbeat_interval=HEARTBEAT_SECONDS, grace_period=GRACE_SECONDS
        )
        study = optuna.create_study(
            study_name=search.name, storage=kept, direction="minimize", load_if_exists=True
        )
    # A search that goes on must not draw once more what it began with.
    study.sampler = optuna.samplers.TPESampler(seed=search.seed + len(study.trials))
    return study


@contextmanager
def _parent(store: Store, study: "Study", search: Tuning) -> Iterator[str]:
    """The run that holds those of the trials: the study's own, wherever it began."""
    known = study.user_attrs.get(PARENT)
    try:
        known = known and store.client.get_run(known).info.run_id
    except MlflowException:  # another tracking store, or the run was deleted
        known = None
    if known:
        with mlflow.start_run(run_id=known, nested=True, log_system_metrics=False):
            yield known
        return
    with recorded_run(store, TUNING, search.name, environment_tags(TRAINED_BY)) as run_id:
        study.set_user_attr(PARENT, run_id)
        log_params(store, run_id, {"arch": search.arch, "recipe": search.recipe.name})
        yield run_id


def _search(
    optuna: Any,
    study: "Study",
    store: Store,
    search: Tuning,
    trials: int,
    run_id: str,
    progress: Progress,
) -> None:
    last = min(trials, len(_complete(optuna, study)))
    progress.expect(trials - last)

    def after(study: "Study", trial: Any) -> None:
        nonlocal last
        complete = len(_complete(optuna, study))
        if complete:
            name = "best_" + search.objective.removeprefix("best_")
            log_metrics(store, run_id, metrics_now({name: study.best_value}, step=complete))
            before, last = last, min(complete, trials)  # other processes may have done more
            unit = " m" if search.objective == POSITION_RMSE else ""
            progress.done(last - before, f"best {study.best_value:.4g}{unit}")
        if complete >= trials:
            study.stop()

    if last < trials:
        study.optimize(
            lambda trial: _trial(trial, store, search),
            n_trials=trials - last,
            catch=(ProlearnError,),  # a loss that diverges is an answer, too
            callbacks=[after],
        )
    progress.end("others diverged")


def _trial(trial: "Trial", store: Store, search: Tuning) -> float:
    """Train once and record it as a nested run; what the objective comes to."""
    recipe = replace(search.recipe, **{name: _suggest(trial, name) for name in SPACE})
    with recorded_run(
        store, TUNING, f"trial-{trial.number}", environment_tags(TRAINED_BY)
    ) as run_id:
        trained = train(
            search.arch, recipe, search.learn, search.valid, seed=search.seed, device=search.device
        )
        story = story_of(
            trained,
            recipe=recipe,
            seed=search.seed,
            dataset=search.dataset,
            metrics={POSITION_RMSE: position_rmse(trained.model, search.valid)},
            tags={},
        )
        with explained(store.uri):
            log_params(store, run_id, {**story.params, "trial": trial.number})
            log_metrics(store, run_id, curve_metrics(story.history))
            log_metrics(store, run_id, metrics_now(story.metrics))
    return story.metrics[search.objective]


def _suggest(trial: "Trial", name: str) -> Any:
    space = SPACE[name]
    if isinstance(space, Between):
        return trial.suggest_float(name, space.low, space.high, log=space.log)
    return trial.suggest_categorical(name, space.values)


def _complete(optuna: Any, study: "Study") -> list[Any]:
    return study.get_trials(deepcopy=False, states=(optuna.trial.TrialState.COMPLETE,))


def _found(optuna: Any, study: "Study", search: Tuning, path: Path, run_id: str) -> Tuned:
    complete = len(_complete(optuna, study))
    if not complete:
        raise ProlearnError(
            f"No trial of {study.study_name} came to an end: the loss diverged in each; expected "
            "at least one: run the command again, or start from another recipe."
        )
    best = study.best_value, study.best_params
    return Tuned(study.study_name, path, run_id, complete, search.objective, *best)
