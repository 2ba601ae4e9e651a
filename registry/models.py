"""Registered models: listed, found by name, loaded, made the champion."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from datetime import datetime
from json import dumps
from shlex import quote
from typing import TYPE_CHECKING, Any

import mlflow
from mlflow.exceptions import MlflowException

from pipeline.errors import InputError
from pipeline.networks.recipes import Recipe
from pipeline.scratch import scratch_folder
from registry.entities import own_tags, pages, recorded, utc_time, warn, whole_number
from registry.environment import MADE_WITH
from registry.store import TRAINING, Store, opened

if TYPE_CHECKING:
    from pipeline.networks.model import Model

PREFIX = "prolearn-"
CHAMPION = "champion"
CONTEST = "contest"  # tag of a version: how its comparison with the champion ended
WEIGHTS = "weights"  # tag of a version with its model's digest
MOST_DIGITS = 18  # of a version's number, which databases keep in 64 bits
FORMS = "ARCH, ARCH:RECIPE, NAME@ALIAS, NAME/VERSION or a models:/ URI"
NETWORK_PATH = "data/network"  # where the network's folder lies inside a logged model

PARAM_OF_FIELD = {field.name: field.name for field in fields(Recipe)} | {
    "name": "recipe",
    "epochs": "most_epochs",  # a training's ``epochs`` are those that it took
}
"""Parameters of a run that are fields of its recipe, by field."""

_NOT_THERE = {"RESOURCE_DOES_NOT_EXIST", "INVALID_PARAMETER_VALUE"}
_OURS = f"name LIKE '{PREFIX}%'"
_left_out: set[tuple[str, str]] = set()  # stores, and the warnings on their versions already given


@dataclass(frozen=True)
class ModelVersion:
    """One version of a registered model, with parameters, metrics and tags of its training run."""

    name: str  # of the registered model, prolearn-<arch>
    version: int  # from 1
    arch: str
    recipe: str
    run_id: str  # of its training
    model_id: str  # of MLflow's logged model
    aliases: tuple[str, ...]  # such as champion
    dataset_digest: str  # of the rows that it was trained on
    created: datetime  # when it was registered
    params: Mapping[str, str] = field(repr=False)  # of the run
    # latest values of the run, evaluations included
    metrics: Mapping[str, float] = field(repr=False)
    tags: Mapping[str, str] = field(repr=False)  # of the run, such as versions of packages
    contest: str = ""  # how the comparison with the champion ended; empty where none was made
    weights: str = ""  # digest of the model; empty where an earlier version registered it

    def __post_init__(self) -> None:
        """Refuse a training run whose seed or swarm size is no number."""
        for name in ("seed", "n_spacecraft"):
            text = self.params.get(name, "0")
            if whole_number(text) is None:
                raise InputError(
                    f"{self.uri} cannot be used: {name} of its training run {self.run_id} is "
                    f"{text[:40]!r}; expected a whole number: delete the version, or name another."
                )

    @property
    def uri(self) -> str:
        """The URI by which MLflow loads it."""
        return f"models:/{self.name}/{self.version}"

    @property
    def training_seed(self) -> int:
        """Seed of its weights, order and dropout; 0 where its run is gone."""
        return int(self.params.get("seed", 0))

    @property
    def n(self) -> int:
        """Swarm size of its training; 0 where its run is gone."""
        return int(self.params.get("n_spacecraft", 0))

    @property
    def training_key(self) -> tuple[str, ...]:
        """All that decides its training except the seed: data, size, recipe, versions."""
        names = ("n_spacecraft", *sorted(PARAM_OF_FIELD.values()))
        params = (self.params.get(name, "") for name in names)
        return (self.arch, self.dataset_digest, self.tags.get(MADE_WITH, ""), *params)

    @property
    def label(self) -> str:
        """Architecture and recipe, as tables call it."""
        return f"{self.arch}:{self.recipe}"

    @property
    def numbered(self) -> str:
        """Architecture and version, as tables call one of several that differ beyond seeds."""
        kind = "" if self.is_own else f"{self.name.removeprefix(PREFIX)}/"
        return f"{self.arch}/{kind}{self.version}"

    @property
    def is_own(self) -> bool:
        """Whether its model is the one of its training; MLflow can copy and rename models."""
        return self.name == PREFIX + self.arch


def recipe_params(recipe: Recipe) -> dict[str, Any]:
    """A recipe as parameters of a run."""
    values = asdict(recipe) | {"options": dumps(dict(recipe.options), sort_keys=True)}
    return {PARAM_OF_FIELD[name]: value for name, value in values.items()}


def table_names(versions: Sequence[ModelVersion]) -> dict[str, str]:
    """Names in tables by URI: architectures, with versions where trainings differ beyond seeds."""
    names = {}
    for version in versions:
        alike = [v for v in versions if v.label == version.label]
        again = [v.training_seed for v in alike].count(version.training_seed) > 1
        mixed = again or len({v.training_key for v in alike}) > 1
        names[version.uri] = version.numbered if mixed else version.arch
    return names


def list_versions() -> list[ModelVersion]:
    """Every registered version, by name and number, except those with malformed runs."""
    with opened(create=False) as store:
        return _versions(store)


def newest_trainings(digests: Mapping[int, str] | None = None) -> list[ModelVersion]:
    """The newest training of each architecture, recipe and seed.

    Only those that differ from the newest of their recipe in nothing but the seed. With digests of
    data, by swarm size, only those trained on it.
    """
    versions = [
        v for v in list_versions() if digests is None or digests.get(v.n) == v.dataset_digest
    ]
    versions.sort(key=lambda v: v.is_own)  # copies under other names are never the newest
    keys = {(v.arch, v.recipe): v.training_key for v in versions}
    newest = {
        (v.arch, v.recipe, v.training_seed): v
        for v in versions
        if v.training_key == keys[v.arch, v.recipe]
    }
    return [newest[key] for key in sorted(newest)]


def resolve(reference: str) -> ModelVersion:
    """The registered version that a reference names.

    ``lstm2`` is the champion of prolearn-lstm2, ``lstm2:paper`` its newest version trained by
    that recipe, ``lstm2@ALIAS`` and ``lstm2/3`` one version; the registered name
    ``prolearn-lstm2`` serves as well as the architecture's, and ``models:/`` may stand before.
    Where there is no such model, the InputError lists those there are.
    """
    with opened(create=False) as store:
        return _find(store, reference)


def load(reference: str | ModelVersion) -> "tuple[Model, ModelVersion]":
    """A registered network and its version, by safetensors and JSON; InputError if not sound."""
    # With torch, which is slow to import, and which no list of models needs.
    from pipeline.networks.model import load as load_network

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
        return read_version(store, version.name, number)


def note_contest(version: ModelVersion, outcome: str) -> ModelVersion:
    """Record how the comparison of a version with the champion ended; the version with it."""
    with opened(create=False) as store:
        number = str(version.version)
        store.client.set_model_version_tag(version.name, number, CONTEST, outcome)
        return read_version(store, version.name, number)


def read_version(store: Store, name: str, number: str) -> ModelVersion:
    """Read a version of a registered model; InputError where its training run is malformed."""
    found = store.client.get_model_version(name, number)
    return _described(found, active_run(store, found.run_id))


def active_run(store: Store, run_id: str | None) -> Any:
    """MLflow's run of an id, or None where it was deleted or never there."""
    try:
        run = store.client.get_run(run_id) if run_id else None
        return run if run and run.info.lifecycle_stage == "active" else None
    except MlflowException as error:
        if error.error_code == "RESOURCE_DOES_NOT_EXIST":
            return None
        raise


def _versions(store: Store) -> list[ModelVersion]:
    client = store.client
    aliases = {
        model.name: dict(model.aliases)
        for model in pages(client.search_registered_models, filter_string=_OURS)
    }
    training = [store.experiments[TRAINING]]
    trainings = pages(client.search_runs, experiment_ids=training, max_results=1000)
    runs = {run.info.run_id: run for run in trainings}
    versions = []
    for found in pages(client.search_model_versions, filter_string=_OURS):
        items = aliases.get(found.name, {}).items()
        found.aliases = [alias for alias, number in items if str(number) == str(found.version)]
        try:
            # An experiment may have been renamed, and a run deleted.
            run = runs.get(found.run_id) or active_run(store, found.run_id)
            versions.append(_described(found, run))
        except InputError as error:
            known = (store.uri, str(error))  # a command reads the versions several times
            if known not in _left_out:
                warn(f"{error} It is left out.")
            _left_out.add(known)
    return sorted(versions, key=lambda v: (v.name, v.version))


def _described(found: Any, run: Any) -> ModelVersion:
    tags = dict(found.tags)
    return ModelVersion(
        name=found.name,
        version=int(found.version),
        arch=tags.get("arch", found.name.removeprefix(PREFIX)),
        recipe=tags.get("recipe", ""),
        run_id=found.run_id or "",
        model_id=found.model_id or tags.get("model_id", ""),
        aliases=tuple(sorted(found.aliases)),
        dataset_digest=tags.get("dataset_digest", ""),
        created=utc_time(found.creation_timestamp),
        params=recorded(run.data.params) if run else {},
        metrics=dict(run.data.metrics) if run else {},
        tags=own_tags(run.data.tags) if run else {},
        contest=tags.get(CONTEST, ""),
        weights=tags.get(WEIGHTS, ""),
    )


def _find(store: Store, reference: str) -> ModelVersion:
    match = re.fullmatch(
        r"(?:models:/+)?([A-Za-z0-9_.-]+)(?:([:/@])([A-Za-z0-9_.-]+))?", reference.strip()
    )
    if match is None:
        raise InputError(f"The model is given as {reference!r}; expected {FORMS}.")
    name, mark, rest = match.groups("")
    try:
        if found := _search(store, name, mark, rest):
            return found
    except MlflowException as error:
        if error.error_code not in _NOT_THERE:
            raise
    versions, name = _versions(store), _registered(name)
    alike = ", ".join(str(v.version) for v in versions if v.name == name)
    if alike and (mark or "@", rest or CHAMPION) == ("@", CHAMPION):
        raise InputError(
            f"{name} has no champion; expected one, or the number of a version: make one of its "
            f"versions ({alike}) the champion with `prolearn models promote {quote(name)} "
            "--version V`."
        )
    known = [f"{v.name}/{v.version} ({', '.join((v.recipe, *v.aliases))})" for v in versions]
    raise InputError(
        f"There is no model {reference!r} in the registry; expected {FORMS}, of which there are "
        f"{', '.join(known) or 'none yet'}: train one with `prolearn train --arch ARCH --recipe "
        "RECIPE`."
    )


def _registered(name: str) -> str:
    return name if name.startswith(PREFIX) else PREFIX + name


def _search(store: Store, name: str, mark: str, rest: str) -> ModelVersion | None:
    """The version of a name, sign and rest, empty for a bare name; MLflow raises if unknown."""
    if name.startswith("m-") and not mark:
        return next((v for v in _versions(store) if v.model_id == name), None)
    name = _registered(name)
    if mark == ":" or (mark, rest) == ("/", "latest"):
        alike = [v for v in _versions(store) if v.name == name]
        return next((v for v in reversed(alike) if mark == "/" or v.recipe == rest), None)
    if mark != "/":
        rest = store.client.get_model_version_by_alias(name, rest or CHAMPION).version
    number = str(rest)
    return None if len(number) > MOST_DIGITS else read_version(store, name, number)
