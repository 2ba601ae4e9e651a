"""Search for hyperparameters with Optuna: each trial a nested run, on validation data alone."""

import hashlib
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mlflow.exceptions import MlflowException

from cli.settings import TuningSettings
from pipeline.dataset.examples import ExampleSource
from pipeline.dataset.manifest import read_manifest
from pipeline.errors import InputError, ProlearnError, check_range
from pipeline.networks.architecture import find, recipe_for, unused_fields
from pipeline.networks.recipes import MOST, Recipe
from pipeline.progress import SILENT, Progress
from pipeline.provenance import made_with
from pipeline.scenario.families import SEEDS
from pipeline.training.data import sources
from pipeline.training.loop import POSITION_RMSE, position_rmse, train, training_device
from pipeline.training.search import complete, open_study, suggested
from registry.entities import curve_metrics, metrics_now
from registry.environment import TRAINED_BY, environment_tags
from registry.running import recorded_run, reopened_run
from registry.sqlite import database_path
from registry.store import TUNING, Store, explained, opened, with_experiment
from registry.training_record import DatasetInfo, TrainingRecord, record_of

if TYPE_CHECKING:
    from optuna import Study, Trial

STORAGE = "optuna.db"

OBJECTIVES = (POSITION_RMSE, "best_valid_loss")
"""Metrics of a training that a search may make small, as its architecture says."""

PARENT = "mlflow_run_id"
"""Under this name a study remembers its MLflow run."""


@dataclass(frozen=True)
class RecipeSearch:
    """A search: its settings, the recipe that trials start from, and its data."""

    settings: TuningSettings
    recipe: Recipe
    learn: ExampleSource
    valid: ExampleSource
    dataset: DatasetInfo

    def __post_init__(self) -> None:
        """Refuse an objective that no trial records."""
        if self.objective not in OBJECTIVES:
            raise InputError(
                f"architecture {self.settings.arch!r} names {self.objective!r} as its objective; "
                f"expected one of {', '.join(OBJECTIVES)}."
            )

    @property
    def objective(self) -> str:
        """The metric that the search makes small."""
        return find(self.settings.arch).objective

    @property
    def name(self) -> str:
        """Name of the study, the same for searches whose trials can be compared.

        They are on the same data, by this code, on one kind of device and from one seed.
        """
        how, r = self.settings, self.recipe
        code = json.dumps(dict(made_with(*TRAINED_BY)), sort_keys=True)
        versions = hashlib.sha256(code.encode()).hexdigest()[:8]
        run = f"{r.epochs}ep-{training_device(how.device)}-seed{how.seed}"
        digest = self.dataset.digest[:12]
        return f"{how.arch}-{r.name}-n{self.learn.n}-{run}-{digest}-{versions}"

    def train(self, recipe: Recipe) -> TrainingRecord:
        """The record of one training."""
        how = self.settings
        trained = train(how.arch, recipe, self.learn, self.valid, seed=how.seed, device=how.device)
        return record_of(
            trained,
            recipe=recipe,
            seed=how.seed,
            dataset=self.dataset,
            metrics={POSITION_RMSE: position_rmse(trained.model, self.valid)},
            tags={},
        )


@dataclass(frozen=True)
class Tuned:
    """The outcome of a search so far."""

    study: str  # its name in the storage
    storage: Path  # the SQLite file
    run_id: str  # of MLflow, which holds the runs of the trials
    trials: int  # complete ones
    objective: str  # the metric that counts
    value: float  # the least of it
    best: Mapping[str, Any]  # recipe fields of the best trial

    @property
    def in_words(self) -> str:
        """The least of the metric in words."""
        if self.objective == POSITION_RMSE:
            return f"{self.value:.4g} m from the expert's positions"
        return f"{self.value:.4g} of {self.objective}"


def tune(settings: TuningSettings, progress: Progress = SILENT) -> Tuned:
    """Search for hyperparameters until so many trials are complete, earlier ones included.

    The data's test split stays untouched.

    Raises:
        InputError: for an unknown name, a missing dataset, trials < 1, or without Optuna.
        ProlearnError: where the tracking store or the storage fails, or no trial came to an end.
    """
    data, n, seed = settings.data, settings.n, settings.seed
    check_range("trials", settings.trials, 1, MOST)
    check_range("seed", seed, 0, SEEDS - 1)
    recipe = recipe_for(settings.arch, settings.recipe)
    recipe = recipe if settings.epochs is None else replace(recipe, epochs=settings.epochs)
    learn, valid = sources(recipe, data, n, seed=seed)
    dataset = DatasetInfo(data, read_manifest(data).digest(n), len(learn), len(valid))
    search = RecipeSearch(settings, recipe, learn, valid, dataset)
    with opened() as opened_store:
        store = with_experiment(opened_store, TUNING)
        path = (settings.storage or _storage_beside(store)).absolute()
        with open_study(path, search.name, seed) as study:
            with _parent(store, study, search) as run_id:
                _search(study, store, search, run_id, progress)
            return _found(study, search, path, run_id)


def _storage_beside(store: Store) -> Path:
    sqlite = store.uri.startswith("sqlite:")
    return (database_path(store.uri).parent if sqlite else Path.cwd()) / STORAGE


@contextmanager
def _parent(store: Store, study: "Study", search: RecipeSearch) -> Iterator[str]:
    """Id of the parent run of the trials' runs, the same each time that a study goes on."""
    known = study.user_attrs.get(PARENT)
    try:
        known = known and store.client.get_run(known).info.run_id
    except MlflowException:  # another tracking store, or the run was deleted
        known = None
    if known:
        with reopened_run(store, known):
            yield known
        return
    with recorded_run(store, TUNING, search.name, environment_tags(TRAINED_BY)) as run_id:
        study.set_user_attr(PARENT, run_id)
        store.log_params(run_id, {"arch": search.settings.arch, "recipe": search.recipe.name})
        yield run_id


def _search(
    study: "Study", store: Store, search: RecipeSearch, run_id: str, progress: Progress
) -> None:
    trials = search.settings.trials
    last = min(trials, complete(study))
    progress.expect(trials - last)

    def after(study: "Study", trial: Any) -> None:
        nonlocal last
        done = complete(study)
        if done:
            name = "best_" + search.objective.removeprefix("best_")
            store.log_metrics(run_id, metrics_now({name: study.best_value}, step=done))
            before, last = last, min(done, trials)  # other processes may have done more
            unit = " m" if search.objective == POSITION_RMSE else ""
            progress.done(last - before, f"best {study.best_value:.4g}{unit}")
        if done >= trials:
            study.stop()

    if last < trials:
        study.optimize(
            lambda trial: _trial(trial, store, search),
            n_trials=trials - last,
            catch=(ProlearnError,),  # a loss that diverges is an answer, too
            callbacks=[after],
        )
    progress.end("others diverged")


def _trial(trial: "Trial", store: Store, search: RecipeSearch) -> float:
    """Train once and record it as a nested run; what the objective comes to."""
    unused = unused_fields(find(search.settings.arch))
    recipe = replace(search.recipe, **suggested(trial, unused))
    name = f"trial-{trial.number}"
    with recorded_run(store, TUNING, name, environment_tags(TRAINED_BY)) as run_id:
        record = search.train(recipe)
        with explained(store.uri):
            store.log_params(run_id, {**record.params, "trial": trial.number})
            store.log_metrics(run_id, curve_metrics(record.history))
            store.log_metrics(run_id, metrics_now(record.metrics))
    return record.metrics[search.objective]


def _found(study: "Study", search: RecipeSearch, path: Path, run_id: str) -> Tuned:
    trials = complete(study)
    if not trials:
        raise ProlearnError(
            f"No trial of {study.study_name} came to an end: the loss diverged in each; expected "
            "at least one: run the command again, or start from another recipe."
        )
    best = study.best_value, study.best_params
    return Tuned(study.study_name, path, run_id, trials, search.objective, *best)
