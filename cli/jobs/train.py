"""A network trained on a dataset and registered, and the champion that it is compared with."""

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, fields
from functools import partial

import pandas as pd

from cli.jobs.experiments import COLUMNS
from cli.settings import TrainingSettings
from pipeline.dataset.examples import ExampleSource
from pipeline.dataset.manifest import read_manifest
from pipeline.dataset.reading import solved_rows
from pipeline.dataset.schema import scenarios_of
from pipeline.errors import InputError, ProlearnError, check_range
from pipeline.experiments.trials import Comparison, EvaluatedPlanner, run_trials
from pipeline.experiments.verdicts import compare
from pipeline.networks.architecture import changed_recipe
from pipeline.networks.device import torch_device
from pipeline.networks.model import Model
from pipeline.networks.recipes import Recipe
from pipeline.parallel.workers import Workers, check_worker
from pipeline.planners.network import NetworkPlanner
from pipeline.progress import SILENT, Progress
from pipeline.provenance import made_with
from pipeline.scenario.families import SEEDS
from pipeline.storage.folder import Where
from pipeline.text import public_url
from pipeline.training.data import sources
from pipeline.training.loop import POSITION_RMSE, Trained, position_rmse, train
from registry import models
from registry.entities import recorded
from registry.environment import TRAINED_BY, changed_since
from registry.models import ModelVersion
from registry.store import connect
from registry.training import DatasetInfo, record_training

MEMORY = (1e-9, 1e6)  # least and most that examples may take, GB
COMPARED_ON = 500  # validation scenarios that versions are compared on
SAFE_SHARE, FUEL = "valid_flown_safe_share", "valid_flown_fuel"  # metrics of a training run


@dataclass(frozen=True)
class Contest:
    """The outcome of comparing a version with the champion: who is it now, and why."""

    champion: ModelVersion
    reason: str


def followed_recipe(arch: str, seed: int, settings: TrainingSettings) -> Recipe:
    """The recipe with the fields that the settings change; InputError for any that is none."""
    check_range("seed", seed, 0, SEEDS - 1)
    given = {field.name: getattr(settings, field.name, None) for field in fields(Recipe)}
    changes = {name: value for name, value in given.items() if value is not None}
    return changed_recipe(arch, settings.recipe, changes)


def trained_before(
    arch: str, seed: int, settings: TrainingSettings, progress: Progress = SILENT
) -> tuple[ModelVersion, Contest | None] | None:
    """The newest version trained by this code with the same recipe, seed and data, if any.

    It counts for a device that the settings name only if it was trained there. Where its training
    was killed before it was compared with the champion, it is now, and the outcome is returned.
    Progress is told of a version trained by other versions of the code. InputError for unknown
    names.
    """
    wanted = {
        **models.recipe_params(followed_recipe(arch, seed, settings)),
        "arch": arch,
        "seed": seed,
        "n_spacecraft": settings.n,
        "dataset_digest": read_manifest(settings.data).digest(settings.n),
    }
    connect()
    same = recorded(wanted).items()
    kind = "" if settings.device == "auto" else torch_device(settings.device).type
    found = [
        (version, changed_since(version.tags, TRAINED_BY))
        for version in models.list_versions()
        if same <= version.params.items() and version.params.get("device", "").startswith(kind)
    ]
    current = [version for version, change in found if not change]
    if not current:
        for last, change in found[-1:]:
            progress.say(
                f"{last.label}, seed {seed}, was trained with {change}; it is trained again."
            )
        return None
    version = current[-1]
    if version.contest:
        return version, None
    model, _ = models.load(version)
    trials = validation_trials(model, settings.data, version.n)
    return version, challenge(version, trials, settings.data)


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

    def examples(self, progress: Progress) -> tuple[ExampleSource, ExampleSource]:
        """What it learns from, and what decides which weights are kept."""
        how, memory = self.settings, self.settings.memory * 1e9
        return sources(
            self.recipe, how.data, how.n, seed=self.seed, memory=memory, progress=progress
        )


@dataclass(frozen=True, eq=False)
class FinishedTraining:
    """The result of a training that is not yet recorded."""

    trained: Trained
    instances: tuple[int, int]  # of training and of validation
    error: float  # of positions on validation data, m
    trials: pd.DataFrame  # flown on validation scenarios, columns of Trial


def train_model(
    arch: str, seed: int, settings: TrainingSettings, progress: Progress = SILENT
) -> tuple[ModelVersion, Contest]:
    """Train a network, register the model, and compare it with the champion.

    The seed is that of weights, order, dropout and fresh scenarios. A ProlearnError says where
    the loss diverges or the tracking store fails.
    """
    asked = AskedTraining.of(arch, seed, settings)
    data = asked.examples(progress)
    connect()  # a store that is away is better known before training than after
    finished = _train_and_fly(asked, data, progress)
    version = _record(asked, finished)
    return version, challenge(version, finished.trials, settings.data)


def train_models(
    asked: Sequence[AskedTraining], workers: Workers, progress: Progress = SILENT
) -> list[tuple[ModelVersion, Contest]]:
    """Train several networks at once, each on one thread of a worker; in the order asked.

    Workers read the data where the settings say. This process registers each network as soon as it
    is done, and compares them with champions at the end.
    """
    progress.expect(len(asked))
    connect()
    one = partial(_train_in_worker, made_with(*TRAINED_BY))
    done: dict[int, tuple[ModelVersion, pd.DataFrame]] = {}
    tasks = list(enumerate(asked))
    with closing(workers.work(one, tasks, lambda _: b"", progress)) as results:
        for (number, training), finished in results:
            done[number] = _record(training, finished), finished.trials
            progress.done(note=f"{training.arch}, seed {training.seed}")
    found = [(*done[number], training.settings.data) for number, training in tasks]
    return [(version, challenge(version, trials, data)) for version, trials, data in found]


def _train_in_worker(
    expected: Mapping[str, str], task: tuple[int, AskedTraining], _: bytes
) -> FinishedTraining:
    """In a worker: a training; ProlearnError where versions or data differ from those asked for."""
    check_worker(expected, TRAINED_BY)
    asked = task[1]
    how = asked.settings
    if read_manifest(how.data).digest(how.n) != asked.digest:
        raise ProlearnError(
            f"{public_url(how.data)} holds other data on a worker; expected the same on all "
            "machines: give a folder or a URL that all of them reach."
        )
    return _train_and_fly(asked, asked.examples(SILENT), SILENT)


def _train_and_fly(
    asked: AskedTraining, data: tuple[ExampleSource, ExampleSource], progress: Progress
) -> FinishedTraining:
    """Train a network and fly it on validation scenarios."""
    how, seed, (learn, valid) = asked.settings, asked.seed, data
    of = asked.arch, asked.recipe, learn, valid
    trained = train(*of, seed=seed, device=how.device, progress=progress)
    trials = validation_trials(trained.model, how.data, how.n)
    error = position_rmse(trained.model, valid)
    return FinishedTraining(trained, (len(learn), len(valid)), error, trials)


def _record(asked: AskedTraining, finished: FinishedTraining) -> ModelVersion:
    return record_training(
        finished.trained,
        recipe=asked.recipe,
        seed=asked.seed,
        dataset=DatasetInfo(asked.settings.data, asked.digest, *finished.instances),
        metrics={POSITION_RMSE: finished.error} | flown_metrics(finished.trials),
    )


def validation_trials(model: Model, data: Where, n: int) -> pd.DataFrame:
    """A network flown on validation scenarios, columns of Trial; InputError where none fits it."""
    scenarios = scenarios_of(solved_rows(data, n, "valid", COLUMNS))[:COMPARED_ON]
    if not scenarios:
        return pd.DataFrame()
    flown = EvaluatedPlanner(NetworkPlanner(model, model.architecture))
    (table,) = run_trials([Comparison([flown], scenarios)])
    return table


def flown_metrics(trials: pd.DataFrame) -> dict[str, float]:
    """Metrics of a training run by which one of several networks can be picked."""
    if trials.empty:
        return {}
    return {
        SAFE_SHARE: float(trials["safe"].mean()),
        FUEL: float(trials["fuel"].mean()),
        "valid_flown_trials": float(len(trials)),
    }


def challenge(version: ModelVersion, trials: pd.DataFrame, data: Where) -> Contest:
    """Make a new version the champion where it does better on its validation data."""
    champion = models.champion_of(version.name)
    if champion is None or champion.version == version.version:
        first = version.version == 1
        reason = "the first version of its model" if first else "there is no other"
        champion = models.set_champion(version)
    else:
        try:
            better, reason = _compared(version, trials, champion, data)
            champion = models.set_champion(version) if better else champion
        except InputError as error:
            reason = f"version {champion.version} cannot be compared: {str(error).rstrip('.')}"
    models.note_contest(version, reason)  # last: ``train --resume`` compares where it is missing
    return Contest(champion, reason)


def promote(
    name: str, number: int, data: Where | None = None, *, force: bool = False
) -> tuple[ModelVersion, str]:
    """Make a version the champion of its registered model; the champion now, and why.

    The validation split of the data decides, by default of what the version was trained on;
    with ``force`` nothing is compared. An InputError says why it does not become it.
    """
    version = models.resolve(f"{name}/{number}")
    champion = models.champion_of(version.name)
    if force or champion is None or champion.version == version.version:
        return models.set_champion(version), ""
    where = data or version.params.get("dataset", "")
    try:
        mine = validation_trials(models.load(version)[0], where, version.n)
        better, reason = _compared(version, mine, champion, where)
    except InputError as error:
        raise InputError(
            f"{version.label} and the champion, version {champion.version}, cannot be compared "
            f"({str(error).rstrip('.')}); expected a dataset that both fit: give --data, or "
            "--force."
        ) from error
    if not better:
        raise InputError(
            f"{reason}; expected a version that does better: give --force to promote it all "
            "the same."
        )
    return models.set_champion(version), reason


def _compared(
    version: ModelVersion, mine: pd.DataFrame, champion: ModelVersion, data: Where
) -> tuple[bool, str]:
    """Whether a version, by its trials, is better than the champion, and the figures in words."""
    theirs = validation_trials(models.load(champion)[0], data, version.n)
    if mine.empty or theirs.empty:
        raise InputError("there are no validation scenarios")
    compared = compare(mine, theirs, "fuel")
    ours, others = flown_metrics(mine), flown_metrics(theirs)
    return compared.better, (
        f"of {compared.trials} validation scenarios {100 * ours[SAFE_SHARE]:.1f} % are safe with "
        f"version {version.version} and {100 * others[SAFE_SHARE]:.1f} % with version "
        f"{champion.version}, at {ours[FUEL]:.3g} and {others[FUEL]:.3g} m/s²"
    )
