"""Runs of experiments in MLflow: recorded with their table, and found again.

Runs are numbered, so that the newest is known whatever clocks said.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import islice
from pathlib import Path
from typing import Any

import pandas as pd

from pipeline.errors import InputError
from pipeline.progress import SILENT, Progress
from pipeline.scratch import scratch_folder
from registry.entities import EVALUATION_DATA, dataset_input, moment, own_tags, pages, recorded
from registry.environment import EVALUATED_BY, changed_since, environment_tags
from registry.run_files import FILES, TABLE, arrays_of, digest_tags, table_bytes, table_of
from registry.running import recorded_run
from registry.store import EVALUATION, Store, opened

LISTED = 5
"""Most runs that an error message names."""

SEQUENCE = "sequence"
"""Tag with a run's number among those of its experiment, from 1, with leading zeros."""

DIGITS = 9
LAST = 10**DIGITS - 1
"""Greatest number there is; runs that share one are ordered by their clocks."""

_NUMBER = re.compile(f"[0-9]{{{DIGITS}}}")

AT_ONCE = 20
"""Runs that are asked for at once; the newest are wanted most."""


@dataclass(frozen=True)
class Run:
    """A finished run of an experiment, without its files; tags say what it was made with."""

    experiment: str
    run_id: str
    created: datetime
    params: Mapping[str, str]
    tags: Mapping[str, str]


@dataclass(frozen=True)
class Done:
    """The MLflow run with an experiment's results, and whether it was there before."""

    run_id: str
    earlier: bool = False


def record(
    experiment: str,
    table: pd.DataFrame,
    *,
    params: Mapping[str, Any],
    files: Path | None = None,
    dataset: tuple[str, str] | None = None,
) -> str:
    """Record the results of an experiment and return the id of its run.

    Args:
        experiment: of EXPERIMENTS but TRAINING.
        table: a row for each trial.
        params: settings.
        files: a folder whose content becomes the run's artifacts ``files/``.
        dataset: folder and digest of the dataset whose test split was used.
    """
    name, content = experiment.removeprefix("prolearn-"), table_bytes(table)
    tags = environment_tags(EVALUATED_BY) | digest_tags(content, files)
    with opened() as store, scratch_folder() as scratch:
        (scratch / TABLE).parent.mkdir()
        (scratch / TABLE).write_bytes(content)
        tags[SEQUENCE] = _next_number(store, experiment)
        with recorded_run(store, experiment, name, tags) as run_id:
            store.log_params(run_id, params)
            if dataset is not None:
                store.client.log_inputs(run_id, [dataset_input(*dataset, EVALUATION_DATA)])
            store.client.log_artifacts(run_id, str(scratch))
            if files is not None:
                store.client.log_artifacts(run_id, str(files), FILES)
            return run_id


def earlier_run(
    experiment: str,
    params: Mapping[str, Any],
    kind: Sequence[str] = (),
    progress: Progress = SILENT,
) -> str | None:
    """The newest finished run of an experiment, where it had these parameters and versions.

    ``kind`` names the parameters that tell kinds of runs apart, of which the newest counts.
    ``progress`` is told where a run was made with other versions or is damaged.
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


def latest(experiment: str, having: Mapping[str, str] | None = None) -> Run | None:
    """The newest finished run of an experiment with some parameters, or None."""
    with opened(create=False) as store:
        return next(_finished(store, experiment, having), None)


def evaluation(run_id: str | None = None) -> Run:
    """An evaluation: the newest, or the one of a run.

    Raises:
        InputError: where there is none.
    """
    with opened(create=False) as store:
        every = _finished(store, EVALUATION)
        known = list(every) if run_id else [*islice(every, 1)]
    if run_id is None and not known:
        raise InputError(
            f"There is no finished run of {EVALUATION} in the tracking store; expected one: "
            "run `prolearn evaluate` first."
        )
    found = next((run for run in known if run_id in (None, run.run_id)), None)
    if found is None:
        there = ", ".join(run.run_id for run in known[:LISTED]) or "none"
        raise InputError(
            f"There is no finished evaluation {run_id!r}; expected the run of one, newest first: "
            f"{there}."
        )
    return found


def experiment_run(run_id: str) -> Run:
    """The run of an experiment, by its id."""
    with opened(create=False) as store:
        return _run_of(store, store.client.get_run(run_id))


def _finished(
    store: Store, experiment: str, having: Mapping[str, str] | None = None
) -> Iterator[Run]:
    """Finished runs with some parameters, the newest first.

    Runs without a number, of earlier versions, come after those that have one.
    """
    wanted, others = (having or {}).items(), []
    for found in _runs(store, experiment, filter_string="attributes.status = 'FINISHED'"):
        run = _run_of(store, found)
        if wanted <= run.params.items():
            if _number(found):
                yield run
            else:
                others.append((found.info.start_time, run))
    yield from (run for _, run in sorted(others, key=lambda one: one[0], reverse=True))


def _next_number(store: Store, experiment: str) -> str:
    """One more than the greatest number of the runs that are finished or being written."""
    counted = ("FINISHED", "RUNNING")
    numbers = (_number(r) for r in _runs(store, experiment) if r.info.status in counted)
    return f"{min(next(filter(None, numbers), 0) + 1, LAST):0{DIGITS}}"


def _run_of(store: Store, run: Any) -> Run:
    names = {number: name for name, number in store.experiments.items()}
    return Run(
        experiment=names[run.info.experiment_id],
        run_id=run.info.run_id,
        created=moment(run.info.start_time),
        params=recorded(run.data.params),
        tags=own_tags(run.data.tags),
    )


def _runs(store: Store, experiment: str, **query: Any) -> Iterator[Any]:
    """MLflow's runs: those with a number by that, the greatest first; others are anywhere."""
    return pages(
        store.client.search_runs,
        experiment_ids=[store.experiments[experiment]],
        order_by=[f"tags.`{SEQUENCE}` DESC", "attributes.start_time DESC"],
        max_results=AT_ONCE,
        **query,
    )


def _number(run: Any) -> int:
    """A run's number; 0 where it has none."""
    text = run.data.tags.get(SEQUENCE, "")
    return int(text) if _NUMBER.fullmatch(text) else 0
