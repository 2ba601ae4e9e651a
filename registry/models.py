"""Registered models: listed, found by name, loaded, made the champion."""

import re
from collections.abc import Mapping

import mlflow
from mlflow.exceptions import MlflowException

from pipeline.errors import InputError
from pipeline.networks.model import Model
from pipeline.networks.model import load as load_network
from pipeline.scratch import scratch_folder
from registry.store import Store, opened
from registry.version import (
    CHAMPION,
    CONTEST,
    PREFIX,
    ModelVersion,
    read_version,
    read_versions,
    registered,
)

FORMS = "ARCH, ARCH:RECIPE, NAME@ALIAS, NAME/VERSION or a models:/ URI"

NETWORK_PATH = "data/network"
"""Where the network's folder lies inside a logged model."""

_NOT_THERE = {"RESOURCE_DOES_NOT_EXIST", "INVALID_PARAMETER_VALUE"}


def list_versions() -> list[ModelVersion]:
    """Every registered version, by name and number."""
    with opened(create=False) as store:
        return read_versions(store)


def newest_trainings(digests: Mapping[int, str] | None = None) -> list[ModelVersion]:
    """The newest trainings of each architecture and recipe that differ in their seed alone.

    Of those trained on other data or with other settings, only those like the newest count; of
    several trainings with one seed the newest.

    Args:
        digests: by swarm size, of the data that they were trained on; by default any.
    """
    wanted = set(digests.items()) if digests is not None else None
    versions = [v for v in list_versions() if wanted is None or (v.n, v.dataset_digest) in wanted]
    keys = {(v.arch, v.recipe): v.training_key for v in versions}
    newest = {
        (v.arch, v.recipe, v.training_seed): v
        for v in versions
        if v.training_key == keys[v.arch, v.recipe]
    }
    return [newest[key] for key in sorted(newest)]


def resolve(reference: str) -> ModelVersion:
    """The version that a reference means, with all that is known about it.

    ``lstm2`` is the champion of prolearn-lstm2, ``lstm2:paper`` its newest version trained by
    that recipe, ``lstm2@ALIAS`` and ``lstm2/3`` one version; the registered name
    ``prolearn-lstm2`` serves as well as the architecture's, and ``models:/`` may stand before.

    Raises:
        InputError: where there is no such model; it lists what there is.
    """
    with opened(create=False) as store:
        return _find(store, reference)


def load(reference: str | ModelVersion) -> tuple[Model, ModelVersion]:
    """A registered network and its version, from safetensors and JSON alone.

    Raises:
        InputError: where there is no such model, or its files are gone or not sound.
    """
    with opened(create=False) as store, scratch_folder() as scratch:
        version = reference if isinstance(reference, ModelVersion) else _find(store, reference)
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
    """The champion of a registered model, or None where it has none."""
    return next((v for v in list_versions() if v.name == name and CHAMPION in v.aliases), None)


def set_champion(version: ModelVersion) -> ModelVersion:
    """Make a version the champion, which commands take when a model is named alone."""
    with opened(create=False) as store:
        number = str(version.version)
        store.client.set_registered_model_alias(version.name, CHAMPION, number)
        return read_version(store, store.client.get_model_version(version.name, number))


def note_contest(version: ModelVersion, outcome: str) -> None:
    """Note that a version was compared with the champion, and how that ended."""
    with opened(create=False) as store:
        number = str(version.version)
        store.client.set_model_version_tag(version.name, number, CONTEST, outcome)


def _find(store: Store, reference: str) -> ModelVersion:
    match = re.fullmatch(
        r"(?:models:/+)?([A-Za-z0-9_.-]+)(?:([:/@])([A-Za-z0-9_.-]+))?", reference.strip()
    )
    if match is None:
        raise InputError(f"The model is given as {reference!r}; expected {FORMS}.")
    try:
        found = _search(store, match[1], match[2] or "", match[3] or "")
    except MlflowException as error:
        if error.error_code not in _NOT_THERE:
            raise
        found = None
    if found is None:
        known = ", ".join(
            f"{v.name}/{v.version} ({', '.join((v.recipe, *v.aliases))})"
            for v in read_versions(store)
        )
        raise InputError(
            f"There is no model {reference!r} in the registry; expected {FORMS}, of which there "
            f"are {known or 'none yet'}: train one with `prolearn train --arch ARCH --recipe "
            "RECIPE`."
        )
    return found


def _search(store: Store, name: str, mark: str, rest: str) -> ModelVersion | None:
    """The version of a name, the sign after it, and what follows, empty for a bare name.

    MLflow raises where the alias or the number is unknown.
    """
    if name.startswith("m-") and not mark:
        return next((v for v in read_versions(store) if v.model_id == name), None)
    names = {m.name for m in registered(store)}
    known = next((n for n in (name, PREFIX + name) if n in names), None)
    if known is None:
        return None
    if mark == ":" or (mark, rest) == ("/", "latest"):
        recipe = rest if mark == ":" else None
        versions = [v for v in read_versions(store) if v.name == known]
        return next((v for v in reversed(versions) if recipe in (None, v.recipe)), None)
    if mark == "/":
        return read_version(store, store.client.get_model_version(known, rest))
    alias = rest or CHAMPION
    return read_version(store, store.client.get_model_version_by_alias(known, alias))
