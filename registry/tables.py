"""Trainings as tables, for the report: a row a model, and the learning curves."""

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from registry.store import Store, opened
from registry.version import ModelVersion

_WHOLE = ("parameters", "epochs", "train_instances")

_VALIDATED = (
    *("valid_position_rmse", "valid_flown_safe_share", "valid_flown_fuel", "valid_flown_trials"),
)

_TRAINING = (
    "arch",
    "recipe",
    "training_seed",
    "version",
    *_WHOLE,
    "best_epoch",
    "valid_loss",
    *_VALIDATED,
    "seconds",
    "device",
    "threads",
    "weights_kib",
)

_CURVES = ("train_loss", "valid_loss")
_CURVE_COLUMNS = ("arch", "recipe", "training_seed", "epoch", *_CURVES)


@dataclass(frozen=True, eq=False)
class TrainingTables:
    """Versions as tables.

    Attributes:
        training: a row for each, with columns arch, recipe, training_seed, version, parameters,
            epochs, best_epoch, valid_loss (at the best epoch), valid_position_rmse (m),
            valid_flown_safe_share, valid_flown_fuel (m/s²), valid_flown_trials, seconds,
            device, threads, train_instances and weights_kib; what a run does not say is missing.
        curves: columns arch, recipe, training_seed, epoch, train_loss and valid_loss.
    """

    training: pd.DataFrame
    curves: pd.DataFrame


def training_tables(versions: Sequence[ModelVersion]) -> TrainingTables:
    """What the report says about some versions.

    Raises:
        InputError: where there is no tracking store yet.
        ProlearnError: where the store fails.
    """
    with opened(create=False) as store:
        curves = [_curves(store, v) for v in versions]
    none = pd.DataFrame(columns=list(_CURVE_COLUMNS))
    return TrainingTables(
        training=pd.DataFrame([_row(v) for v in versions], columns=list(_TRAINING)),
        curves=pd.concat(curves, ignore_index=True) if curves else none,
    )


def _row(version: ModelVersion) -> dict[str, object]:
    metrics, params = version.metrics, version.params
    best = metrics.get("best_epoch")
    return {
        "arch": version.arch,
        "recipe": version.recipe,
        "training_seed": version.training_seed,
        "version": version.version,
        **{key: int(params[key]) if key in params else None for key in _WHOLE},
        "best_epoch": None if best is None else int(best),
        "valid_loss": metrics.get("best_valid_loss"),
        **{key: metrics.get(key) for key in _VALIDATED},
        "seconds": metrics.get("training_seconds"),
        "device": params.get("device"),
        "threads": params.get("threads"),
        "weights_kib": metrics.get("weights_kib"),
    }


def _curves(store: Store, version: ModelVersion) -> pd.DataFrame:
    """Losses of each epoch."""
    curves = [
        pd.Series({m.step: m.value for m in store.client.get_metric_history(version.run_id, key)})
        for key in _CURVES
    ]
    table = pd.concat(curves, axis=1, keys=_CURVES).rename_axis("epoch").reset_index()
    known = {key: getattr(version, key) for key in ("arch", "recipe", "training_seed")}
    return table.assign(**known)[list(_CURVE_COLUMNS)]
