"""What evaluations add to a model's own training run: metrics, figures, the dataset."""

from collections.abc import Mapping
from pathlib import Path
from typing import SupportsFloat

from mlflow.exceptions import MlflowException

from registry.entries import log_metrics, metrics_now, now
from registry.running import FAILURES
from registry.store import Store, opened
from registry.story import EVALUATION_DATA, dataset_input
from registry.values import warn
from registry.version import ModelVersion, run_of_version

LAST = 2**63 - 1
"""Latest time that a store keeps, ms."""


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
        dataset: folder and digest of the dataset that it was evaluated on.

    Raises:
        ProlearnError: where the store cannot be opened.
    """
    with opened(create=False) as store:
        try:
            if run_of_version(store, version.run_id) is None:
                raise FileNotFoundError("it is gone")
            _add(store, version, metrics)
            used = dataset_input(*dataset, EVALUATION_DATA)
            store.client.log_inputs(version.run_id, [used])
            store.client.log_artifacts(version.run_id, str(figures), "figures")
        except FAILURES as error:
            reason = next(iter(str(error).splitlines()), "")[:300]
            warn(f"The evaluation of {version.uri} is not added to its training run ({reason}).")


def _add(
    store: Store, version: ModelVersion, metrics: Mapping[int, Mapping[str, SupportsFloat]]
) -> None:
    """Add metrics to a model's run, and to the model where MLflow knows it."""
    try:
        model = store.client.get_logged_model(version.model_id).model_id
    except MlflowException:
        model = None
    stamp = _after_all(store, version.run_id, {name for one in metrics.values() for name in one})
    entities = [
        metric
        for step, values in metrics.items()
        for metric in metrics_now(values, model, step, stamp)
    ]
    log_metrics(store, version.run_id, entities)


def model_metric_by_size(version: ModelVersion, name: str) -> dict[int, float]:
    """A metric of experiment 2 in a model's own run, by swarm size; empty where there is none.

    Raises:
        ProlearnError: where the store fails.
    """
    with opened(create=False) as store:
        there = run_of_version(store, version.run_id) is not None
        history = store.client.get_metric_history(version.run_id, name) if there else []
    return {m.step: m.value for m in sorted(history, key=lambda m: m.timestamp)}


def _after_all(store: Store, run_id: str, names: set[str]) -> int:
    """A time, ms, after that of every value that metrics of a run have: now, if clocks agree.

    The latest value of a metric is the one that counts, and machines' clocks may differ.
    """
    known = [m.timestamp for name in names for m in store.client.get_metric_history(run_id, name)]
    return min(max([now(), *(stamp + 1 for stamp in known)]), LAST)
