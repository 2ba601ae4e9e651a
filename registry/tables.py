"""Trainings as tables, for the report: a row a model, and the learning curves."""

from collections.abc import Iterable, Sequence
from dataclasses import fields
from typing import Any

import pandas as pd

from pipeline.experiments.records import Epoch, Training
from registry.store import Store, opened
from registry.values import whole, whole_metric
from registry.version import ModelVersion

KNOWN = ("arch", "recipe", "training_seed", "version")
"""What a version knows itself; the rest its run says."""


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
    """What a version's run says, and None for what it does not or is nonsense."""
    params, metrics = version.params, version.metrics
    counted = ("parameters", "epochs", "train_instances")
    measured = ("valid_flown_safe_share", "valid_flown_fuel", "valid_flown_trials", "weights_kib")
    told: dict[str, Any] = {
        **{name: getattr(version, name) for name in KNOWN},
        **{name: whole(params.get(name, "")) for name in counted},
        **{name: metrics.get(name) for name in measured},
        **{name: params.get(name) for name in ("device", "threads")},
    }
    return Training(
        **told,
        best_epoch=whole_metric(metrics.get("best_epoch")),
        valid_loss=metrics.get("best_valid_loss"),
        seconds=metrics.get("training_seconds"),
    )


def _epochs(store: Store, version: ModelVersion) -> list[Epoch]:
    """The losses of a training; none where its run is gone."""
    if not version.params:
        return []
    train, valid = (
        {m.step: m.value for m in store.client.get_metric_history(version.run_id, loss)}
        for loss in ("train_loss", "valid_loss")
    )
    of, nan = (version.arch, version.recipe, version.training_seed), float("nan")
    return [Epoch(*of, k, train.get(k, nan), valid.get(k, nan)) for k in sorted({*train, *valid})]
