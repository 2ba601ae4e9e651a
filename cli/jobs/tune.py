"""Search for hyperparameters with Optuna: each trial a nested run, on validation data alone."""

import hashlib
import json
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cli.jobs.training import FinishedTraining, Sources, TrainingTask, train_trial
from cli.settings import TuningSettings
from pipeline.errors import InputError, ProlearnError, check_range
from pipeline.networks.architecture import find, unused_fields
from pipeline.networks.device import torch_device
from pipeline.networks.recipes import MOST
from pipeline.parallel.workers import Workers
from pipeline.provenance import DecidedBy, made_with
from pipeline.training.loop import POSITION_RMSE
from pipeline.training.search import completed_trials, drawn_trials, open_study
from registry.entities import curve_metrics, metrics_of, params_of
from registry.environment import TRAINED_BY, environment_tags, with_architectures
from registry.models import active_run
from registry.store import TUNING, Store, opened, recorded_run, store_errors
from registry.training import DatasetInfo, record_of

if TYPE_CHECKING:
    from optuna import Study

STORAGE = "optuna.db"
OBJECTIVES = (POSITION_RMSE, "best_valid_loss")  # metrics that a search may minimize
PARENT = "mlflow_run_id"  # under this name a study remembers its MLflow run


@dataclass(frozen=True)
class RecipeSearch:
    """A search: its settings, the training that trials vary, and where it is kept."""

    settings: TuningSettings
    task: TrainingTask
    store: Store
    path: Path  # Optuna's SQLite file

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
    def made_by(self) -> DecidedBy:
        """The code and packages whose versions decide the results of the trials."""
        return with_architectures(TRAINED_BY, [self.settings.arch])

    @property
    def name(self) -> str:
        """Name of the study, the same for the same data, code, kind of device and seed."""
        how, recipe = self.settings, self.task.recipe
        code = json.dumps(dict(made_with(*self.made_by)), sort_keys=True)
        versions = hashlib.sha256(code.encode()).hexdigest()[:8]
        run = f"{recipe.epochs}ep-{torch_device(how.device)}-seed{how.seed}"
        return f"{how.arch}-{recipe.name}-n{how.n}-{run}-{self.task.digest[:12]}-{versions}"


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


def tune(settings: TuningSettings, *, workers: Workers | None = None) -> Tuned:
    """Search until so many trials, earlier ones too, are complete; ProlearnError if none is.

    Trials are the same for any workers, by default this process, which alone writes.
    """
    workers = workers or Workers(1)
    check_range("trials", settings.trials, 1, MOST)
    check_range("trials drawn at once", settings.at_once, 1, MOST)
    if settings.at_once == 1 and workers.scheduler is None and workers.jobs != 1:
        raise InputError(
            f"jobs is {workers.jobs} and trials are drawn one by one, each from all before it; "
            "expected several that are drawn together, such as --at-once 5, or one job."
        )
    task = TrainingTask.of(settings.arch, settings.seed, settings)
    alone = workers.scheduler is None and workers.jobs == 1
    # Workers draw crowded scenarios themselves, which takes minutes; the rest is a check.
    drawn = task if alone else replace(task, recipe=replace(task.recipe, crowded=0))
    examples = drawn.examples()
    with opened(TUNING) as store:
        path = (settings.storage or store.folder / STORAGE).absolute()
        search = RecipeSearch(settings, task, store, path)
        objective, tags = search.objective, environment_tags(search.made_by)
        with open_study(path, search.name) as study:
            known = _parent_of(study, store)
            with recorded_run(store, TUNING, search.name, tags, again=known) as run_id:
                if known is None:
                    study.set_user_attr(PARENT, run_id)
                    params = params_of({"arch": settings.arch, "recipe": task.recipe.name})
                    store.client.log_batch(run_id, params=params)
                _search(study, search, workers, examples if alone else None, run_id)
            if not (trials := completed_trials(study)):
                raise ProlearnError(
                    f"No trial of {study.study_name} came to an end: the loss diverged in each; "
                    "expected at least one: run the command again, or start from another recipe."
                )
            best = study.best_value, study.best_params
            return Tuned(study.study_name, path, run_id, trials, objective, *best)


def _parent_of(study: "Study", store: Store) -> str | None:
    """Id of the run that has a study's trials under it, where it is still in the store."""
    run = active_run(store, study.user_attrs.get(PARENT))
    return run and run.info.run_id


def _search(
    study: "Study",
    search: RecipeSearch,
    workers: Workers,
    data: Sources | None,
    run_id: str,
) -> None:
    """Make the trials that are left; this process has the data, or each worker reads them."""
    how, recipe, progress = search.settings, search.task.recipe, workers.progress
    unused = unused_fields(find(how.arch))
    metric = "best_" + search.objective.removeprefix("best_")
    unit = " m" if search.objective == POSITION_RMSE else ""
    one = partial(train_trial, search.made_by, made_with(*search.made_by))
    last = min(how.trials, completed_trials(study))
    left = how.trials - last  # a loss that diverges is an answer, too
    progress.expect(left)
    while left and completed_trials(study) < how.trials:  # other processes may have done some
        count = min(how.at_once, left, how.trials - completed_trials(study))
        left -= count
        with drawn_trials(study, search.path, count, seed=how.seed, unused=unused) as drawn:
            tasks = [
                replace(search.task, recipe=replace(recipe, **fields), number=number)
                for number, fields in drawn.items()
            ]
            with closing(workers.work(one, tasks, lambda _: data)) as results:
                for task, found in results:
                    _record(task, found, study, search)
                    if done := completed_trials(study):
                        best = metrics_of({metric: study.best_value}, step=done)
                        search.store.client.log_batch(run_id, metrics=best)
                        before, last = last, min(done, how.trials)
                        progress.done(last - before, f"best {study.best_value:.4g}{unit}")
                    if last == how.trials:
                        break
    progress.end("others diverged")


def _record(
    task: TrainingTask, found: FinishedTraining | None, study: "Study", search: RecipeSearch
) -> None:
    """Record a trial as a nested MLflow run and in its study; one that diverged has failed."""
    store, tags, how = search.store, environment_tags(search.made_by), task.settings
    with store_errors(store.uri):
        with recorded_run(store, TUNING, f"trial-{task.number}", tags) as run_id:
            if found:
                dataset = DatasetInfo(how.data, task.digest, *found.instances)
                record = record_of(found.trained, dataset, {POSITION_RMSE: found.error})
                store.client.log_batch(
                    run_id,
                    metrics=[*curve_metrics(record.history), *metrics_of(record.metrics)],
                    params=params_of({**record.params, "trial": task.number}),
                )
        if not found:
            store.client.set_terminated(run_id, "FAILED")
    if found:  # unless one that took the trial for dead has told of it
        study.tell(task.number, record.metrics[search.objective], skip_if_finished=True)
