"""One network trained on a dataset and registered."""

from dataclasses import fields

from cli.jobs.champion import Contest, challenge, flown_metrics, validation_trials
from cli.settings import TrainingSettings
from pipeline.dataset.manifest import read_manifest
from pipeline.errors import check_range
from pipeline.networks.architecture import changed_recipe
from pipeline.networks.recipes import Recipe
from pipeline.progress import SILENT, Progress
from pipeline.scenario.families import SEEDS
from pipeline.training.data import sources
from pipeline.training.loop import POSITION_RMSE, position_rmse, train, training_device
from registry.entities import recorded
from registry.environment import TRAINED_BY, changed_since
from registry.models import list_versions, load
from registry.store import connect
from registry.training import record_training
from registry.training_record import DatasetInfo, recipe_params
from registry.version import ModelVersion

MEMORY = (1e-9, 1e6)
"""Least and most that examples may take, GB."""


def followed_recipe(arch: str, seed: int, settings: TrainingSettings) -> Recipe:
    """The recipe with the fields that the settings change.

    Raises:
        InputError: for an unknown recipe, a field or value that the architecture refuses, or a
            seed that is none.
    """
    check_range("seed", seed, 0, SEEDS - 1)
    given = {field.name: getattr(settings, field.name, None) for field in fields(Recipe)}
    changes = {name: value for name, value in given.items() if value is not None}
    return changed_recipe(arch, settings.recipe, changes)


def trained_before(
    arch: str, seed: int, settings: TrainingSettings, progress: Progress = SILENT
) -> tuple[ModelVersion, Contest | None] | None:
    """The newest version that was trained like this, by this code, on the same data, if any.

    It must have been trained on the device of the settings where they name one. Where its training
    was killed before it was compared with the champion, it is now, and the outcome is returned.
    ``progress`` is told where other versions trained one like this, which does not count.

    Raises:
        InputError: for an unknown name, a missing dataset, settings that make no sense, or where
            the contest is left to do and the version's files are gone or not sound.
    """
    wanted = {
        **recipe_params(followed_recipe(arch, seed, settings)),
        "arch": arch,
        "seed": seed,
        "n_spacecraft": settings.n,
        "dataset_digest": read_manifest(settings.data).digest(settings.n),
    }
    connect()
    same = recorded(wanted).items()
    found = [version for version in list_versions() if same <= version.params.items()]
    if settings.device != "auto":
        kind = training_device(settings.device).type
        found = [one for one in found if one.params.get("device", "").startswith(kind)]
    changes = {version.uri: changed_since(version.tags, TRAINED_BY) for version in found}
    current = [version for version in found if not changes[version.uri]]
    if found and not current:
        progress.say(
            f"{found[-1].label}, seed {seed}, was trained with {changes[found[-1].uri]}; it is "
            "trained again."
        )
    if not current:
        return None
    version = current[-1]
    if version.contest:
        return version, None
    model, _ = load(version)
    trials = validation_trials(model, settings.data, version.n)
    return version, challenge(version, trials, settings.data)


def train_model(
    arch: str, seed: int, settings: TrainingSettings, progress: Progress = SILENT
) -> tuple[ModelVersion, Contest]:
    """Train a network, register the model, and compare it with the champion.

    The seed is that of weights, order, dropout and fresh scenarios.

    Raises:
        InputError: for an unknown name, a missing dataset, or settings that make no sense.
        ProlearnError: where the loss diverges or the tracking store fails.
    """
    recipe, data, n = followed_recipe(arch, seed, settings), settings.data, settings.n
    check_range("memory in GB", settings.memory, *MEMORY)
    memory = settings.memory * 1e9
    learn, valid = sources(recipe, data, n, seed=seed, memory=memory, progress=progress)
    connect()  # a store that is away is better known before training than after
    trained = train(
        arch, recipe, learn, valid, seed=seed, device=settings.device, progress=progress
    )
    trials = validation_trials(trained.model, data, n)
    errors = {POSITION_RMSE: position_rmse(trained.model, valid)}
    version = record_training(
        trained,
        recipe=recipe,
        seed=seed,
        dataset=DatasetInfo(data, read_manifest(data).digest(n), len(learn), len(valid)),
        metrics=errors | flown_metrics(trials),
    )
    return version, challenge(version, trials, data)
