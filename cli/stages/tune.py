"""Search for better hyperparameters with Optuna: a trial a nested run, on validation data alone."""

import hashlib
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mlflow.exceptions import MlflowException

from pipeline.dataset.examples import ExampleSource
from pipeline.dataset.manifest import read_manifest
from pipeline.errors import InputError, ProlearnError, check_range
from pipeline.networks.architecture import find, recipe_for, unused_fields
from pipeline.networks.recipes import MOST, Recipe
from pipeline.progress import SILENT, Progress
from pipeline.provenance import made_with
from pipeline.scenario.families import SEEDS
from pipeline.storage.folder import Where
from pipeline.training.device import training_device
from pipeline.training.loop import train
from pipeline.training.sources import sources
from pipeline.training.study import complete, open_study, suggested
from pipeline.training.validation import POSITION_RMSE, position_rmse
from registry.entries import log_metrics, log_params, metrics_now
from registry.environment import TRAINED_BY, environment_tags
from registry.running import recorded_run, reopened_run
from registry.sqlite import database_path
from registry.store import TUNING, Store, explained, opened, with_experiment
from registry.story import DatasetInfo, curve_metrics, story_of

if TYPE_CHECKING:
    from optuna import Study, Trial

STORAGE = "optuna.db"

OBJECTIVES = (POSITION_RMSE, "best_valid_loss")
"""Metrics of a training that a search may make small, as its architecture says."""

PARENT = "mlflow_run_id"
"""Under this name a study remembers its MLflow run."""


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
        """The same for searches whose trials can be compared.

        They are on the same data, by this code, on one kind of device and from one seed.
        """
        r, data = self.recipe, self.dataset.digest[:12]
        code = made_with(*TRAINED_BY)
        versions = hashlib.sha256(json.dumps(dict(code), sort_keys=True).encode()).hexdigest()[:8]
        how = f"{r.epochs}ep-{training_device(self.device)}-seed{self.seed}"
        return f"{self.arch}-{r.name}-n{self.learn.n}-{how}-{data}-{versions}"


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
    check_range("trials", trials, 1, MOST)
    check_range("seed", seed, 0, SEEDS - 1)
    followed = recipe_for(arch, recipe)
    followed = followed if epochs is None else replace(followed, epochs=epochs)
    learn, valid = sources(followed, data, n, seed=seed)
    dataset = DatasetInfo(str(data), read_manifest(data).digest(n), len(learn), len(valid))
    search = Tuning(arch, followed, learn, valid, dataset, seed, device)
    with opened() as opened_store:
        store = with_experiment(opened_store, TUNING)
        path = (storage or _storage_beside(store)).absolute()
        with open_study(path, search.name, seed) as study:
            with _parent(store, study, search) as run_id:
                _search(study, store, search, trials, run_id, progress)
            return _found(study, search, path, run_id)


def _storage_beside(store: Store) -> Path:
    sqlite = store.uri.startswith("sqlite:")
    return (database_path(store.uri).parent if sqlite else Path.cwd()) / STORAGE


@contextmanager
def _parent(store: Store, study: "Study", search: Tuning) -> Iterator[str]:
    """The run that holds those of the trials: the study's own, wherever it began."""
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
        log_params(store, run_id, {"arch": search.arch, "recipe": search.recipe.name})
        yield run_id


def _search(
    study: "Study",
    store: Store,
    search: Tuning,
    trials: int,
    run_id: str,
    progress: Progress,
) -> None:
    last = min(trials, complete(study))
    progress.expect(trials - last)

    def after(study: "Study", trial: Any) -> None:
        nonlocal last
        done = complete(study)
        if done:
            name = "best_" + search.objective.removeprefix("best_")
            log_metrics(store, run_id, metrics_now({name: study.best_value}, step=done))
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


def _trial(trial: "Trial", store: Store, search: Tuning) -> float:
    """Train once and record it as a nested run; what the objective comes to."""
    recipe = replace(search.recipe, **suggested(trial, unused_fields(find(search.arch))))
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


def _found(study: "Study", search: Tuning, path: Path, run_id: str) -> Tuned:
    trials = complete(study)
    if not trials:
        raise ProlearnError(
            f"No trial of {study.study_name} came to an end: the loss diverged in each; expected "
            "at least one: run the command again, or start from another recipe."
        )
    best = study.best_value, study.best_params
    return Tuned(study.study_name, path, run_id, trials, search.objective, *best)
