"""Trainings in MLflow: recorded and registered, evaluations added, tables for the report."""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, SupportsFloat

import mlflow
import numpy as np
import pandas as pd
from mlflow.exceptions import MlflowException

from pipeline.errors import ProlearnError
from pipeline.experiments.records import Epoch, Training
from pipeline.experiments.trainings import curves_figure
from pipeline.figures.style import save as save_figure
from pipeline.figures.style import styles
from pipeline.networks.model import Model, save
from pipeline.networks.model import load as load_network
from pipeline.networks.recipes import Recipe, for_comparison
from pipeline.scenario import draw
from pipeline.scratch import scratch_folder, temporary_files_in
from pipeline.training.loop import Trained
from registry.entities import (
    EVALUATION_DATA,
    TRAINING_DATA,
    curve_metrics,
    dataset_input,
    metrics_now,
    now,
    warn,
    whole,
    whole_metric,
)
from registry.environment import TRAINED_BY, environment_tags, requirements
from registry.pyfunc import SIGNATURE
from registry.running import FAILURES, recorded_run
from registry.store import TRAINING, Store, opened
from registry.training_record import (
    RECORD,
    DatasetInfo,
    TrainingRecord,
    keep,
    parameter_count,
    read_record,
    record_of,
    weights_kib,
)
from registry.version import CHAMPION, PREFIX, ModelVersion, read_version, run_of_version

CURVES = ("train_loss", "valid_loss")

LATEST = 2**63 - 1
"""Latest time that a store keeps, ms."""


def record_training(
    trained: Trained,
    *,
    recipe: Recipe,
    seed: int,
    dataset: DatasetInfo,
    metrics: Mapping[str, SupportsFloat] | None = None,
) -> ModelVersion:
    """Record a training in MLflow and register its network as ``prolearn-<arch>``.

    The first version of a model becomes its champion, but for recipes that are there to be
    compared with.

    Raises:
        ProlearnError: where the store fails; the network is then kept in ``unregistered/``, which
            the message names.
    """
    with scratch_folder() as scratch:
        folder = scratch / "network"
        save(trained.model, folder)
        record = record_of(
            trained,
            recipe=recipe,
            seed=seed,
            dataset=dataset,
            metrics={**(metrics or {}), "weights_kib": weights_kib(folder)},
            tags=environment_tags(TRAINED_BY),
        )
        params = {**record.params, "parameters": parameter_count(folder)}
        record = replace(record, params=params)
        try:
            return _register(folder, trained.model, record)
        except ProlearnError as error:
            kept = keep(folder, record)
            raise ProlearnError(
                f"{error} The trained network is kept in {kept}; register it later with "
                f"`prolearn models register {kept}`."
            ) from error


def register_kept(folder: Path) -> ModelVersion:
    """Record and register a network that was kept because the store had failed.

    Raises:
        InputError: where the folder holds no sound network and record.
        ProlearnError: where the store fails again; the folder stays as it is.
    """
    record = read_record(folder / RECORD)
    model = load_network(folder)
    with scratch_folder() as scratch:
        network = scratch / "network"
        shutil.copytree(folder, network, ignore=shutil.ignore_patterns(RECORD))
        return _register(network, model, record)


def _register(folder: Path, model: Model, record: TrainingRecord) -> ModelVersion:
    """Record and register the network saved in a folder, which lies in a temporary one."""
    arch, params = model.architecture, record.params
    with opened() as store:
        name = f"{arch}-{params['recipe']}"
        with recorded_run(store, TRAINING, name, record.tags) as run_id:
            facts = {k: params[k] for k in ("train_instances", "valid_instances")}
            used = (params["dataset"], params["dataset_digest"], TRAINING_DATA, facts)
            store.client.log_inputs(run_id, [dataset_input(*used)])
            store.log_params(run_id, params)
            store.log_metrics(run_id, curve_metrics(record.history))
            with temporary_files_in(folder.parent):
                _log_curves(store, run_id, record)
                model_id = _log_model(folder, model)
            store.log_metrics(run_id, metrics_now(record.metrics, model_id))
            tags = {k: str(params[k]) for k in ("arch", "recipe", "dataset_digest")}
            found = _new_version(store, PREFIX + arch, run_id, model_id, tags)
        aliases = store.client.get_registered_model(found.name).aliases
        if CHAMPION not in aliases and not for_comparison(arch, str(params["recipe"])):
            store.client.set_registered_model_alias(found.name, CHAMPION, str(found.version))
        return read_version(store, found)


def _log_curves(store: Store, run_id: str, record: TrainingRecord) -> None:
    """Learning curves as numbers and as a figure."""
    store.client.log_dict(run_id, dict(record.history), "learning_curve.json")
    arch = str(record.params["arch"])
    columns = {name: record.history[name] for name in CURVES}
    curves = pd.DataFrame({"epoch": record.history["number"], **columns}).assign(
        arch=arch, recipe=record.params["recipe"], training_seed=record.params["seed"]
    )
    with scratch_folder() as scratch:
        save_figure(curves_figure(curves, styles([arch])), scratch / "learning_curve", [".png"])
        store.client.log_artifacts(run_id, str(scratch), "figures")


def _log_model(folder: Path, model: Model) -> str:
    """Id of the model, logged into the run that is active."""
    example = draw("rings", seed=0, n=2, index=0, problem=model.problem)
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
) -> Any:
    """MLflow's new version of a registered model, which is made where it is missing."""
    try:
        store.client.create_registered_model(name)
    except MlflowException as error:
        if error.error_code != "RESOURCE_ALREADY_EXISTS":
            raise
    return store.client.create_model_version(
        name, f"models:/{model_id}", run_id, tags={**tags, "model_id": model_id}, model_id=model_id
    )


def add_model_results(
    version: ModelVersion,
    metrics: Mapping[int, Mapping[str, SupportsFloat]],
    figures: Path,
    *,
    dataset: tuple[str, str],
) -> None:
    """Add an evaluation to a model's own training run, or warn where that run cannot take it.

    Args:
        version: the model.
        metrics: by step, then by name.
        figures: a folder whose content becomes the run's artifacts ``figures/``.
        dataset: folder and digest of what it was evaluated on.
    """
    with opened(create=False) as store:
        try:
            if run_of_version(store, version.run_id) is None:
                raise FileNotFoundError("it is gone")
            _add_metrics(store, version, metrics)
            used = dataset_input(*dataset, EVALUATION_DATA)
            store.client.log_inputs(version.run_id, [used])
            store.client.log_artifacts(version.run_id, str(figures), "figures")
        except FAILURES as error:
            reason = next(iter(str(error).splitlines()), "")[:300]
            warn(f"The evaluation of {version.uri} is not added to its training run ({reason}).")


def _add_metrics(
    store: Store, version: ModelVersion, metrics: Mapping[int, Mapping[str, SupportsFloat]]
) -> None:
    """Add metrics to a model's run, and to the model where MLflow knows it.

    Of a metric's values the latest counts, and machines' clocks may differ: the time of these is
    after that of every value that is there.
    """
    try:
        model = store.client.get_logged_model(version.model_id).model_id
    except MlflowException:
        model = None
    names = {name for one in metrics.values() for name in one}
    known = [
        metric.timestamp
        for name in names
        for metric in store.client.get_metric_history(version.run_id, name)
    ]
    stamp = min(max([now(), *(time + 1 for time in known)]), LATEST)
    added = [m for step, of in metrics.items() for m in metrics_now(of, model, step, stamp)]
    store.log_metrics(version.run_id, added)


def model_metric_by_size(version: ModelVersion, name: str) -> dict[int, float]:
    """A metric of experiment 2 in a model's own run, by swarm size; empty where there is none."""
    with opened(create=False) as store:
        there = run_of_version(store, version.run_id) is not None
        history = store.client.get_metric_history(version.run_id, name) if there else []
    return {m.step: m.value for m in sorted(history, key=lambda m: m.timestamp)}


def training_tables(versions: Sequence[ModelVersion]) -> tuple[pd.DataFrame, pd.DataFrame]:
    """A row for each version, columns of Training; and for each of its epochs, columns of Epoch.

    Raises:
        InputError: where there is no tracking store yet.
    """
    with opened(create=False) as store:
        epochs = [epoch for version in versions for epoch in _epochs(store, version)]
    rows = [_training_row(version) for version in versions]
    return (
        pd.DataFrame(rows, columns=[field.name for field in fields(Training)]),
        pd.DataFrame(epochs, columns=[field.name for field in fields(Epoch)]),
    )


def _training_row(version: ModelVersion) -> Training:
    """The facts in a version's run; None where they are missing or malformed."""
    params, metrics = version.params, version.metrics
    return Training(
        arch=version.arch,
        recipe=version.recipe,
        training_seed=version.training_seed,
        version=version.version,
        parameters=whole(params.get("parameters", "")),
        epochs=whole(params.get("epochs", "")),
        train_instances=whole(params.get("train_instances", "")),
        best_epoch=whole_metric(metrics.get("best_epoch")),
        valid_loss=metrics.get("best_valid_loss"),
        valid_flown_safe_share=metrics.get("valid_flown_safe_share"),
        valid_flown_fuel=metrics.get("valid_flown_fuel"),
        valid_flown_trials=metrics.get("valid_flown_trials"),
        seconds=metrics.get("training_seconds"),
        device=params.get("device"),
        threads=params.get("threads"),
        weights_kib=metrics.get("weights_kib"),
    )


def _epochs(store: Store, version: ModelVersion) -> list[Epoch]:
    """The losses of a training; none where its run is gone."""
    if not version.params:
        return []
    train, valid = (
        {m.step: m.value for m in store.client.get_metric_history(version.run_id, loss)}
        for loss in CURVES
    )
    of, nan = (version.arch, version.recipe, version.training_seed), float("nan")
    return [Epoch(*of, k, train.get(k, nan), valid.get(k, nan)) for k in sorted({*train, *valid})]
