"""All that a training run says, apart from the model: the story that MLflow or a folder keeps."""

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, SupportsFloat

from mlflow.entities import Dataset, DatasetInput, InputTag, Metric

from pipeline.documents import parsed
from pipeline.errors import InputError
from pipeline.networks.recipes import Recipe
from pipeline.training.loop import Trained
from pipeline.urls import public_url

CURVES = ("train_loss", "valid_loss")

TRAINING_DATA = "training"
EVALUATION_DATA = "evaluation"
"""What MLflow calls a dataset's use."""

NEEDED = ("arch", "recipe", "dataset", "dataset_digest", "train_instances", "valid_instances")
"""Parameters without which no training can be recorded."""

DIGEST_LENGTH = 36
"""Longest digest that MLflow takes for a dataset; the parameter has it in full."""


@dataclass(frozen=True)
class DatasetInfo:
    """What a run says about the dataset it was trained on.

    Attributes:
        path: its folder, as given.
        digest: of its rows of the swarm size that was trained on.
        train_instances: instances trained on.
        valid_instances: instances validated on.
    """

    path: str
    digest: str
    train_instances: int
    valid_instances: int


@dataclass(frozen=True)
class Story:
    """What a training run says.

    Attributes:
        params: settings.
        metrics: what came of it.
        history: columns number, train_loss, valid_loss and seconds, a row an epoch.
        tags: versions, platform and commit.
    """

    params: Mapping[str, Any]
    metrics: Mapping[str, float]
    history: Mapping[str, Sequence[float | int]]
    tags: Mapping[str, str]


def story_of(
    trained: Trained,
    *,
    recipe: Recipe,
    seed: int,
    dataset: DatasetInfo,
    metrics: Mapping[str, SupportsFloat],
    tags: Mapping[str, str],
) -> Story:
    """The story of a training.

    Args:
        trained: what the training gave.
        recipe: its recipe; each field becomes a parameter.
        seed: its seed.
        dataset: what it was trained on.
        metrics: further metrics, such as ``valid_position_rmse`` in m.
        tags: what it was made with.
    """
    best = next(e for e in trained.history if e.number == trained.best_epoch)
    rows = [asdict(epoch) for epoch in trained.history]
    return Story(
        params=_params(trained, recipe, seed, dataset),
        metrics={
            "best_epoch": float(trained.best_epoch),
            "best_valid_loss": best.valid_loss,
            "training_seconds": trained.seconds,
            **{name: float(value) for name, value in metrics.items()},
        },
        history={key: [row[key] for row in rows] for key in rows[0]},
        tags=tags,
    )


def recipe_params(recipe: Recipe) -> dict[str, Any]:
    """A recipe as parameters of a run, where ``epochs`` is what the training took."""
    told = asdict(recipe) | {"options": json.dumps(dict(recipe.options), sort_keys=True)}
    return {_param(name): value for name, value in told.items()}


def _param(field: str) -> str:
    return {"name": "recipe", "epochs": "most_epochs"}.get(field, field)


RECIPE_PARAMS = tuple(sorted(_param(field.name) for field in fields(Recipe)))
"""Parameters of a run that are fields of its recipe."""


def read_story(path: Path) -> Story:
    """The story in a file that ``registry.unregistered.keep`` wrote.

    Raises:
        InputError: where it cannot be read or is none.
    """
    try:
        story = Story(**parsed(path.read_bytes()))
        if not all([*(story.params[name] for name in NEEDED), story.history["number"]]):
            raise ValueError("a part of it is empty")
        curve_metrics(story.history)
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise InputError(
            f"{path} cannot be used ({error}); expected the file that `prolearn train` leaves in "
            "unregistered/ where the tracking store fails."
        ) from error
    return story


def curve_metrics(history: Mapping[str, Sequence[float | int]]) -> list[Any]:
    """Learning curves as MLflow's metrics; step = epoch."""
    stamp = int(time.time() * 1000)
    names = {"train_loss": "train_loss", "valid_loss": "valid_loss", "seconds": "epoch_seconds"}
    return [
        Metric(name, float(value), stamp, int(epoch))
        for column, name in names.items()
        for epoch, value in zip(history["number"], history[column], strict=True)
    ]


def dataset_input(
    path: str, digest: str, context: str, profile: Mapping[str, Any] | None = None
) -> Any:
    """MLflow's record that a run has used a dataset.

    Args:
        path: the dataset's folder, as given; the secrets of a URL are left out.
        digest: of its content.
        context: TRAINING_DATA or EVALUATION_DATA.
        profile: further facts about it.
    """
    path = public_url(path)
    # A run has a dataset of one name and digest once, whatever it used it for.
    suffix = "" if context == TRAINING_DATA else f"-{context}"
    entity = Dataset(
        name=(Path(path).name or path) + suffix,
        digest=digest[:DIGEST_LENGTH],
        source_type="local",
        source=json.dumps({"uri": path}),
        profile=json.dumps({"digest": digest, **(profile or {})}, default=str),
    )
    return DatasetInput(entity, [InputTag("mlflow.data.context", context)])


def _params(trained: Trained, recipe: Recipe, seed: int, dataset: DatasetInfo) -> dict[str, Any]:
    about = asdict(dataset)
    return {
        "arch": trained.model.architecture,
        **recipe_params(recipe),
        "epochs": len(trained.history),
        "seed": seed,
        "device": trained.device,
        "threads": trained.threads,
        "n_spacecraft": trained.model.n_train,
        "dataset": about.pop("path"),
        "dataset_digest": about.pop("digest"),
        **about,
    }
