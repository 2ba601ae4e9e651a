"""What happens in a worker: one call with bytes, and its result or error as a value."""

import functools
import os
import threading
import time
from collections.abc import Callable, Mapping
from typing import TypeVar

from threadpoolctl import threadpool_limits

from pipeline.errors import ProlearnError
from pipeline.provenance import DecidedBy, made_with, version_change

PARENT_SECONDS = 1.0
"""How often a worker looks whether its parent is still there."""

Task = TypeVar("Task")
Content = TypeVar("Content")
Result = TypeVar("Result")


def loaded(load: Callable[[Task], Content], task: Task) -> Content | ProlearnError:
    """What a task needs; joblib asks for it in a thread where an error would go unnoticed."""
    try:
        return load(task)
    except (ProlearnError, OSError) as error:
        return ProlearnError(str(error))


def work(
    function: Callable[[Task, Content], Result],
    number: int,
    task: Task,
    content: Content | ProlearnError,
    parent: int | None,
) -> tuple[int, Result | ProlearnError]:
    """In a worker: errors come back as values, since not all backends bring them safely."""
    if isinstance(content, ProlearnError):
        return number, content
    _prepare(parent)
    try:
        return number, function(task, content)
    except ProlearnError as error:
        return number, error


@functools.cache
def _prepare(parent: int | None) -> None:
    """Once in each worker: one thread for linear algebra, so that sums do not depend on where.

    A worker of this machine ends with its parent, even where that is killed and cannot tell it.
    """
    threadpool_limits(1)
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(PARENT_SECONDS)
    os._exit(1)


def check_worker(expected: Mapping[str, str], decided_by: DecidedBy) -> None:
    """Refuse to work on a shard with other versions than the process that asked for it has.

    Raises:
        ProlearnError: naming the first version that differs.
    """
    change = version_change(expected, made_with(*decided_by))
    if change:
        raise ProlearnError(
            f"the dataset is made with {change} on a worker; expected the same versions on all "
            "machines: install them there and run the same command again."
        )
