"""MLflow's entities (parameters, metrics, datasets, pages of results) from and as plain values."""

import json
import logging
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, SupportsFloat

from mlflow.entities import Dataset, DatasetInput, InputTag, Metric, Param

from pipeline.text import public, public_url, visible

TRAINING_DATA, EVALUATION_DATA = "training", "evaluation"  # what MLflow calls a dataset's use
_WHOLE = re.compile(r"-?[0-9]{1,15}")


def pages(search: Callable[..., Any], **query: Any) -> Iterator[Any]:
    """All results of one of MLflow's searches, page after page."""
    token = None
    while True:
        page = search(page_token=token, **query)
        yield from page
        token = page.token
        if not token:
            return


def recorded(params: Mapping[str, Any]) -> dict[str, str]:
    """Parameters as the store keeps them: as text, without the secrets of URLs."""
    return {key: str(without_secrets(value)) for key, value in params.items()}


def without_secrets(value: Any) -> Any:
    """A parameter's value without the secrets of a URL; any other stays what it is."""
    text = str(value)
    return public_url(text) if "://" in text else value


def params_of(values: Mapping[str, Any]) -> list[Any]:
    """MLflow's parameters of a run."""
    return [Param(key, value) for key, value in recorded(values).items()]


def now() -> int:
    """The time that metrics have, ms since 1970."""
    return int(time.time() * 1000)


def metrics_of(
    values: Mapping[str, SupportsFloat],
    model_id: str | None = None,
    step: int = 0,
    stamp: int | None = None,
    dataset: Dataset | None = None,
) -> list[Any]:
    """MLflow's metrics, as of now, of a run, of a model that it logged and of a dataset."""
    of = (model_id, *((dataset.name, dataset.digest) if dataset else (None, None)))
    stamp = now() if stamp is None else stamp
    return [Metric(k, float(v), stamp, step, *of) for k, v in values.items()]


def curve_metrics(history: Mapping[str, Sequence[float | int]]) -> list[Any]:
    """Learning curves as MLflow's metrics; step = epoch."""
    stamp = now()
    names = {"train_loss": "train_loss", "valid_loss": "valid_loss", "seconds": "epoch_seconds"}
    return [
        Metric(name, float(value), stamp, int(epoch))
        for column, name in names.items()
        for epoch, value in zip(history["number"], history[column], strict=True)
    ]


def dataset_input(
    path: str, digest: str, context: str, profile: Mapping[str, Any] | None = None
) -> Any:
    """MLflow's record of a run's dataset; ``context`` is TRAINING_DATA or EVALUATION_DATA."""
    path = public_url(path)
    # A run has a dataset of one name and digest once, whatever it used it for.
    suffix = "" if context == TRAINING_DATA else f"-{context}"
    entity = Dataset(
        name=(Path(path).name or path) + suffix,
        digest=digest[:36],  # the longest that MLflow takes; the parameter has it in full
        source_type="local",
        source=json.dumps({"uri": path}),
        profile=json.dumps({"digest": digest, **(profile or {})}, default=str),
    )
    return DatasetInput(entity, [InputTag("mlflow.data.context", context)])


def whole_number(text: str) -> int | None:
    """A whole number in ordinary digits, or None where the text is none."""
    return int(text) if _WHOLE.fullmatch(text) else None


def utc_time(milliseconds: int | None) -> datetime:
    """A time of MLflow's as a date in UTC; 1970-01-01 where it is none."""
    try:
        return datetime.fromtimestamp((milliseconds or 0) / 1000, UTC)
    except (ValueError, OverflowError, OSError):
        return datetime.fromtimestamp(0, UTC)


def own_tags(tags: Mapping[str, str]) -> dict[str, str]:
    """A run's tags without those that MLflow sets."""
    return {k: v for k, v in tags.items() if "mlflow." not in k}


def warn(sentence: str) -> None:
    """Say on stderr what of a store is left out, and why."""
    logging.getLogger("prolearn").warning("%s", visible(public(sentence)))
