"""Runs of experiments, in the order in which they were recorded, whatever clocks said."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from registry.entries import recorded
from registry.paging import pages
from registry.store import Store
from registry.values import moment, whole

SEQUENCE = "sequence"
"""Tag with a run's number among those of its experiment, from 1."""

LAST = 10**15 - 1
"""Greatest number that counts; runs that share one are ordered by their clocks."""


@dataclass(frozen=True)
class Run:
    """A finished run of an experiment, without its files.

    Attributes:
        experiment: its name.
        run_id: its MLflow run.
        created: when it started.
        params: parameters of the run.
        tags: what it was made with, such as ``git_commit``.
    """

    experiment: str
    run_id: str
    created: datetime
    params: Mapping[str, str]
    tags: Mapping[str, str]


def finished(store: Store, experiment: str, having: Mapping[str, str] | None = None) -> list[Run]:
    """Finished runs with some parameters, the newest first.

    Runs without a number, of earlier versions, come after those that have one.
    """
    wanted = (having or {}).items()
    found = [run for run in _runs(store, experiment) if run.info.status == "FINISHED"]
    found.sort(key=lambda run: (_number(run), run.info.start_time or 0), reverse=True)
    values = [run_of(store, run) for run in found]
    return [run for run in values if wanted <= run.params.items()]


def next_number(store: Store, experiment: str) -> int:
    """One more than the largest number of the runs that are finished or being written."""
    counted = ("FINISHED", "RUNNING")
    numbers = [_number(r) for r in _runs(store, experiment) if r.info.status in counted]
    return min(max(numbers, default=0) + 1, LAST)


def run_of(store: Store, run: Any) -> Run:
    """The value of one of MLflow's runs of an experiment."""
    names = {number: name for name, number in store.experiments.items()}
    return Run(
        experiment=names[run.info.experiment_id],
        run_id=run.info.run_id,
        created=moment(run.info.start_time),
        params=recorded(run.data.params),
        tags={k: v for k, v in run.data.tags.items() if "mlflow." not in k},
    )


def _runs(store: Store, experiment: str) -> list[Any]:
    return list(pages(store.client.search_runs, experiment_ids=[store.experiments[experiment]]))


def _number(run: Any) -> int:
    return max(whole(run.data.tags.get(SEQUENCE, "")) or 0, 0)
