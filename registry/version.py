"""A registered model version with the parameters, metrics and tags of its training run."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from mlflow.exceptions import MlflowException

from pipeline.errors import InputError
from registry.entities import QUOTED, moment, own_tags, pages, recorded, warn, whole
from registry.environment import MADE_WITH
from registry.store import TRAINING, Store
from registry.training_record import RECIPE_PARAMS

PREFIX = "prolearn-"
CHAMPION = "champion"

CONTEST = "contest"
"""Tag of a version that says how its comparison with the champion ended, once it was made."""

_left_out: set[tuple[str, str]] = set()
"""Stores, and the warnings on their versions that were given."""


@dataclass(frozen=True)
class ModelVersion:
    """One version of a registered model, with its training run."""

    name: str  # of the registered model, prolearn-<arch>
    version: int  # from 1
    arch: str
    recipe: str
    run_id: str  # of its training
    model_id: str  # of MLflow's logged model
    aliases: tuple[str, ...]  # such as champion
    dataset_digest: str  # of the rows that it was trained on
    created: datetime  # when it was registered
    params: Mapping[str, str]  # of the run
    metrics: Mapping[str, float]  # latest values of the run, evaluations included
    tags: Mapping[str, str]  # of the run, such as the versions of what it was made with
    contest: str = ""  # how the comparison with the champion ended; empty where none was made

    def __post_init__(self) -> None:
        """Refuse a training run whose seed or swarm size is no number."""
        for name in ("seed", "n_spacecraft"):
            text = self.params.get(name, "0")
            if whole(text) is None:
                raise InputError(
                    f"{self.uri} cannot be used: {name} of its training run {self.run_id} is "
                    f"{text[:QUOTED]!r}; expected a whole number: delete the version, or name "
                    "another."
                )

    @property
    def uri(self) -> str:
        """What MLflow loads it by."""
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
        """All that decides its training but the seed: data, size, recipe, versions."""
        params = (self.params.get(name, "") for name in ("n_spacecraft", *RECIPE_PARAMS))
        return (self.arch, self.dataset_digest, self.tags.get(MADE_WITH, ""), *params)

    @property
    def label(self) -> str:
        """Architecture and recipe, as tables call it."""
        return f"{self.arch}:{self.recipe}"


def read_version(store: Store, found: Any) -> ModelVersion:
    """The value of one of MLflow's model versions.

    Raises:
        InputError: where the parameters of its training run are malformed.
    """
    aliases = dict(store.client.get_registered_model(found.name).aliases)
    return _describe(found, aliases, run_of_version(store, found.run_id))


def read_versions(store: Store) -> list[ModelVersion]:
    """Every registered version, by name and number, but those with malformed runs."""
    aliases = {m.name: dict(m.aliases) for m in registered(store)}
    trainings = pages(
        store.client.search_runs, experiment_ids=[store.experiments[TRAINING]], max_results=1000
    )
    runs = {run.info.run_id: run for run in trainings}
    versions = []
    for one in pages(store.client.search_model_versions, filter_string=f"name LIKE '{PREFIX}%'"):
        try:
            versions.append(_describe(one, aliases.get(one.name, {}), runs.get(one.run_id)))
        except InputError as error:
            _warn_once(store, f"{error} It is left out.")
    return sorted(versions, key=lambda v: (v.name, v.version))


def _warn_once(store: Store, why: str) -> None:
    """Warn of a version, once a process: a command reads the versions of a store several times."""
    if (store.uri, why) not in _left_out:
        _left_out.add((store.uri, why))
        warn(why)


def registered(store: Store) -> list[Any]:
    """MLflow's registered models that belong to prolearn."""
    return list(
        pages(store.client.search_registered_models, filter_string=f"name LIKE '{PREFIX}%'")
    )


def _describe(found: Any, aliases: Mapping[str, Any], run: Any) -> ModelVersion:
    """The value of one of MLflow's versions, with its model's aliases and its run, if any."""
    tags = dict(found.tags)
    return ModelVersion(
        name=found.name,
        version=int(found.version),
        arch=tags.get("arch", found.name.removeprefix(PREFIX)),
        recipe=tags.get("recipe", ""),
        run_id=found.run_id or "",
        model_id=found.model_id or tags.get("model_id", ""),
        aliases=tuple(sorted(a for a, v in aliases.items() if str(v) == str(found.version))),
        dataset_digest=tags.get("dataset_digest", ""),
        created=moment(found.creation_timestamp),
        params=recorded(run.data.params) if run else {},
        metrics=dict(run.data.metrics) if run else {},
        tags=own_tags(run.data.tags) if run else {},
        contest=tags.get(CONTEST, ""),
    )


def run_of_version(store: Store, run_id: str | None) -> Any:
    """MLflow's run that a model was trained in, or None where it was deleted."""
    try:
        run = store.client.get_run(run_id) if run_id else None
        return run if run and run.info.lifecycle_stage == "active" else None
    except MlflowException as error:
        if error.error_code == "RESOURCE_DOES_NOT_EXIST":
            return None
        raise
