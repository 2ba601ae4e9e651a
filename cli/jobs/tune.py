"""Search for hyperparameters with Optuna: each trial a nested run, on validation data alone."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mlflow.exceptions import MlflowException

from cli.settings import TuningSettings
from pipeline.dataset.examples import ExampleSource
from pipeline.dataset.manifest import read_manifest
from pipeline.errors import InputError, ProlearnError, check_range
from pipeline.networks.architecture import find, recipe_for, unused_fields
from pipeline.networks.device import torch_device
from pipeline.networks.recipes import MOST, Recipe
from pipeline.progress import SILENT, Progress
from pipeline.provenance import made_with
from pipeline.scenario.families import SEEDS
from pipeline.training.data import sources
from pipeline.training.loop import POSITION_RMSE, position_rmse, train
from pipeline.training.search import complete, open_study, suggested
from registry.entities import curve_metrics, metrics_of, params_of
from registry.environment import TRAINED_BY, environment_tags
from registry.running import recorded_run
from registry.store import TUNING, Store, explained, opened
from registry.training import DatasetInfo, record_of

if TYPE_CHECKING:
    from optuna import Study, Trial

STORAGE = "optuna.db"

OBJECTIVES = (POSITION_RMSE, "best_valid_loss")
"""Metrics of a training that a search may make small, as its architecture says."""

PARENT = "mlflow_run_id"  # under this name a study remembers its MLflow run


@dataclass(frozen=True)
class RecipeSearch:
    """A search: its settings, the recipe that trials start from, its data, and where it is kept."""

    settings: TuningSettings
    recipe: Recipe
    learn: ExampleSource
    valid: ExampleSource
    dataset: DatasetInfo
    store: Store

    @property
    def objective(self) -> str:
        """The metric that the search makes small; InputError where no trial records it."""
        arch = self.settings.arch
        if (named := find(arch).objective) not in OBJECTIVES:
            raise InputError(
                f"architecture {arch!r} names {named!r} as its objective; expected one of "
                f"{', '.join(OBJECTIVES)}."
            )
        return named

    @property
    def name(self) -> str:
        """Name of the study, the same for the same data, code, kind of device and seed."""
        how, r = self.settings, self.recipe
        code = json.dumps(dict(made_with(*TRAINED_BY)), sort_keys=True)
        versions = hashlib.sha256(code.encode()).hexdigest()[:8]
        run = f"{r.epochs}ep-{torch_device(how.device)}-seed{how.seed}"
        digest = self.dataset.digest[:12]
        return f"{how.arch}-{r.name}-n{self.learn.n}-{run}-{digest}-{versions}"


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
    """Search until so many trials, earlier ones too, are complete; ProlearnError if none is."""
    data, n, seed = settings.data, settings.n, settings.seed
    check_range("trials", settings.trials, 1, MOST)
    check_range("seed", seed, 0, SEEDS - 1)
    recipe = recipe_for(settings.arch, settings.recipe)
    recipe = recipe if settings.epochs is None else replace(recipe, epochs=settings.epochs)
    learn, valid = sources(recipe, data, n, seed=seed)
    dataset = DatasetInfo(data, read_manifest(data).digest(n), len(learn), len(valid))
    with opened(TUNING) as store:
        search = RecipeSearch(settings, recipe, learn, valid, dataset, store)
        objective, tags = search.objective, environment_tags(TRAINED_BY)
        path = (settings.storage or store.beside / STORAGE).absolute()
        with open_study(path, search.name, seed) as study:
            known = _parent_of(study, store)
            with recorded_run(store, TUNING, search.name, tags, again=known) as run_id:
                if known is None:
                    study.set_user_attr(PARENT, run_id)
                    params = params_of({"arch": settings.arch, "recipe": recipe.name})
                    store.client.log_batch(run_id, params=params)
                _search(study, search, run_id, progress)
            if not (trials := complete(study)):
                raise ProlearnError(
                    f"No trial of {study.study_name} came to an end: the loss diverged in each; "
                    "expected at least one: run the command again, or start from another recipe."
                )
            best = study.best_value, study.best_params
            return Tuned(study.study_name, path, run_id, trials, objective, *best)


def _parent_of(study: "Study", store: Store) -> str | None:
    """Id of the run that has a study's trials under it, where the store still knows it."""
    known = study.user_attrs.get(PARENT)
    try:
        return known and store.client.get_run(known).info.run_id
    except MlflowException:  # another tracking store, or the run was deleted
        return None


def _search(study: "Study", search: RecipeSearch, run_id: str, progress: Progress) -> None:
    trials, objective = search.settings.trials, search.objective
    last = min(trials, complete(study))
    progress.expect(trials - last)

    def after(study: "Study", trial: Any) -> None:
        nonlocal last
        done = complete(study)
        if done:
            best = {"best_" + objective.removeprefix("best_"): study.best_value}
            search.store.client.log_batch(run_id, metrics=metrics_of(best, step=done))
            before, last = last, min(done, trials)  # other processes may have done more
            unit = " m" if objective == POSITION_RMSE else ""
            progress.done(last - before, f"best {study.best_value:.4g}{unit}")
        if done >= trials:
            study.stop()

    if last < trials:
        study.optimize(
            lambda trial: _trial(trial, search),
            n_trials=trials - last,
            catch=(ProlearnError,),  # a loss that diverges is an answer, too
            callbacks=[after],
        )
    progress.end("others diverged")


def _trial(trial: "Trial", search: RecipeSearch) -> float:
    """Train once and record it as a nested run; what the objective comes to."""
    how, store = search.settings, search.store
    recipe = replace(search.recipe, **suggested(trial, unused_fields(find(how.arch))))
    tags = environment_tags(TRAINED_BY)
    with recorded_run(store, TUNING, f"trial-{trial.number}", tags) as run_id:
        trained = train(
            how.arch, recipe, search.learn, search.valid, seed=how.seed, device=how.device
        )
        found = {POSITION_RMSE: position_rmse(trained.model, search.valid)}
        record = record_of(
            trained, recipe=recipe, seed=how.seed, dataset=search.dataset, metrics=found
        )
        with explained(store.uri):
            store.client.log_batch(
                run_id,
                metrics=[*curve_metrics(record.history), *metrics_of(record.metrics)],
                params=params_of({**record.params, "trial": trial.number}),
            )
    return record.metrics[search.objective]
