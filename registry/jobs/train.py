"""Train one network on a dataset and register it."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from typing import Any

from pipeline.dataset.folder import Where
from pipeline.dataset.manifest import read_manifest
from pipeline.dataset.stream import MEMORY, examples_within
from pipeline.training.loop import Epoch, train
from pipeline.training.recipes import recipe_for
from pipeline.training.validation import position_rmse
from registry.models import list_versions
from registry.store import connect
from registry.training import DatasetInfo, record_training
from registry.version import ModelVersion


def trained_before(
    arch: str, recipe: str, data: Where, *, n: int, seed: int, changes: Mapping[str, Any]
) -> ModelVersion | None:
    """The newest version that was trained like this on the same data, where there is one.

    Raises:
        InputError: for an unknown name, a missing dataset, or settings that make no sense.
        ProlearnError: where the store fails.
    """
    connect()
    fields = asdict(replace(recipe_for(arch, recipe), **changes))
    wanted = {
        "arch": arch,
        "recipe": fields.pop("name"),
        "most_epochs": fields.pop("epochs"),
        **fields,
        "seed": seed,
        "n_spacecraft": n,
        "dataset_digest": read_manifest(data).digest(),
    }
    same = {key: str(value) for key, value in wanted.items()}.items()
    found = [version for version in list_versions() if same <= version.params.items()]
    return found[-1] if found else None


def train_model(
    arch: str,
    recipe: str,
    data: Where,
    *,
    n: int,
    seed: int,
    device: str,
    changes: Mapping[str, Any],
    on_epoch: Callable[[Epoch], None],
    memory: float = MEMORY,
) -> ModelVersion:
    """Train an architecture by a recipe and register the model.

    Args:
        arch: name of the architecture.
        recipe: name of the recipe.
        data: a solved dataset.
        n: swarm size to train on.
        seed: of weights, order and dropout.
        device: "auto" or a device's name.
        changes: fields of the recipe to set otherwise.
        on_epoch: called after each epoch.
        memory: bytes that training data may take; what is larger streams from the dataset.

    Raises:
        InputError: for an unknown name, a missing dataset, or settings that make no sense.
        ProlearnError: where the loss diverges or the tracking store fails.
    """
    followed = replace(recipe_for(arch, recipe), **changes)
    learn, valid = (examples_within(data, n, split, memory) for split in ("train", "valid"))
    connect()  # a store that is away is better known before training than after
    trained = train(arch, followed, learn, valid, seed=seed, device=device, on_epoch=on_epoch)
    return record_training(
        trained,
        recipe=followed,
        seed=seed,
        dataset=DatasetInfo(str(data), read_manifest(data).digest(), len(learn), len(valid)),
        metrics={"valid_position_rmse": position_rmse(trained.model, valid)},
    )
