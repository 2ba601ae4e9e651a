"""A training as an MLflow run, and the network it gave as a registered model version."""

import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, SupportsFloat

import mlflow
import numpy as np
import pandas as pd
from mlflow.exceptions import MlflowException

from pipeline.errors import ProlearnError
from pipeline.experiments.trainings import curves_figure
from pipeline.figures.style import save as save_figure
from pipeline.figures.style import styles
from pipeline.networks.model import Model, save
from pipeline.networks.model import load as load_network
from pipeline.networks.recipes import Recipe
from pipeline.networks.refiner.ablations import for_comparison
from pipeline.scenario import draw
from pipeline.scratch import scratch_folder, temporary_files_in
from pipeline.training.loop import Trained
from registry.entries import log_metrics, log_params, metrics_now
from registry.environment import TRAINED_BY, environment_tags, requirements
from registry.flavor import SIGNATURE
from registry.running import recorded_run
from registry.store import TRAINING, Store, opened
from registry.story import (
    CURVES,
    TRAINING_DATA,
    DatasetInfo,
    Story,
    curve_metrics,
    dataset_input,
    read_story,
    story_of,
)
from registry.unregistered import STORY, keep, parameter_count, weights_kib
from registry.version import CHAMPION, PREFIX, ModelVersion, read_version

__all__ = ["DatasetInfo", "record_training", "register_kept"]


def record_training(
    trained: Trained,
    *,
    recipe: Recipe,
    seed: int,
    dataset: DatasetInfo,
    params: Mapping[str, Any] | None = None,
    metrics: Mapping[str, SupportsFloat] | None = None,
) -> ModelVersion:
    """Record a training in MLflow and register its network as ``prolearn-<arch>``.

    The first version of a model becomes its champion, but for recipes that are there to be
    compared with.

    Args:
        trained: what the training gave.
        recipe: its recipe; each field becomes a parameter.
        seed: its seed.
        dataset: what it was trained on.
        params: further settings.
        metrics: further metrics, such as ``valid_position_rmse`` in m.

    Raises:
        ProlearnError: where the store fails; the network is then kept in ``unregistered/``, which
            the message names.
    """
    story = story_of(
        trained,
        recipe=recipe,
        seed=seed,
        dataset=dataset,
        metrics=metrics or {},
        tags=environment_tags(TRAINED_BY),
    )
    with scratch_folder() as scratch:
        folder = scratch / "network"
        save(trained.model, folder)
        story = replace(
            story,
            params={**story.params, "parameters": parameter_count(folder), **(params or {})},
            metrics={**story.metrics, "weights_kib": weights_kib(folder)},
        )
        try:
            return _record(folder, trained.model, story)
        except ProlearnError as error:
            kept = keep(folder, trained.model.architecture, vars(story))
            raise ProlearnError(
                f"{error} The trained network is kept in {kept}; register it later with "
                f"`prolearn models register {kept}`."
            ) from error


def register_kept(folder: Path) -> ModelVersion:
    """Record and register a network that was kept because the store had failed.

    Raises:
        InputError: where the folder holds no sound network and story.
        ProlearnError: where the store fails again; the folder stays as it is.
    """
    story = read_story(folder / STORY)
    model = load_network(folder)
    with scratch_folder() as scratch:
        network = scratch / "network"
        shutil.copytree(folder, network, ignore=shutil.ignore_patterns(STORY))
        return _record(network, model, story)


def _record(folder: Path, model: Model, story: Story) -> ModelVersion:
    """Record and register what was saved in a folder inside a temporary one."""
    arch, params = model.architecture, story.params
    with opened() as store:
        name = f"{arch}-{params['recipe']}"
        with recorded_run(store, TRAINING, name, story.tags) as run_id:
            facts = {k: params[k] for k in ("train_instances", "valid_instances")}
            used = (params["dataset"], params["dataset_digest"], TRAINING_DATA, facts)
            store.client.log_inputs(run_id, [dataset_input(*used)])
            log_params(store, run_id, params)
            log_metrics(store, run_id, curve_metrics(story.history))
            with temporary_files_in(folder.parent):
                _log_curves(store, run_id, story)
                model_id = _log_model(folder, model)
            log_metrics(store, run_id, metrics_now(story.metrics, model_id))
            tags = {k: str(params[k]) for k in ("arch", "recipe", "dataset_digest")}
            found = _register(store, PREFIX + arch, run_id, model_id, tags)
        aliases = store.client.get_registered_model(found.name).aliases
        if CHAMPION not in aliases and not for_comparison(arch, str(params["recipe"])):
            store.client.set_registered_model_alias(found.name, CHAMPION, str(found.version))
        return read_version(store, found)


def _log_curves(store: Store, run_id: str, story: Story) -> None:
    """Learning curves as numbers and as a figure."""
    store.client.log_dict(run_id, dict(story.history), "learning_curve.json")
    arch = str(story.params["arch"])
    columns = {name: story.history[name] for name in CURVES}
    curves = pd.DataFrame({"epoch": story.history["number"], **columns})
    figure = curves_figure(
        curves.assign(arch=arch, recipe=story.params["recipe"], training_seed=story.params["seed"]),
        styles([arch]),
    )
    with scratch_folder() as scratch:
        save_figure(figure, scratch / "learning_curve", [".png"])
        store.client.log_artifacts(run_id, str(scratch), "figures")


def _log_model(folder: Path, model: Model) -> str:
    """Id of the model, logged into the run that is active."""
    example = draw("rings", seed=0, n=2, index=0, problem=model.problem)
    info = mlflow.pyfunc.log_model(
        name="model",
        loader_module="registry.flavor",
        data_path=str(folder),
        signature=SIGNATURE,
        input_example={
            "initial": np.asarray(example.initial[None]),
            "goal": np.asarray(example.goal[None]),
        },
        pip_requirements=requirements(model.architecture),
    )
    return str(info.model_id)


def _register(store: Store, name: str, run_id: str, model_id: str, tags: Mapping[str, str]) -> Any:
    """MLflow's new version of a registered model, which is made where it is missing."""
    try:
        store.client.create_registered_model(name)
    except MlflowException as error:
        if error.error_code != "RESOURCE_ALREADY_EXISTS":
            raise
    return store.client.create_model_version(
        name, f"models:/{model_id}", run_id, tags={**tags, "model_id": model_id}, model_id=model_id
    )
