"""Trainings as tables, for the report: a row a model, and the learning curves."""

from collections.abc import Iterable, Sequence
from dataclasses import fields
from typing import Any

import pandas as pd

from pipeline.experiments.trainings.rows import Epoch, Training
from registry.store import Store, opened
from registry.version import ModelVersion

KNOWN = ("arch", "recipe", "training_seed", "version")
"""What a version knows itself; the rest its run says."""

WHOLE = ("parameters", "epochs", "train_instances", "best_epoch")


def training_tables(versions: Sequence[ModelVersion]) -> tuple[pd.DataFrame, pd.DataFrame]:
    """A row for each version, columns of Training; and for each of its epochs, columns of Epoch.

    Raises:
        InputError: where there is no tracking store yet.
        ProlearnError: where the store fails.
    """
    with opened(create=False) as store:
        epochs = [epoch for version in versions for epoch in _epochs(store, version)]
    return _table(Training, map(_training, versions)), _table(Epoch, epochs)


def _table(row: type[Any], rows: Iterable[object]) -> pd.DataFrame:
    return pd.DataFrame(list(rows), columns=[field.name for field in fields(row)])


def _training(version: ModelVersion) -> Training:
    told: dict[str, Any] = {**version.params, **version.metrics}
    told |= {name: int(told[name]) for name in WHOLE if name in told}
    told |= {"valid_loss": told.get("best_valid_loss"), "seconds": told.get("training_seconds")}
    told |= {name: getattr(version, name) for name in KNOWN}
    row: dict[str, Any] = {field.name: told.get(field.name) for field in fields(Training)}
    return Training(**row)


def _epochs(store: Store, version: ModelVersion) -> list[Epoch]:
    """The losses of a training."""
    train, valid = (
        {m.step: m.value for m in store.client.get_metric_history(version.run_id, loss)}
        for loss in ("train_loss", "valid_loss")
    )
    of, nan = (version.arch, version.recipe, version.training_seed), float("nan")
    return [Epoch(*of, k, train.get(k, nan), valid.get(k, nan)) for k in sorted({*train, *valid})]
