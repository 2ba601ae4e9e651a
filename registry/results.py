"""Results of experiments: recorded as MLflow runs with their table, and fetched again."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import pandas as pd

from pipeline.errors import InputError
from pipeline.progress import SILENT, Progress
from pipeline.scratch import scratch_folder
from registry.artifacts import FILES, TABLE, digest_tags, fetch_arrays, read_table
from registry.entries import log_params, recorded
from registry.environment import EVALUATED_BY, changed_since, environment_tags
from registry.running import recorded_run
from registry.runs import SEQUENCE, Run, finished, next_number, run_of
from registry.store import EVALUATION, opened
from registry.story import EVALUATION_DATA, dataset_input
from registry.table_file import table_bytes

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
        progress: told where it had these parameters and does not count all the same, since it was
            made with other versions or is damaged.

    Raises:
        ProlearnError: where the store fails.
    """
    wanted = recorded(params)
    run = latest(experiment, {name: wanted[name] for name in kind})
    if run is None or run.params != wanted:
        return None
    if change := changed_since(run.tags, EVALUATED_BY):
        progress.say(f"run {run.run_id} of {experiment} was made with {change}; it is done again.")
        return None
    try:
        table_of(run)
        with arrays_of(run):
            return run.run_id
    except InputError as error:
        progress.say(f"{error} It is done again.")
        return None


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
    name, content = experiment.removeprefix("prolearn-"), table_bytes(table)
    tags = environment_tags(EVALUATED_BY) | digest_tags(content, files)
    with opened() as store, scratch_folder() as scratch:
        (scratch / TABLE).parent.mkdir()
        (scratch / TABLE).write_bytes(content)
        tags[SEQUENCE] = next_number(store, experiment)
        with recorded_run(store, experiment, name, tags) as run_id:
            log_params(store, run_id, params)
            if dataset is not None:
                store.client.log_inputs(run_id, [dataset_input(*dataset, EVALUATION_DATA)])
            store.client.log_artifacts(run_id, str(scratch))
            if files is not None:
                store.client.log_artifacts(run_id, str(files), FILES)
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
        return next(finished(store, experiment, having), None)


def evaluation(run_id: str | None = None) -> Run:
    """An evaluation: the newest, or the one of a run.

    Raises:
        InputError: where there is none.
        ProlearnError: where the store fails.
    """
    with opened(create=False) as store:
        every = finished(store, EVALUATION)
        known = list(every) if run_id else [*islice(every, 1)]
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
        InputError: where its file is damaged, no table, or too large.
        ProlearnError: where it cannot be fetched.
    """
    with opened(create=False) as store, scratch_folder() as scratch:
        return read_table(store, run, scratch)


@contextmanager
def arrays_of(run: Run) -> Iterator[list[Path]]:
    """The files recorded with a run that hold arrays, for as long as the block lasts.

    Raises:
        InputError: where one is damaged.
        ProlearnError: where one cannot be fetched.
    """
    with scratch_folder() as scratch:
        with opened(create=False) as store:
            found = fetch_arrays(store, run, scratch)
        yield found
