"""A training as an MLflow run, and the network it gave as a registered model version."""

import json
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, SupportsFloat

import mlflow
import numpy as np
from mlflow.entities import Dataset, DatasetInput, InputTag, Metric
from mlflow.exceptions import MlflowException

from pipeline.errors import ProlearnError
from pipeline.networks.model import Model, save
from pipeline.scenario import draw
from pipeline.training.loop import Trained
from pipeline.training.recipes import Recipe
from registry.environment import environment_tags, requirements
from registry.flavor import SIGNATURE
from registry.store import (
    TRAINING,
    Store,
    log_metrics,
    log_params,
    metrics_now,
    opened,
    recorded_run,
)
from registry.unregistered import keep, parameter_count, weights_kib
from registry.version import CHAMPION, PREFIX, ModelVersion, read_version

DIGEST_LENGTH = 36
"""Longest digest that MLflow takes for a dataset; the parameter has it in full."""


@dataclass(frozen=True)
class DatasetInfo:
    """What a run says about the dataset it was trained on.

    Attributes:
        path: its folder, as given.
        digest: of its content.
        train_instances: instances trained on.
        valid_instances: instances validated on.
    """

    path: str
    digest: str
    train_instances: int
    valid_instances: int


def record_training(
    trained: Trained,
    *,
    recipe: Recipe,
    seed: int,
    dataset: DatasetInfo,
    params: Mapping[str, Any] | None = None,
    metrics: Mapping[str, SupportsFloat] | None = None,
) -> ModelVersion:
    """Record a training in MLflow and register its network as ``prolearn-<arch>``.

    The first version of a model becomes its champion.

    Args:
        trained: what the training gave.
        recipe: its recipe; each field becomes a parameter.
        seed: its seed.
        dataset: what it was trained on.
        params: further settings.
        metrics: further metrics, such as ``valid_position_rmse`` in m.

    Raises:
        ProlearnError: where the store fails; the network is then kept in ``unregistered/``, which
            the message names.
    """
    arch = trained.model.architecture
    settings = _params(trained, recipe, seed, dataset) | dict(params or {})
    with TemporaryDirectory(prefix="prolearn-") as scratch:
        folder = Path(scratch) / "network"
        save(trained.model, folder)
        settings["parameters"] = parameter_count(folder)
        summary = _summary(trained, folder) | {k: float(v) for k, v in (metrics or {}).items()}
        try:
            return _record(trained, folder, arch, settings, summary, dataset)
        except ProlearnError as error:
            story = {"params": settings, "metrics": summary, "history": _history(trained)}
            kept = keep(folder, arch, story)
            raise ProlearnError(
                f"{error} The trained network is kept in {kept}; it is not registered."
            ) from error


def _record(
    trained: Trained,
    folder: Path,
    arch: str,
    settings: Mapping[str, Any],
    summary: Mapping[str, float],
    dataset: DatasetInfo,
) -> ModelVersion:
    name = f"{arch}-{settings['recipe']}"
    with opened() as store:
        with recorded_run(store, TRAINING, name, environment_tags()) as run_id:
            store.client.log_inputs(run_id, [_dataset_input(dataset)])
            log_params(store, run_id, settings)
            log_metrics(store, run_id, _curves(trained))
            store.client.log_dict(run_id, _history(trained), "learning_curve.json")
            model_id = _log_model(folder, trained.model)
            log_metrics(store, run_id, metrics_now(summary, model_id))
            tags = {k: str(settings[k]) for k in ("arch", "recipe", "dataset_digest")}
            found = _register(store, PREFIX + arch, run_id, model_id, tags)
        aliases = store.client.get_registered_model(found.name).aliases
        if CHAMPION not in aliases:
            store.client.set_registered_model_alias(found.name, CHAMPION, str(found.version))
        return read_version(store, found)


def _params(trained: Trained, recipe: Recipe, seed: int, dataset: DatasetInfo) -> dict[str, Any]:
    fields, about = asdict(recipe), asdict(dataset)
    return {
        "arch": trained.model.architecture,
        "recipe": fields.pop("name"),
        "most_epochs": fields.pop("epochs"),
        **fields,
        "epochs": len(trained.history),
        "seed": seed,
        "device": trained.device,
        "n_spacecraft": trained.model.n_train,
        "dataset": about.pop("path"),
        "dataset_digest": about.pop("digest"),
        **about,
    }


def _summary(trained: Trained, folder: Path) -> dict[str, float]:
    best = next(e for e in trained.history if e.number == trained.best_epoch)
    return {
        "best_epoch": float(trained.best_epoch),
        "best_valid_loss": best.valid_loss,
        "training_seconds": trained.seconds,
        "weights_kib": weights_kib(folder),
    }


def _history(trained: Trained) -> dict[str, list[Any]]:
    """Learning curves as columns."""
    rows = [asdict(epoch) for epoch in trained.history]
    return {key: [row[key] for row in rows] for key in rows[0]}


def _curves(trained: Trained) -> list[Metric]:
    stamp = int(time.time() * 1000)
    return [
        Metric(key, float(value), stamp, epoch.number)
        for epoch in trained.history
        for key, value in (
            ("train_loss", epoch.train_loss),
            ("valid_loss", epoch.valid_loss),
            ("epoch_seconds", epoch.seconds),
        )
    ]


def _dataset_input(dataset: DatasetInfo) -> Any:
    about = asdict(dataset)
    entity = Dataset(
        name=Path(dataset.path).name or dataset.path,
        digest=dataset.digest[:DIGEST_LENGTH],
        source_type="local",
        source=json.dumps({"uri": about.pop("path")}),
        profile=json.dumps(about),
    )
    return DatasetInput(entity, [InputTag("mlflow.data.context", "training")])


def _log_model(folder: Path, model: Model) -> str:
    """Id of the model, logged into the run that is active."""
    example = draw("rings", seed=0, n=2, index=0, problem=model.problem)
    info = mlflow.pyfunc.log_model(
        name="model",
        loader_module="registry.flavor",
        data_path=str(folder),
        signature=SIGNATURE,
        input_example={
            "initial": np.asarray(example.initial[None]),
            "goal": np.asarray(example.goal[None]),
        },
        pip_requirements=requirements(),
    )
    return str(info.model_id)


def _register(store: Store, name: str, run_id: str, model_id: str, tags: Mapping[str, str]) -> Any:
    """MLflow's new version of a registered model, which is made where it is missing."""
    try:
        store.client.create_registered_model(name)
    except MlflowException as error:
        if error.error_code != "RESOURCE_ALREADY_EXISTS":
            raise
    return store.client.create_model_version(
        name, f"models:/{model_id}", run_id, tags={**tags, "model_id": model_id}, model_id=model_id
    )
