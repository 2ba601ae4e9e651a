"""Trainings, and trials of a search, as tasks of workers, which import nothing of MLflow."""

from collections.abc import Mapping
from dataclasses import dataclass, fields

import pandas as pd

from cli.settings import TrainingSettings, TuningSettings
from pipeline.dataset.examples import ExampleSource
from pipeline.dataset.manifest import read_manifest
from pipeline.dataset.reading import solved_scenarios
from pipeline.errors import InputError, ProlearnError, check_range
from pipeline.experiments.trials import Comparison, EvaluatedPlanner, run_trials
from pipeline.networks.architecture import changed_recipe
from pipeline.networks.model import Model
from pipeline.networks.recipes import Recipe
from pipeline.parallel.workers import check_worker
from pipeline.planners.network import NetworkPlanner
from pipeline.progress import SILENT, Progress
from pipeline.provenance import DecidedBy
from pipeline.scenario.families import SEEDS
from pipeline.storage.folder import Where, open_folder
from pipeline.text import public_url
from pipeline.training.data import sources
from pipeline.training.loop import Trained, position_rmse, train

Sources = tuple[ExampleSource, ExampleSource]  # examples of training and of validation
MEMORY = (1e-9, 1e6)  # least and most that examples may take, GB
COMPARED_ON = 500  # validation scenarios that versions are compared on


def recipe_of(arch: str, seed: int, settings: TrainingSettings | TuningSettings) -> Recipe:
    """The recipe with the fields that the settings change; InputError for any that is none."""
    check_range("seed", seed, 0, SEEDS - 1)
    given = {field.name: getattr(settings, field.name, None) for field in fields(Recipe)}
    changes = {name: value for name, value in given.items() if value is not None}
    return changed_recipe(arch, settings.recipe, changes)


@dataclass(frozen=True)
class TrainingTask:
    """A training as a task of this process or a worker; also a trial of a search."""

    arch: str
    recipe: Recipe
    seed: int
    settings: TrainingSettings | TuningSettings
    data: str  # absolute path or URL of the dataset
    digest: str  # of the data
    number: int = 0  # of a trial in its study

    @classmethod
    def of(
        cls, arch: str, seed: int, settings: TrainingSettings | TuningSettings
    ) -> "TrainingTask":
        """The training on the data as they are now; InputError where there are none."""
        check_range("memory in GB", settings.memory, *MEMORY)
        recipe = recipe_of(arch, seed, settings)
        digest = read_manifest(settings.data).digest(settings.n)
        return cls(arch, recipe, seed, settings, open_folder(settings.data).address, digest)

    def examples(self, progress: Progress = SILENT) -> Sources:
        """What it learns from, and what decides which weights are kept."""
        how, memory = self.settings, self.settings.memory * 1e9
        return sources(
            self.recipe, self.data, how.n, seed=self.seed, memory=memory, progress=progress
        )


@dataclass(frozen=True, eq=False)
class FinishedTraining:
    """The result of a training that is not yet recorded."""

    trained: Trained
    instances: tuple[int, int]  # of training and of validation
    error: float  # of positions on validation data, m
    trials: pd.DataFrame  # flown on validation scenarios, columns of Trial; empty in a search


def train_in_worker(
    made_by: DecidedBy, expected: Mapping[str, str], task: TrainingTask, _: None
) -> FinishedTraining:
    """Train in a worker; ProlearnError where its versions or data are not those of the request."""
    _check(made_by, expected, task)
    return train_task(task, task.examples())


def train_trial(
    made_by: DecidedBy, expected: Mapping[str, str], task: TrainingTask, data: Sources | None
) -> FinishedTraining | None:
    """Train a trial of a search in a worker, without flying it; None where the loss diverges."""
    _check(made_by, expected, task)
    given = data or task.examples()
    try:
        return train_task(task, given, flown=False)
    except InputError:
        raise
    except ProlearnError:
        return None


def _check(made_by: DecidedBy, expected: Mapping[str, str], task: TrainingTask) -> None:
    """Raise ProlearnError in a worker whose versions or data are not those of the request."""
    check_worker(expected, made_by)
    try:
        same, found = read_manifest(task.data).digest(task.settings.n) == task.digest, "other data"
    except InputError:
        same, found = False, "no such data"
    if not same:
        raise ProlearnError(
            f"{public_url(task.data)} holds {found} on a worker; expected the same on all "
            "machines: give a folder or a URL that all of them reach."
        )


def train_task(
    task: TrainingTask, data: Sources, progress: Progress = SILENT, *, flown: bool = True
) -> FinishedTraining:
    """Train a network and, if ``flown``, evaluate its plans on validation scenarios."""
    how, (learn, valid) = task.settings, data
    trained = train(
        *(task.arch, task.recipe, learn, valid),
        seed=task.seed,
        device=how.device,
        progress=progress,
    )
    error = position_rmse(trained.model, valid)
    trials = validation_trials(trained.model, task.data, how.n) if flown else pd.DataFrame()
    return FinishedTraining(trained, (len(learn), len(valid)), error, trials)


def validation_trials(model: Model, data: Where, n: int) -> pd.DataFrame:
    """A network flown on validation scenarios, columns of Trial; InputError where none fits it."""
    scenarios = solved_scenarios(data, n, "valid")[:COMPARED_ON]
    if not scenarios:
        return pd.DataFrame()
    flown = EvaluatedPlanner(NetworkPlanner(model, model.architecture))
    (table,) = run_trials([Comparison([flown], scenarios)])
    return table
