"""Trainings as tables, for the report: a row a model, and the learning curves."""

from dataclasses import dataclass

import pandas as pd

from registry.models import newest_trainings
from registry.store import Store, opened
from registry.version import ModelVersion

_WHOLE = ("parameters", "epochs", "train_instances")

_TRAINING = (
    "arch",
    "recipe",
    "training_seed",
    "version",
    *_WHOLE,
    "best_epoch",
    "valid_loss",
    "valid_position_rmse",
    "seconds",
    "device",
    "weights_kib",
)

_CURVES = ("train_loss", "valid_loss")
_CURVE_COLUMNS = ("arch", "recipe", "training_seed", "epoch", *_CURVES)


@dataclass(frozen=True, eq=False)
class TrainingTables:
    """The newest version of each architecture, recipe and training seed.

    Attributes:
        training: a row for each, with columns arch, recipe, training_seed, version, parameters,
            epochs, best_epoch, valid_loss (at the best epoch), valid_position_rmse (m), seconds,
            device, train_instances and weights_kib; what a run does not say is missing.
        curves: columns arch, recipe, training_seed, epoch, train_loss and valid_loss.
    """

    training: pd.DataFrame
    curves: pd.DataFrame


def training_table() -> TrainingTables:
    """What the report says about the newest version of each architecture, recipe and seed.

    Raises:
        InputError: where there is no tracking store yet.
        ProlearnError: where the store fails.
    """
    versions = newest_trainings()
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
        "valid_position_rmse": metrics.get("valid_position_rmse"),
        "seconds": metrics.get("training_seconds"),
        "device": params.get("device"),
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
