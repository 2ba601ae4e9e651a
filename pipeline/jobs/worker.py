"""What happens in a worker: one call, on one thread."""

import functools
from collections.abc import Callable, Mapping
from typing import TypeVar

from threadpoolctl import threadpool_limits

from pipeline.errors import ProlearnError
from pipeline.provenance import DecidedBy, made_with, version_change

Task = TypeVar("Task")
Content = TypeVar("Content")
Result = TypeVar("Result")


def work(
    function: Callable[[Task, Content], Result],
    number: int,
    task: Task,
    content: Content | Exception,
) -> tuple[int, Result]:
    """Call a function with a task and its content; a fault in loading that is raised here."""
    if isinstance(content, Exception):
        raise content
    _use_one_thread()
    return number, function(task, content)


@functools.cache
def _use_one_thread() -> None:
    """One thread for linear algebra, so that sums do not depend on where they are made."""
    threadpool_limits(1)


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
