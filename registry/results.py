"""Results of experiments: recorded as MLflow runs with their table, and fetched again."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mlflow
import pandas as pd

from pipeline.errors import InputError
from pipeline.progress import SILENT, Progress
from pipeline.scratch import scratch_folder
from registry.entries import log_params, recorded
from registry.environment import EVALUATED_BY, changed_since, environment_tags
from registry.running import recorded_run
from registry.runs import SEQUENCE, Run, finished, next_number, run_of
from registry.store import EVALUATION, Store, opened
from registry.story import EVALUATION_DATA, dataset_input

TABLE = "table.parquet"
"""A run's table, in its artifacts ``tables/``."""

SHOWN = 5
"""Runs that a refusal names."""


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
    run = latest(experiment, {name: wanted[name] for name in kind})
    if run is None or run.params != wanted:
        return None
    change = changed_since(run.tags, EVALUATED_BY)
    if change:
        progress.say(f"run {run.run_id} of {experiment} was made with {change}; it is done again.")
    return None if change else run.run_id


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
    with opened() as store, scratch_folder() as scratch:
        table.to_parquet(scratch / TABLE, index=False)
        tags = {SEQUENCE: str(next_number(store, experiment)), **environment_tags(EVALUATED_BY)}
        with recorded_run(store, experiment, name, tags) as run_id:
            log_params(store, run_id, params)
            if dataset is not None:
                store.client.log_inputs(run_id, [dataset_input(*dataset, EVALUATION_DATA)])
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
        return next(iter(finished(store, experiment, having)), None)


def evaluation(run_id: str | None = None) -> Run:
    """An evaluation: the newest, or the one of a run.

    Raises:
        InputError: where there is none.
        ProlearnError: where the store fails.
    """
    with opened(create=False) as store:
        known = finished(store, EVALUATION)
    if run_id is None and not known:
        raise InputError(
            f"There is no finished run of {EVALUATION} in the tracking store; expected one: "
            "run `prolearn evaluate` first."
        )
    found = next((run for run in known if run_id in (None, run.run_id)), None)
    if found is None:
        there = ", ".join(run.run_id for run in known[:SHOWN]) or "none"
        raise InputError(
            f"There is no finished evaluation {run_id!r}; expected the run of one, newest first: "
            f"{there}."
        )
    return found


def experiment_run(run_id: str) -> Run:
    """The run of an experiment, by its id.

    Raises:
        ProlearnError: where the store fails.
    """
    with opened(create=False) as store:
        return run_of(store, store.client.get_run(run_id))


def table_of(run: Run) -> pd.DataFrame:
    """A run's table: a row for each trial.

    Raises:
        ProlearnError: where the store fails.
    """
    with opened(create=False) as store, scratch_folder() as scratch:
        folder = Path(_download(store, run.run_id, "tables", scratch))
        return pd.read_parquet(folder / TABLE)


def fetch_files(run: Run, folder: Path) -> Path:
    """Download the files recorded with a run into a folder, and return where they are.

    Raises:
        ProlearnError: where the store fails, or the run has none.
    """
    with opened(create=False) as store:
        return Path(_download(store, run.run_id, "files", folder))


def _download(store: Store, run_id: str, path: str, folder: Path) -> str:
    folder.mkdir(parents=True, exist_ok=True)
    return str(
        mlflow.artifacts.download_artifacts(
            run_id=run_id, artifact_path=path, dst_path=str(folder), tracking_uri=store.uri
        )
    )
