"""Parameters and metrics of runs, as the store keeps them."""

import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, SupportsFloat

from mlflow.entities import Metric, Param

from pipeline.urls import public_url
from registry.store import Store

MOST_PARAMS = 100
MOST_METRICS = 1000
"""What MLflow takes in one request."""


def recorded(params: Mapping[str, Any]) -> dict[str, str]:
    """Parameters as the store keeps them: as text, without the secrets of URLs."""
    return {key: str(shown(value)) for key, value in params.items()}


def shown(value: Any) -> Any:
    """A parameter's value without the secrets of a URL; any other stays what it is."""
    text = str(value)
    return public_url(text) if "://" in text else value


def log_params(store: Store, run_id: str, params: Mapping[str, Any]) -> None:
    """Log parameters, in as few requests as MLflow allows."""
    entities = [Param(key, value) for key, value in recorded(params).items()]
    for batch in _batches(entities, MOST_PARAMS):
        store.client.log_batch(run_id, params=batch)


def log_metrics(store: Store, run_id: str, metrics: Sequence[Any]) -> None:
    """Log MLflow's metrics, in as few requests as MLflow allows."""
    for batch in _batches(metrics, MOST_METRICS):
        store.client.log_batch(run_id, metrics=batch)


def now() -> int:
    """The time that metrics have, ms since 1970."""
    return int(time.time() * 1000)


def metrics_now(
    metrics: Mapping[str, SupportsFloat],
    model_id: str | None = None,
    step: int = 0,
    stamp: int | None = None,
) -> list[Any]:
    """MLflow's metrics for values reached by now, of a run and of a model that it logged."""
    stamp = now() if stamp is None else stamp
    return [Metric(k, float(v), stamp, step, model_id=model_id) for k, v in metrics.items()]


def _batches(entities: Sequence[Any], most: int) -> Iterator[Sequence[Any]]:
    return (entities[k : k + most] for k in range(0, len(entities), most))
