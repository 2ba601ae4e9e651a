"""Runs of experiments, in the order in which they were recorded, whatever clocks said."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from registry.entries import recorded
from registry.paging import pages
from registry.store import Store
from registry.values import moment

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


def finished(
    store: Store, experiment: str, having: Mapping[str, str] | None = None
) -> Iterator[Run]:
    """Finished runs with some parameters, the newest first.

    Runs without a number, of earlier versions, come after those that have one.
    """
    wanted, others = (having or {}).items(), []
    for found in _runs(store, experiment, filter_string="attributes.status = 'FINISHED'"):
        run = run_of(store, found)
        if wanted <= run.params.items():
            if _number(found):
                yield run
            else:
                others.append((found.info.start_time, run))
    yield from (run for _, run in sorted(others, key=lambda one: one[0], reverse=True))


def next_number(store: Store, experiment: str) -> str:
    """One more than the greatest number of the runs that are finished or being written."""
    counted = ("FINISHED", "RUNNING")
    numbers = (_number(r) for r in _runs(store, experiment) if r.info.status in counted)
    return f"{min(next(filter(None, numbers), 0) + 1, LAST):0{DIGITS}}"


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


def _runs(store: Store, experiment: str, **query: Any) -> Iterator[Any]:
    """Runs of MLflow, those with a number by that, the greatest first; others are anywhere."""
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
