"""The parts of an experiment: tables made by workers, each for itself."""

from collections.abc import Callable, Sequence
from contextlib import closing
from functools import partial
from typing import Protocol, TypeVar, runtime_checkable

import pandas as pd

from pipeline.parallel.workers import Workers
from pipeline.progress import Progress


@runtime_checkable
class Part(Protocol):
    """A task for a worker: what a table is made of."""

    @property
    def n(self) -> int:
        """Spacecraft of its swarms."""

    @property
    def note(self) -> str:
        """What progress is told when it is done."""


Task = TypeVar("Task", bound=Part)


def done_parts(
    make: Callable[[Task], pd.DataFrame],
    parts: Sequence[Task],
    *,
    workers: Workers | None,
    progress: Progress,
) -> list[pd.DataFrame]:
    """The table of each part, by default made on all cores of this machine."""
    # Large swarms take longest: begun last, one would keep a worker when the others are done.
    tasks = sorted(enumerate(parts), key=lambda task: -task[1].n)
    tables: dict[int, pd.DataFrame] = {}
    progress.expect(len(parts))
    made = (workers or Workers()).work(partial(_made, make), tasks, lambda _: b"", progress)
    with closing(made) as results:
        for (number, part), table in results:
            tables[number] = table
            progress.done(note=part.note)
    return [tables[number] for number in range(len(parts))]


def _made(make: Callable[[Task], pd.DataFrame], task: tuple[int, Task], _: bytes) -> pd.DataFrame:
    """In a worker: the table of a part."""
    return make(task[1])
