"""Metrics of models in their training runs: evaluations added, tables of trainings read."""

import math
from collections.abc import Collection, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, SupportsFloat

import pandas as pd
from mlflow.entities import Dataset
from mlflow.exceptions import MlflowException

from pipeline.experiments.records import TABLES, EpochLosses
from pipeline.text import first_line
from registry import entities, models
from registry.store import Store, opened

CURVES = ("train_loss", "valid_loss")
LATEST = 2**63 - 1  # latest time that a store keeps, ms


def add_model_results(
    version: models.ModelVersion,
    metrics: Mapping[int, Mapping[str, SupportsFloat]],
    figures: Path,
    *,
    dataset: tuple[str, str],
) -> None:
    """Add an evaluation to a model's own training run, or warn where that run cannot take it.

    Metrics are by step, then by name; the dataset is its folder and digest.
    """
    with opened(create=False) as store:
        try:
            run = models.active_run(store, version.run_id)
            if run is None:
                raise FileNotFoundError("it is gone")
            used = entities.dataset_input(*dataset, entities.EVALUATION_DATA)
            _add_metrics(store, version, metrics, run.data.metrics, used.dataset)
            store.client.log_inputs(version.run_id, [used])
            store.client.log_artifacts(version.run_id, str(figures), "figures")
        except Exception as error:  # of any kind: where files are, each cloud's library has its own
            entities.warn(
                f"The evaluation of {version.uri} is not added to its training run "
                f"({first_line(error)[:300]})."
            )


def _add_metrics(
    store: Store,
    version: models.ModelVersion,
    metrics: Mapping[int, Mapping[str, SupportsFloat]],
    there: Collection[str],
    dataset: Dataset,
) -> None:
    """Add metrics to a run and its model, dated after those ``there``, as clocks may differ."""
    try:
        model = store.client.get_logged_model(version.model_id).model_id
    except MlflowException:
        model = None
    names = {name for one in metrics.values() for name in one if name in there}
    history = store.client.get_metric_history
    known = [metric.timestamp for name in names for metric in history(version.run_id, name)]
    stamp = min(max([entities.now(), *(time + 1 for time in known)]), LATEST)
    as_metrics = partial(entities.metrics_of, model_id=model, stamp=stamp, dataset=dataset)
    added = [m for step, values in metrics.items() for m in as_metrics(values, step=step)]
    store.client.log_batch(version.run_id, metrics=added)


def model_metrics_by_size(
    version: models.ModelVersion, names: Collection[str]
) -> tuple[str, dict[str, dict[int, float]]]:
    """A model's metrics by swarm size (experiment 2), on the dataset of its last evaluation.

    Returns the first digits of the dataset's digest, empty in evaluations by earlier versions, and
    the metrics that there are, by name and swarm size.
    """
    with opened(create=False) as store:
        try:
            there = store.client.get_logged_model(version.model_id).metrics or ()
        except MlflowException:
            there = ()
    found = sorted((m for m in there if m.key in names), key=lambda m: m.timestamp)
    digest = found[-1].dataset_digest if found else None
    by_size: dict[str, dict[int, float]] = {}
    for metric in found:
        if metric.dataset_digest == digest:
            by_size.setdefault(metric.key, {})[metric.step] = metric.value
    return digest or "", by_size


def training_tables(
    versions: Sequence[models.ModelVersion], names: Mapping[str, str] | None = None
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Two tables of trainings: a row for each model version, and a row for each training epoch.

    Versions have names by URI, by default those of ``table_names``.
    """
    names = models.table_names(versions) if names is None else names
    with opened(create=False) as store:
        epochs = [e for v in versions for e in _epochs(store, v, names[v.uri])]
    rows = [_training_row(version) | {"arch": names[version.uri]} for version in versions]
    training, curves = (list(TABLES[name]) for name in ("training", "curves"))
    return pd.DataFrame(rows, columns=training), pd.DataFrame(epochs, columns=curves)


def _training_row(version: models.ModelVersion) -> dict[str, Any]:
    params, metrics = version.params, version.metrics
    counts = ("parameters", "epochs", "train_instances")
    measured = ("valid_flown_safe_share", "valid_flown_fuel", "valid_flown_trials", "weights_kib")
    return {
        **{name: getattr(version, name) for name in ("recipe", "training_seed", "version")},
        "n": version.n or None,
        **{name: entities.whole_number(params.get(name, "")) for name in counts},
        **{name: metrics.get(name) for name in measured},
        **{name: params.get(name) for name in ("device", "threads")},
        "best_epoch": entities.whole_number(f"{metrics.get('best_epoch', math.nan):.0f}"),
        "valid_loss": metrics.get("best_valid_loss"),
        "seconds": metrics.get("training_seconds"),
    }


def _epochs(store: Store, version: models.ModelVersion, name: str) -> list[EpochLosses]:
    if not version.params:  # its run is gone
        return []
    train, valid = (
        {m.step: m.value for m in store.client.get_metric_history(version.run_id, loss)}
        for loss in CURVES
    )
    key = name, version.recipe, version.training_seed
    steps = sorted({*train, *valid})
    return [EpochLosses(*key, k, train.get(k, math.nan), valid.get(k, math.nan)) for k in steps]
