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
from pipeline.storage.folder import Where
from pipeline.text import public_url
from pipeline.training.data import sources
from pipeline.training.loop import Trained, position_rmse, train

Sources = tuple[ExampleSource, ExampleSource]  # examples of training and of validation
MEMORY = (1e-9, 1e6)  # least and most that examples may take, GB
COMPARED_ON = 500  # validation scenarios that versions are compared on


def followed_recipe(arch: str, seed: int, settings: TrainingSettings) -> Recipe:
    """The recipe with the fields that the settings change; InputError for any that is none."""
    check_range("seed", seed, 0, SEEDS - 1)
    given = {field.name: getattr(settings, field.name, None) for field in fields(Recipe)}
    changes = {name: value for name, value in given.items() if value is not None}
    return changed_recipe(arch, settings.recipe, changes)


@dataclass(frozen=True)
class AskedTraining:
    """A training as a task of a worker: network, seed, settings, and digest of the data."""

    arch: str
    seed: int
    settings: TrainingSettings
    digest: str

    @classmethod
    def of(cls, arch: str, seed: int, settings: TrainingSettings) -> "AskedTraining":
        """The training on the data as they are now; InputError where there are none."""
        check_range("memory in GB", settings.memory, *MEMORY)
        digest = read_manifest(settings.data).digest(settings.n)
        return cls(arch, seed, settings, digest)

    @property
    def recipe(self) -> Recipe:
        """The recipe that it follows."""
        return followed_recipe(self.arch, self.seed, self.settings)

    def examples(self, progress: Progress) -> Sources:
        """What it learns from, and what decides which weights are kept."""
        how, memory = self.settings, self.settings.memory * 1e9
        return sources(
            self.recipe, how.data, how.n, seed=self.seed, memory=memory, progress=progress
        )


@dataclass(frozen=True)
class AskedTrial:
    """A trial as a task of a worker."""

    number: int  # in its study
    recipe: Recipe
    settings: TuningSettings
    digest: str  # of the data


@dataclass(frozen=True, eq=False)
class FinishedTraining:
    """The result of a training that is not yet recorded."""

    trained: Trained
    instances: tuple[int, int]  # of training and of validation
    error: float  # of positions on validation data, m
    trials: pd.DataFrame  # flown on validation scenarios, columns of Trial


def train_in_worker(
    made_by: DecidedBy, expected: Mapping[str, str], task: tuple[int, AskedTraining], _: bytes
) -> FinishedTraining:
    """In a worker: a training; ProlearnError where versions or data differ from those asked for."""
    check_worker(expected, made_by)
    asked = task[1]
    check_data(asked.settings.data, asked.settings.n, asked.digest)
    return train_and_fly(asked, asked.examples(SILENT), SILENT)


def check_data(data: Where, n: int, digest: str) -> None:
    """In a worker: ProlearnError where the data differ from those that the work was asked for."""
    if read_manifest(data).digest(n) != digest:
        raise ProlearnError(
            f"{public_url(data)} holds other data on a worker; expected the same on all "
            "machines: give a folder or a URL that all of them reach."
        )


def train_and_fly(asked: AskedTraining, data: Sources, progress: Progress) -> FinishedTraining:
    """Train a network and fly it on validation scenarios."""
    how, seed, (learn, valid) = asked.settings, asked.seed, data
    of = asked.arch, asked.recipe, learn, valid
    trained = train(*of, seed=seed, device=how.device, progress=progress)
    trials = validation_trials(trained.model, how.data, how.n)
    error = position_rmse(trained.model, valid)
    return FinishedTraining(trained, (len(learn), len(valid)), error, trials)


def validation_trials(model: Model, data: Where, n: int) -> pd.DataFrame:
    """A network flown on validation scenarios, columns of Trial; InputError where none fits it."""
    scenarios = solved_scenarios(data, n, "valid")[:COMPARED_ON]
    if not scenarios:
        return pd.DataFrame()
    flown = EvaluatedPlanner(NetworkPlanner(model, model.architecture))
    (table,) = run_trials([Comparison([flown], scenarios)])
    return table


def train_trial(
    made_by: DecidedBy, expected: Mapping[str, str], asked: AskedTrial, data: Sources | None
) -> FinishedTraining | None:
    """In a worker: the training of a trial, which is not flown; None where the loss diverges."""
    check_worker(expected, made_by)
    how, recipe = asked.settings, asked.recipe
    check_data(how.data, how.n, asked.digest)
    learn, valid = data or sources(recipe, how.data, how.n, seed=how.seed)
    try:
        trained = train(how.arch, recipe, learn, valid, seed=how.seed, device=how.device)
    except InputError:
        raise
    except ProlearnError:
        return None
    error = position_rmse(trained.model, valid)
    return FinishedTraining(trained, (len(learn), len(valid)), error, pd.DataFrame())
