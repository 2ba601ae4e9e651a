"""Train one network on a dataset and register it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from cli.stages.champion import Challenge, challenge, flown_metrics, validation_trials
from pipeline.dataset.manifest import read_manifest
from pipeline.dataset.reading import MEMORY
from pipeline.errors import check_range
from pipeline.networks.architecture import changed_recipe
from pipeline.networks.recipes import Recipe
from pipeline.progress import SILENT, Progress
from pipeline.scenario.families import SEEDS
from pipeline.storage.folder import Where
from pipeline.training.device import training_device
from pipeline.training.loop import train
from pipeline.training.sources import sources
from pipeline.training.validation import POSITION_RMSE, position_rmse
from registry.entries import recorded
from registry.environment import TRAINED_BY, changed_since
from registry.models import list_versions, load
from registry.store import connect
from registry.story import recipe_params
from registry.training import DatasetInfo, record_training
from registry.version import ModelVersion


@dataclass(frozen=True)
class TrainingSettings:
    """What a training is told; on the same data the same settings give the same network.

    Attributes:
        arch: name of the architecture.
        recipe: name of the recipe.
        n: swarm size to train on.
        seed: of weights, order, dropout and fresh scenarios.
        changes: fields of the recipe to set otherwise.
    """

    arch: str
    recipe: str
    n: int = 10
    seed: int = 0
    changes: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse a seed that is none."""
        check_range("seed", self.seed, 0, SEEDS - 1)

    @property
    def followed(self) -> Recipe:
        """The recipe with the fields that options change.

        Raises:
            InputError: for an unknown recipe, or a field or value that the architecture refuses.
        """
        return changed_recipe(self.arch, self.recipe, self.changes)


def trained_before(
    how: TrainingSettings, data: Where, device: str = "auto", progress: Progress = SILENT
) -> tuple[ModelVersion, Challenge | None] | None:
    """The newest version that was trained like this, by this code, on the same data, if any.

    Where its training was killed before it was held against the champion, it is now.

    Args:
        how: what to train.
        data: a solved dataset.
        device: "auto" for any, or a device's name, which it must have been trained on.
        progress: told where one was trained like this by other versions, which does not count.

    Returns:
        The version, and what came of holding it against the champion where that was left to do.

    Raises:
        InputError: for an unknown name, a missing dataset, settings that make no sense, or where
            it is left to do and the version's files are gone or not sound.
        ProlearnError: where the store fails.
    """
    wanted = {
        **recipe_params(how.followed),
        "arch": how.arch,
        "seed": how.seed,
        "n_spacecraft": how.n,
        "dataset_digest": read_manifest(data).digest(how.n),
    }
    connect()
    same = recorded(wanted).items()
    found = [version for version in list_versions() if same <= version.params.items()]
    if device != "auto":
        kind = training_device(device).type
        found = [one for one in found if one.params.get("device", "").startswith(kind)]
    changes = {version.uri: changed_since(version.tags, TRAINED_BY) for version in found}
    current = [version for version in found if not changes[version.uri]]
    if found and not current:
        progress.say(
            f"{found[-1].label}, seed {how.seed}, was trained with {changes[found[-1].uri]}; it is "
            "trained again."
        )
    return (current[-1], _contest_left(current[-1], data)) if current else None


def _contest_left(version: ModelVersion, data: Where) -> Challenge | None:
    """Hold a version against the champion where its training was killed before it came to that."""
    if version.contest:
        return None
    model, _ = load(version)
    return challenge(version, validation_trials(model, data, version.n), data)


def train_model(
    how: TrainingSettings,
    data: Where,
    *,
    device: str,
    memory: float = MEMORY,
    progress: Progress = SILENT,
) -> tuple[ModelVersion, Challenge]:
    """Train a network, register the model, and hold it against the champion.

    Args:
        how: what to train.
        data: a solved dataset.
        device: "auto" or a device's name.
        memory: bytes that training data may take; what is larger streams from the dataset.
        progress: told of crowded scenarios as they are drawn, and of each epoch.

    Returns:
        The new version, and who is the champion of its model now.

    Raises:
        InputError: for an unknown name, a missing dataset, or settings that make no sense.
        ProlearnError: where the loss diverges or the tracking store fails.
    """
    followed = how.followed
    learn, valid = sources(followed, data, how.n, seed=how.seed, memory=memory, progress=progress)
    connect()  # a store that is away is better known before training than after
    trained = train(
        how.arch, followed, learn, valid, seed=how.seed, device=device, progress=progress
    )
    trials = validation_trials(trained.model, data, how.n)
    errors = {POSITION_RMSE: position_rmse(trained.model, valid)}
    version = record_training(
        trained,
        recipe=followed,
        seed=how.seed,
        dataset=DatasetInfo(str(data), read_manifest(data).digest(how.n), len(learn), len(valid)),
        metrics=errors | flown_metrics(trials),
    )
    return version, challenge(version, trials, data)
