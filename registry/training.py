"""Trainings in MLflow: recorded, and their networks registered."""

import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, SupportsFloat

import mlflow
import numpy as np
import pandas as pd
from mlflow.exceptions import MlflowException

from pipeline.documents import parse_json
from pipeline.errors import InputError, ProlearnError
from pipeline.experiments.trainings import curves_figure
from pipeline.figures.style import planner_styles
from pipeline.figures.style import save as save_figure
from pipeline.files import write_text
from pipeline.networks.document import WEIGHTS_FILE
from pipeline.networks.model import Model, save
from pipeline.networks.model import load as load_network
from pipeline.scenario import draw
from pipeline.scratch import scratch_folder, temporary_files_in
from pipeline.text import as_argument
from pipeline.training.loop import Trained
from registry import entities, models
from registry.environment import TRAINED_BY, environment_tags, requirements, with_architectures
from registry.metrics import CURVES
from registry.pyfunc import SIGNATURE
from registry.store import TRAINING, Store, opened, recorded_run

# Parameters without which no training can be recorded
NEEDED = ("arch", "recipe", "dataset", "dataset_digest", "train_instances", "valid_instances")
ALL = "all"  # instances that were mixed, where all were in memory
RECORD = "training.json"  # file with the record, beside a network that is kept


@dataclass(frozen=True)
class DatasetInfo:
    """The dataset of a training."""

    path: str  # its folder, as given
    digest: str  # of its rows of the swarm size that was trained on
    train_instances: int
    valid_instances: int


@dataclass(frozen=True)
class TrainingRecord:
    """A training's parameters, metrics, learning curves and versions, without the weights."""

    params: Mapping[str, Any]
    metrics: Mapping[str, float]
    history: Mapping[str, Sequence[float | int]]  # number, train_loss, valid_loss, seconds
    tags: Mapping[str, str] = field(default_factory=dict)  # versions, platform and commit


def record_of(
    trained: Trained, dataset: DatasetInfo, metrics: Mapping[str, SupportsFloat]
) -> TrainingRecord:
    """The record of a training; each field of its recipe becomes a parameter."""
    rows = [asdict(epoch) for epoch in trained.history]
    best = next(e for e in trained.history if e.number == trained.best_epoch)
    return TrainingRecord(
        params={
            "arch": trained.model.architecture,
            **models.recipe_params(trained.recipe),
            "epochs": len(trained.history),
            "seed": trained.seed,
            "device": trained.device,
            "threads": trained.threads,
            "mixed": ALL if trained.shuffle_buffer is None else trained.shuffle_buffer,
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
    )


def record_training(
    trained: Trained, dataset: DatasetInfo, metrics: Mapping[str, SupportsFloat] | None = None
) -> models.ModelVersion:
    """Record a training in MLflow and register its network as a version of ``prolearn-<arch>``.

    The first version becomes the champion. Where the store or the disk of temporary files fails,
    the network is kept in ``unregistered/``, as the ProlearnError says.
    """
    made_by = with_architectures(TRAINED_BY, [trained.model.architecture])
    record = record_of(trained, dataset, metrics or {})
    count = sum(weights.numel() for weights in trained.model.network.state_dict().values())
    params = {**record.params, "parameters": count}
    record = replace(record, params=params, tags=environment_tags(made_by))
    try:
        with scratch_folder() as scratch:
            save(trained.model, scratch / "network")
            return _register(scratch / "network", trained.model, record)
    except (ProlearnError, OSError) as error:
        kept = _keep(trained.model, record)
        why = str(error).rstrip(".")
        raise ProlearnError(
            f"{why}. The trained network is kept in {kept}; register it later with "
            f"`prolearn models register {as_argument(kept)}`."
        ) from error


def register_kept(folder: Path) -> models.ModelVersion:
    """Register a network kept because the store had failed; InputError where not sound."""
    record, model = _read_record(folder / RECORD), load_network(folder)
    with scratch_folder() as scratch:
        network = scratch / "network"
        shutil.copytree(folder, network, ignore=shutil.ignore_patterns(RECORD))
        return _register(network, model, record)


def _register(folder: Path, model: Model, record: TrainingRecord) -> models.ModelVersion:
    arch, params = model.architecture, record.params
    kib = (folder / WEIGHTS_FILE).stat().st_size / 1024
    with opened() as store:
        name = f"{arch}-{params['recipe']}-seed{params['seed']}"
        with recorded_run(store, TRAINING, name, record.tags) as run_id:
            facts = {k: params[k] for k in ("train_instances", "valid_instances")}
            used = params["dataset"], params["dataset_digest"], entities.TRAINING_DATA, facts
            store.client.log_inputs(run_id, [entities.dataset_input(*used)])
            curves = entities.curve_metrics(record.history)
            store.client.log_batch(run_id, metrics=curves, params=entities.params_of(params))
            with temporary_files_in(folder.parent):
                _log_curves(store, run_id, record)
                model_id = _log_model(folder, model)
            metrics = {**record.metrics, "weights_kib": kib}
            store.client.log_batch(run_id, metrics=entities.metrics_of(metrics, model_id))
            tags = {k: str(params[k]) for k in ("arch", "recipe", "dataset_digest")}
            tags[models.WEIGHTS] = model.digest
            number = _new_version(store, models.PREFIX + arch, run_id, model_id, tags)
        aliases = store.client.get_registered_model(models.PREFIX + arch).aliases
        if models.CHAMPION not in aliases:
            store.client.set_registered_model_alias(models.PREFIX + arch, models.CHAMPION, number)
        return models.read_version(store, models.PREFIX + arch, number)


def _keep(model: Model, record: TrainingRecord) -> Path:
    """Save a network, whole, in ``unregistered/<arch>-<time>`` with its training's record."""
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%S.%fZ")
    kept = Path("unregistered").absolute() / f"{record.params['arch']}-{stamp}"
    params = {key: entities.without_secrets(value) for key, value in record.params.items()}
    part = kept.with_name(f".{kept.name}.tmp")
    try:
        part.mkdir(parents=True)
        save(model, part)
        content = {**vars(record), "params": params}
        write_text(part / RECORD, json.dumps(content, indent=1, default=str) + "\n")
        part.rename(kept)
    except OSError as error:
        raise ProlearnError(
            f"The trained network can neither be registered nor be kept in {kept} "
            f"({error.strerror or error}); expected a writable disk with space on it."
        ) from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return kept


def _read_record(path: Path) -> TrainingRecord:
    try:
        record = TrainingRecord(**parse_json(path.read_bytes()))
        if not all([*(record.params[name] for name in NEEDED), record.history["number"]]):
            raise ValueError("a part of it is empty")
        entities.curve_metrics(record.history)
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise InputError(
            f"{path} cannot be used ({error}); expected the file that `prolearn train` leaves in "
            "unregistered/ where the tracking store fails."
        ) from error
    return record


def _log_curves(store: Store, run_id: str, record: TrainingRecord) -> None:
    store.client.log_dict(run_id, dict(record.history), "learning_curve.json")
    arch = str(record.params["arch"])
    columns = {name: record.history[name] for name in CURVES}
    curves = pd.DataFrame({"epoch": record.history["number"], **columns}).assign(
        arch=arch, recipe=record.params["recipe"], training_seed=record.params["seed"]
    )
    with scratch_folder() as scratch:
        save_figure(
            curves_figure(curves, planner_styles([arch])), scratch / "learning_curve", [".png"]
        )
        store.client.log_artifacts(run_id, str(scratch), "figures")


def _log_model(folder: Path, model: Model) -> str:
    # Of a family whose formations are the larger, the larger the collision radius is.
    example = draw("dense", seed=0, n=2, index=0, problem=model.problem)
    info = mlflow.pyfunc.log_model(
        name="model",
        loader_module="registry.pyfunc",
        data_path=str(folder),
        signature=SIGNATURE,
        input_example={
            "initial": np.asarray(example.initial[None]),
            "goal": np.asarray(example.goal[None]),
        },
        pip_requirements=requirements(model.architecture),
    )
    return str(info.model_id)


def _new_version(
    store: Store, name: str, run_id: str, model_id: str, tags: Mapping[str, str]
) -> str:
    try:
        store.client.create_registered_model(name)
    except MlflowException as error:
        if error.error_code != "RESOURCE_ALREADY_EXISTS":
            raise
    info = {"tags": {**tags, "model_id": model_id}, "model_id": model_id}
    return str(
        store.client.create_model_version(name, f"models:/{model_id}", run_id, **info).version
    )
