"""Runs that are being written, and how they are closed where their process was killed.

A process that writes runs holds a lock file, whose token is in a tag of each run. Whoever opens
the store next and finds a lock file that nobody holds closes the runs with its tag.
"""

import platform
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

import mlflow
from mlflow.exceptions import MlflowException
from sqlalchemy.exc import SQLAlchemyError

from pipeline.scratch import TOKEN, clear_dead, held_lock_file
from registry.entities import pages

if TYPE_CHECKING:
    from registry.store import Store

WRITER = "writer."  # prefix of the tag that has the token of a process that writes a run

FAILURES = (MlflowException, SQLAlchemyError, OSError, ImportError)
"""What MLflow raises where a store fails, or its files are where it cannot reach them."""


@contextmanager
def recorded_run(
    store: "Store", experiment: str, name: str, tags: Mapping[str, str], *, again: str | None = None
) -> Iterator[str]:
    """An MLflow run, new or of the id ``again``: FINISHED after the block, or FAILED."""
    folder, prefix = store.locks
    with held_lock_file(folder, prefix, keep_on_error=True) as process:
        key = f"{WRITER}{process[-TOKEN:]}"
        with mlflow.start_run(
            run_id=again,
            experiment_id=store.experiments[experiment],
            run_name=name,
            tags={**tags, key: platform.node() or "unknown"},
            nested=True,
            log_system_metrics=False,
        ) as run:
            yield run.info.run_id
        with suppress(*FAILURES):  # a tag that stays does no harm
            store.client.delete_tag(run.info.run_id, key)


def close_abandoned(store: "Store") -> None:
    """Mark as KILLED, where possible, runs that dead processes of this machine were writing."""
    with suppress(*FAILURES):
        clear_dead(*store.locks, lambda name: _close(store.client, name))


def _close(client: Any, name: str) -> None:
    """Close the runs that the dead holder of a lock file was writing, and that nobody else is."""
    key = f"{WRITER}{name[-TOKEN:]}"
    experiments = [found.experiment_id for found in pages(client.search_experiments)]
    query = {"experiment_ids": experiments, "filter_string": f"tags.`{key}` LIKE '%'"}
    for run in list(pages(client.search_runs, **query)):
        writers = [tag for tag in run.data.tags if tag.startswith(WRITER)]
        if run.info.status == "RUNNING" and writers == [key]:
            client.set_terminated(run.info.run_id, "KILLED")
        client.delete_tag(run.info.run_id, key)
