"""Trainings as tables, for the report: a row a model, and the learning curves."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from typing import Any

import pandas as pd

from pipeline.experiments.trainings.rows import Epoch, Training
from registry.store import Store, opened
from registry.version import ModelVersion


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
    metrics, params = version.metrics, version.params

    def whole(told: Mapping[str, Any], name: str) -> int | None:
        return int(told[name]) if name in told else None

    return Training(
        arch=version.arch,
        recipe=version.recipe,
        training_seed=version.training_seed,
        version=version.version,
        parameters=whole(params, "parameters"),
        epochs=whole(params, "epochs"),
        train_instances=whole(params, "train_instances"),
        best_epoch=whole(metrics, "best_epoch"),
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
    """The losses of a training."""
    train, valid = (
        {m.step: m.value for m in store.client.get_metric_history(version.run_id, loss)}
        for loss in ("train_loss", "valid_loss")
    )
    of, nan = (version.arch, version.recipe, version.training_seed), float("nan")
    return [Epoch(*of, k, train.get(k, nan), valid.get(k, nan)) for k in sorted({*train, *valid})]
