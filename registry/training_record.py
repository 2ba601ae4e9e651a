"""A training as a record: parameters, metrics, learning curves and versions, without the weights.

MLflow keeps it as a run; where the store fails, a folder in ``unregistered/`` keeps it.
"""

import json
import math
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, SupportsFloat

from safetensors import safe_open

from pipeline.documents import parsed
from pipeline.errors import InputError, ProlearnError
from pipeline.files import write_text
from pipeline.networks.document import WEIGHTS_FILE
from pipeline.networks.recipes import Recipe
from pipeline.training.loop import Trained
from registry.entities import curve_metrics, without_secrets

NEEDED = ("arch", "recipe", "dataset", "dataset_digest", "train_instances", "valid_instances")
"""Parameters without which no training can be recorded."""

RECORD = "training.json"
"""File with the record, beside a network that is kept."""

PARAM_OF_FIELD = {"name": "recipe", "epochs": "most_epochs"}
"""Names of a recipe's fields as parameters, where they differ: ``epochs`` is what it took."""


@dataclass(frozen=True)
class DatasetInfo:
    """The dataset of a training."""

    path: str  # its folder, as given
    digest: str  # of its rows of the swarm size that was trained on
    train_instances: int
    valid_instances: int


@dataclass(frozen=True)
class TrainingRecord:
    """The record of a training."""

    params: Mapping[str, Any]
    metrics: Mapping[str, float]
    history: Mapping[str, Sequence[float | int]]  # number, train_loss, valid_loss, seconds
    tags: Mapping[str, str]  # versions, platform and commit


def record_of(
    trained: Trained,
    *,
    recipe: Recipe,
    seed: int,
    dataset: DatasetInfo,
    metrics: Mapping[str, SupportsFloat],
    tags: Mapping[str, str],
) -> TrainingRecord:
    """The record of a training; each field of its recipe becomes a parameter."""
    best = next(e for e in trained.history if e.number == trained.best_epoch)
    rows = [asdict(epoch) for epoch in trained.history]
    return TrainingRecord(
        params={
            "arch": trained.model.architecture,
            **recipe_params(recipe),
            "epochs": len(trained.history),
            "seed": seed,
            "device": trained.device,
            "threads": trained.threads,
            "n_spacecraft": trained.model.n_train,
            "dataset": dataset.path,
            "dataset_digest": dataset.digest,
            "train_instances": dataset.train_instances,
            "valid_instances": dataset.valid_instances,
        },
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
    """A recipe as parameters of a run."""
    values = asdict(recipe) | {"options": json.dumps(dict(recipe.options), sort_keys=True)}
    return {PARAM_OF_FIELD.get(name, name): value for name, value in values.items()}


RECIPE_PARAMS = tuple(
    sorted(PARAM_OF_FIELD.get(field.name, field.name) for field in fields(Recipe))
)
"""Parameters of a run that are fields of its recipe."""


def parameter_count(folder: Path) -> int:
    """Numbers in a saved network's weights."""
    with safe_open(folder / WEIGHTS_FILE, framework="numpy") as weights:
        return sum(math.prod(weights.get_slice(k).get_shape()) for k in weights.keys())  # noqa: SIM118


def weights_kib(folder: Path) -> float:
    """Size of a saved network's weights, KiB."""
    return (folder / WEIGHTS_FILE).stat().st_size / 1024


def keep(folder: Path, record: TrainingRecord) -> Path:
    """Copy a saved network to ``unregistered/<arch>-<time>`` with the record of its training.

    Raises:
        ProlearnError: where that cannot be written.
    """
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%S.%fZ")
    kept = Path("unregistered").absolute() / f"{record.params['arch']}-{stamp}"
    params = {key: without_secrets(value) for key, value in record.params.items()}
    try:
        shutil.copytree(folder, kept)
        content = {**vars(record), "params": params}
        write_text(kept / RECORD, json.dumps(content, indent=1, default=str) + "\n")
    except OSError as error:
        raise ProlearnError(
            f"The trained network can neither be registered nor be kept in {kept} ({error}); "
            "expected a writable disk with space on it."
        ) from error
    return kept


def read_record(path: Path) -> TrainingRecord:
    """The record in a file that ``keep`` wrote.

    Raises:
        InputError: where it cannot be read or is none.
    """
    try:
        record = TrainingRecord(**parsed(path.read_bytes()))
        if not all([*(record.params[name] for name in NEEDED), record.history["number"]]):
            raise ValueError("a part of it is empty")
        curve_metrics(record.history)
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise InputError(
            f"{path} cannot be used ({error}); expected the file that `prolearn train` leaves in "
            "unregistered/ where the tracking store fails."
        ) from error
    return record
