"""Results of experiments: recorded as MLflow runs with their table, and fetched again."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, SupportsFloat

import mlflow
import pandas as pd

from pipeline.errors import InputError
from pipeline.progress import SILENT, Progress
from pipeline.scratch import scratch_folder
from registry.entries import log_metrics, log_params, metrics_now, recorded
from registry.environment import EVALUATED_BY, changed_since, environment_tags
from registry.running import recorded_run
from registry.store import EVALUATION, Store, opened
from registry.story import EVALUATION_DATA, dataset_input
from registry.version import ModelVersion, moment

TABLE = "table.parquet"
"""A run's table, in its artifacts ``tables/``."""

SHOWN = 5
"""Runs that a refusal names."""


@dataclass(frozen=True, eq=False)
class Run:
    """A finished run of an experiment.

    Attributes:
        run_id: its MLflow run.
        created: when it started.
        table: a row for each trial.
        params: parameters of the run.
        tags: what it was made with, such as ``git_commit``.
    """

    run_id: str
    created: datetime
    table: pd.DataFrame
    params: Mapping[str, str]
    tags: Mapping[str, str]


@dataclass(frozen=True)
class Done:
    """What came of an experiment.

    Attributes:
        run_id: its MLflow run.
        earlier: whether that run had been there before.
    """

    run_id: str
    earlier: bool = False


def earlier_run(
    experiment: str,
    params: Mapping[str, Any],
    kind: Sequence[str] = (),
    progress: Progress = SILENT,
) -> str | None:
    """The newest finished run of an experiment, where it had these parameters and versions.

    Args:
        experiment: of EXPERIMENTS but TRAINING.
        params: settings.
        kind: those of the settings that tell kinds of runs apart: the newest run of the same kind
            is looked at.
        progress: told where it had these parameters and other versions, and so does not count.

    Raises:
        ProlearnError: where the store fails.
    """
    wanted = recorded(params)
    with opened(create=False) as store:
        run = _newest(store, experiment, {name: wanted[name] for name in kind})
    if run is None or run.data.params != wanted:
        return None
    change = changed_since(run.data.tags, EVALUATED_BY)
    if change:
        progress.say(
            f"run {run.info.run_id} of {experiment} was made with {change}; it is done again."
        )
    return None if change else str(run.info.run_id)


def record(
    experiment: str,
    table: pd.DataFrame,
    *,
    params: Mapping[str, Any],
    files: Path | None = None,
    dataset: tuple[str, str] | None = None,
) -> str:
    """Record what came of an experiment and return the id of its run.

    Args:
        experiment: of EXPERIMENTS but TRAINING.
        table: a row for each trial.
        params: settings.
        files: a folder whose content becomes the run's artifacts ``files/``.
        dataset: folder and digest of the dataset whose test split was used.

    Raises:
        ProlearnError: where the store fails.
    """
    name = experiment.removeprefix("prolearn-")
    with (
        opened() as store,
        recorded_run(store, experiment, name, environment_tags(EVALUATED_BY)) as run_id,
        scratch_folder() as scratch,
    ):
        log_params(store, run_id, params)
        if dataset is not None:
            store.client.log_inputs(run_id, [dataset_input(*dataset, EVALUATION_DATA)])
        table.to_parquet(scratch / TABLE, index=False)
        store.client.log_artifacts(run_id, str(scratch), "tables")
        if files is not None:
            store.client.log_artifacts(run_id, str(files), "files")
        return run_id


def latest(experiment: str, having: Mapping[str, str] | None = None) -> Run | None:
    """The newest finished run of an experiment, or None.

    Args:
        experiment: of EXPERIMENTS but TRAINING.
        having: parameters that the run must have, such as the optimizer of WARMSTART.

    Raises:
        ProlearnError: where the store fails.
    """
    with opened(create=False) as store:
        run = _newest(store, experiment, having or {})
        return None if run is None else _read(store, run)


def evaluation(run_id: str | None = None) -> Run:
    """An evaluation: the newest, or the one of a run.

    Raises:
        InputError: where there is none.
        ProlearnError: where the store fails.
    """
    if run_id is None:
        if (found := latest(EVALUATION)) is None:
            raise InputError(
                f"There is no finished run of {EVALUATION} in the tracking store; expected one: "
                "run `prolearn evaluate` first."
            )
        return found
    with opened(create=False) as store:
        known = _finished(store, EVALUATION, {}, most=1000)
        for run in known:
            if run.info.run_id == run_id:
                return _read(store, run)
    there = ", ".join(run.info.run_id for run in known[:SHOWN]) or "none"
    raise InputError(
        f"There is no finished evaluation {run_id!r}; expected the run of one, newest first: "
        f"{there}."
    )


def table_of(run_id: str) -> tuple[str, pd.DataFrame]:
    """The experiment that a run is of, and the run's table: a row for each trial.

    Raises:
        ProlearnError: where the store fails.
    """
    with opened(create=False) as store:
        run = store.client.get_run(run_id)
        names = {number: name for name, number in store.experiments.items()}
        return names[run.info.experiment_id], _read(store, run).table


def _read(store: Store, run: Any) -> Run:
    """A run with its table."""
    with scratch_folder() as scratch:
        folder = Path(_download(store, run.info.run_id, "tables", scratch))
        table = pd.read_parquet(folder / TABLE)
    return Run(
        run_id=run.info.run_id,
        created=moment(run.info.start_time),
        table=table,
        params=recorded(run.data.params),
        tags={k: v for k, v in run.data.tags.items() if "mlflow." not in k},
    )


def fetch_files(run: Run, folder: Path) -> Path:
    """Download the files recorded with a run into a folder, and return where they are.

    Raises:
        ProlearnError: where the store fails, or the run has none.
    """
    with opened(create=False) as store:
        return Path(_download(store, run.run_id, "files", folder))


def add_model_results(
    version: ModelVersion,
    metrics: Mapping[int, Mapping[str, SupportsFloat]],
    figures: Path,
    *,
    dataset: tuple[str, str],
) -> None:
    """Add an evaluation to a model's own training run.

    Args:
        version: the model.
        metrics: by step, then by name.
        figures: a folder whose content becomes the run's artifacts ``figures/``.
        dataset: folder and digest of the dataset that it was evaluated on.

    Raises:
        ProlearnError: where the store fails.
    """
    with opened(create=False) as store:
        model = version.model_id or None
        entities = [m for k, values in metrics.items() for m in metrics_now(values, model, k)]
        log_metrics(store, version.run_id, entities)
        used = dataset_input(*dataset, EVALUATION_DATA)
        store.client.log_inputs(version.run_id, [used])
        store.client.log_artifacts(version.run_id, str(figures), "figures")


def model_metric_by_size(version: ModelVersion, name: str) -> dict[int, float]:
    """A metric of experiment 2 in a model's own run, by swarm size; empty where there is none.

    Raises:
        ProlearnError: where the store fails.
    """
    with opened(create=False) as store:
        history = store.client.get_metric_history(version.run_id, name)
    return {m.step: m.value for m in sorted(history, key=lambda m: m.timestamp)}


def _newest(store: Store, experiment: str, having: Mapping[str, str]) -> Any:
    """The newest finished run with some parameters, or None."""
    return next(iter(_finished(store, experiment, having, most=1)), None)


def _finished(store: Store, experiment: str, having: Mapping[str, str], most: int) -> list[Any]:
    """Finished runs with some parameters, the newest first."""
    asked = ["attributes.status = 'FINISHED'", *(f"params.`{k}` = '{having[k]}'" for k in having)]
    return list(
        store.client.search_runs(
            [store.experiments[experiment]],
            filter_string=" AND ".join(asked),
            order_by=["attributes.start_time DESC"],
            max_results=most,
        )
    )


def _download(store: Store, run_id: str, path: str, folder: Path) -> str:
    folder.mkdir(parents=True, exist_ok=True)
    return str(
        mlflow.artifacts.download_artifacts(
            run_id=run_id, artifact_path=path, dst_path=str(folder), tracking_uri=store.uri
        )
    )
