"""Registered models: list them, load one, make one the champion."""

from collections.abc import Mapping

import mlflow

from pipeline.errors import InputError
from pipeline.networks.model import Model
from pipeline.networks.model import load as load_network
from pipeline.scratch import scratch_folder
from registry.reference import find, resolve
from registry.store import opened
from registry.version import CHAMPION, CONTEST, ModelVersion, read_version, read_versions

NETWORK_PATH = "data/network"
"""Where the network's folder lies inside a logged model."""

__all__ = ["champion_of", "crown", "list_versions", "load", "newest_trainings", "resolve"]


def list_versions() -> list[ModelVersion]:
    """Every registered version, by name and number.

    Raises:
        ProlearnError: where the store fails.
    """
    with opened(create=False) as store:
        return read_versions(store)


def newest_trainings(digests: Mapping[int, str] | None = None) -> list[ModelVersion]:
    """The newest trainings of each architecture and recipe that differ in their seed alone.

    Of those trained in several ways, on other data or with other settings, the way of the newest
    counts; of several trainings with one seed the newest.

    Args:
        digests: by swarm size, of the data that they were trained on; by default any.

    Raises:
        ProlearnError: where the store fails.
    """
    wanted = set(digests.items()) if digests is not None else None
    versions = [v for v in list_versions() if wanted is None or (v.n, v.dataset_digest) in wanted]
    way = {(v.arch, v.recipe): v.way for v in versions}
    newest = {
        (v.arch, v.recipe, v.training_seed): v for v in versions if v.way == way[v.arch, v.recipe]
    }
    return [newest[key] for key in sorted(newest)]


def load(reference: str | ModelVersion) -> tuple[Model, ModelVersion]:
    """A registered network and its version, from safetensors and JSON alone.

    Raises:
        InputError: where there is no such model, or its files are gone or not sound.
        ProlearnError: where the store fails.
    """
    with opened(create=False) as store, scratch_folder() as scratch:
        version = reference if isinstance(reference, ModelVersion) else find(store, reference)
        mlflow.artifacts.download_artifacts(
            artifact_uri=version.uri, dst_path=str(scratch), tracking_uri=store.uri
        )
        folder = scratch / NETWORK_PATH
        if not folder.is_dir():
            raise InputError(
                f"{version.uri} has no {NETWORK_PATH}; expected a model that `prolearn train` "
                "registered: train it anew, or, where the project was moved, see docs/mlflow.md."
            )
        try:
            return load_network(folder), version
        except InputError as error:
            raise InputError(f"{version.uri}: {str(error).replace(f'{folder}/', '')}") from error


def champion_of(name: str) -> ModelVersion | None:
    """The champion of a registered model, or None where it has none.

    Raises:
        ProlearnError: where the store fails.
    """
    return next((v for v in list_versions() if v.name == name and CHAMPION in v.aliases), None)


def settle(version: ModelVersion, outcome: str) -> None:
    """Note that a version's contest with the champion was held, and how it ended.

    Raises:
        ProlearnError: where the store fails.
    """
    with opened(create=False) as store:
        number = str(version.version)
        store.client.set_model_version_tag(version.name, number, CONTEST, outcome)


def crown(version: ModelVersion) -> ModelVersion:
    """Make a version the champion, which commands take when a model is named alone.

    Raises:
        ProlearnError: where the store fails.
    """
    with opened(create=False) as store:
        number = str(version.version)
        store.client.set_registered_model_alias(version.name, CHAMPION, number)
        return read_version(store, store.client.get_model_version(version.name, number))
