"""A network trained on a dataset and registered, and the champion that it is compared with."""

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial

import pandas as pd

from cli.jobs import training
from cli.settings import TrainingSettings
from pipeline.dataset.manifest import read_manifest
from pipeline.dataset.reading import buffer_size
from pipeline.errors import InputError
from pipeline.experiments.verdicts import compare
from pipeline.networks.device import torch_device
from pipeline.networks.recipes import Recipe
from pipeline.parallel.workers import Workers
from pipeline.progress import SILENT, Progress
from pipeline.provenance import made_with
from pipeline.storage.folder import Where
from pipeline.training.loop import POSITION_RMSE
from registry import models
from registry.entities import recorded, whole_number
from registry.environment import TRAINED_BY, changed_since, with_architectures
from registry.models import ModelVersion
from registry.store import connect
from registry.training import ALL, DatasetInfo, record_training

SAFE_SHARE, FUEL = "valid_flown_safe_share", "valid_flown_fuel"  # metrics of a training run


@dataclass(frozen=True)
class Contest:
    """The outcome of comparing a version with the champion: both as they are now, and why."""

    version: ModelVersion
    champion: ModelVersion
    reason: str


def trained_before(
    arch: str, seed: int, settings: TrainingSettings, progress: Progress = SILENT
) -> tuple[ModelVersion, Contest | None] | None:
    """The newest version trained by this code with the same recipe, seed and data, if any.

    It counts only if its data streamed, or did not, as they would now, and for a device that the
    settings name only if it was trained there. Where its training was killed before it was
    compared with the champion, it is now, and the outcome is returned.
    """
    recipe, manifest = training.recipe_of(arch, seed, settings), read_manifest(settings.data)
    wanted = {
        **models.recipe_params(recipe),
        "arch": arch,
        "seed": seed,
        "n_spacecraft": settings.n,
        "dataset_digest": manifest.digest(settings.n),
    }
    connect()
    same, made_by = recorded(wanted).items(), with_architectures(TRAINED_BY, [arch])
    buffer = buffer_size(settings.memory * 1e9, settings.n, manifest.problem)
    kind = "" if settings.device == "auto" else torch_device(settings.device).type
    found = [
        (version, changed_since(version.tags, made_by))
        for version in models.list_versions()
        if same <= version.params.items()
        and version.params.get("device", "").startswith(kind)
        and version.params.get("mixed") == _mixed(version, recipe, buffer)
    ]
    current = [version for version, change in found if not change]
    if not current:
        for last, change in found[-1:]:
            progress.say(
                f"{last.label}, seed {seed}, was trained with {change}; it is trained again."
            )
        return None
    version = sorted(current, key=lambda v: v.is_own)[-1]  # rather than a copy
    if version.contest:
        return version, None
    model, _ = models.load(version)
    trials = training.validation_trials(model, settings.data, version.n)
    return version, challenge(version, trials, settings.data)


def _mixed(version: ModelVersion, recipe: Recipe, buffer: int) -> str:
    """The parameter ``mixed`` of a version, if its data were read again with such a buffer."""
    instances = whole_number(version.params.get("train_instances", "")) or 0
    of_dataset = instances - recipe.crowded
    return ALL if recipe.draws or of_dataset <= buffer else str(buffer)


def train_model(
    arch: str, seed: int, settings: TrainingSettings, progress: Progress = SILENT
) -> tuple[ModelVersion, Contest]:
    """Train a network, register the model, and compare it with the champion.

    ProlearnError where the loss diverges or the tracking store fails.
    """
    task = training.TrainingTask.of(arch, seed, settings)
    data = task.examples(progress)
    connect()  # so that a store that cannot be reached is known before the training
    finished = training.train_task(task, data, progress)
    version = _record(task, finished)
    return version, challenge(version, finished.trials, settings.data)


def train_models(
    tasks: Sequence[training.TrainingTask], workers: Workers
) -> list[tuple[ModelVersion, Contest]]:
    """Train several networks at once, each on one thread of a worker; in the order of the tasks.

    Each network is registered as soon as it is done, and compared with its champion at the end.
    """
    workers.progress.expect(len(tasks))
    connect()
    made_by = with_architectures(TRAINED_BY, (task.arch for task in tasks))
    train = partial(training.train_in_worker, made_by, made_with(*made_by))
    done: dict[tuple[str, int], tuple[ModelVersion, pd.DataFrame]] = {}
    with closing(workers.work(train, tasks, lambda _: None)) as results:
        for task, finished in results:
            done[task.arch, task.seed] = _record(task, finished), finished.trials
            workers.progress.done(note=f"{task.arch}, seed {task.seed}")
    found = [(*done[task.arch, task.seed], task.settings.data) for task in tasks]
    return [(version, challenge(version, trials, data)) for version, trials, data in found]


def _record(task: training.TrainingTask, finished: training.FinishedTraining) -> ModelVersion:
    dataset = DatasetInfo(task.settings.data, task.digest, *finished.instances)
    metrics = {POSITION_RMSE: finished.error} | flown_metrics(finished.trials)
    return record_training(finished.trained, dataset, metrics)


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
    # Last: ``train --resume`` compares where it is missing.
    return Contest(models.note_contest(version, reason), champion, reason)


def promote(
    name: str, number: int, data: Where | None = None, *, force: bool = False
) -> tuple[ModelVersion, str]:
    """Make a version the champion of its registered model; the champion now, and why.

    The validation split of the data decides, by default of what the version was trained on.
    """
    version = models.resolve(f"{name}/{number}")
    champion = models.champion_of(version.name)
    if force or champion is None or champion.version == version.version:
        return models.set_champion(version), ""
    where = data or version.params.get("dataset", "")
    try:
        if not where:
            raise InputError("the run that names what it was trained on is gone")
        model, _ = models.load(version)
        mine = training.validation_trials(model, where, model.n_train)
        better, reason = _compared(version, mine, champion, where)
    except InputError as error:
        raise InputError(
            f"{version.name} version {version.version} and the champion, version "
            f"{champion.version}, cannot be compared ({str(error).rstrip('.')}); expected a "
            "dataset that both fit: give --data, or --force."
        ) from error
    if not better:
        raise InputError(f"{reason}; expected a better version, or --force to promote it anyway.")
    models.set_champion(version)
    return models.note_contest(version, reason), reason


def _compared(
    version: ModelVersion, mine: pd.DataFrame, champion: ModelVersion, data: Where
) -> tuple[bool, str]:
    """Whether a version, by its trials, is better than the champion, and the figures in words."""
    if mine.empty:
        raise InputError("there are no validation scenarios")
    theirs = training.validation_trials(models.load(champion)[0], data, int(mine["n"].iloc[0]))
    compared = compare(mine, theirs, "fuel")
    ours, others = flown_metrics(mine), flown_metrics(theirs)
    chance = ", since the difference in safety may be chance" if compared.safe else ""
    why = "" if compared.safety_differs else f"; fuel decides{chance}"
    return compared.better, (
        f"of {compared.trials} validation scenarios {100 * ours[SAFE_SHARE]:.1f} % are safe with "
        f"version {version.version} and {100 * others[SAFE_SHARE]:.1f} % with version "
        f"{champion.version}, at {ours[FUEL]:.3g} and {others[FUEL]:.3g} m/s²{why}"
    )
