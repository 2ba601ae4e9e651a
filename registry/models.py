"""Registered models: list them, load one, compare them, make one the champion."""

import math
from pathlib import Path
from tempfile import TemporaryDirectory

import mlflow

from pipeline.errors import InputError
from pipeline.networks.model import Model
from pipeline.networks.model import load as load_network
from registry.reference import find, resolve
from registry.store import opened
from registry.version import CHAMPION, ModelVersion, read_version, read_versions

VALIDATION_METRIC = "valid_position_rmse"
"""What decides between two versions: RMS error of predicted node positions, m."""

NETWORK_PATH = "data/network"
"""Where the network's folder lies inside a logged model."""

__all__ = ["list_versions", "load", "newest_trainings", "promote", "resolve"]


def list_versions() -> list[ModelVersion]:
    """Every registered version, by name and number.

    Raises:
        ProlearnError: where the store fails.
    """
    with opened(create=False) as store:
        return read_versions(store)


def newest_trainings() -> list[ModelVersion]:
    """The newest version of each architecture, recipe and training seed, in this order.

    Raises:
        ProlearnError: where the store fails.
    """
    newest = {(v.arch, v.recipe, v.training_seed): v for v in list_versions()}
    return [newest[key] for key in sorted(newest)]


def load(reference: str | ModelVersion) -> tuple[Model, ModelVersion]:
    """A registered network and its version, from safetensors and JSON alone.

    Raises:
        InputError: where there is no such model, or its files are gone or not sound.
        ProlearnError: where the store fails.
    """
    with opened(create=False) as store, TemporaryDirectory(prefix="prolearn-") as scratch:
        version = reference if isinstance(reference, ModelVersion) else find(store, reference)
        mlflow.artifacts.download_artifacts(
            artifact_uri=version.uri, dst_path=scratch, tracking_uri=store.uri
        )
        folder = Path(scratch) / NETWORK_PATH
        if not folder.is_dir():
            raise InputError(
                f"{version.uri} has no {NETWORK_PATH}; expected a model that `prolearn train` "
                "registered: train it anew, or, where the project was moved, see docs/mlflow.md."
            )
        return load_network(folder), version


def promote(name: str, version: int, *, force: bool = False) -> ModelVersion:
    """Make a version the champion of its registered model.

    Args:
        name: the registered model, or its architecture.
        version: number of the version.
        force: also where its validation metric is worse than the champion's.

    Raises:
        InputError: where there is no such version, or it does worse than the champion.
        ProlearnError: where the store fails.
    """
    with opened(create=False) as store:
        chosen = find(store, f"{name}/{version}")
        others = [v for v in read_versions(store) if v.name == chosen.name]
        for champion in (v for v in others if CHAMPION in v.aliases and not force):
            _check_no_worse(chosen, champion)
        store.client.set_registered_model_alias(chosen.name, CHAMPION, str(chosen.version))
        found = store.client.get_model_version(chosen.name, str(chosen.version))
        return read_version(store, found)


def _check_no_worse(chosen: ModelVersion, champion: ModelVersion) -> None:
    reached = chosen.metrics.get(VALIDATION_METRIC, math.nan)
    needed = champion.metrics.get(VALIDATION_METRIC, math.nan)
    if not (reached <= needed or math.isnan(needed)):  # nan reached is no better than anything
        raise InputError(
            f"{chosen.name}/{chosen.version} has {VALIDATION_METRIC} {reached:.4g} m; expected "
            f"no more than the {needed:.4g} m of the champion, version {champion.version}: give "
            "--force to promote it all the same."
        )
