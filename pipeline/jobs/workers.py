"""Work on shards by several processes, on this machine or on a Dask cluster.

Workers are given values and give values back: they touch no file, so that a killed one leaves
nothing behind, a cluster needs no shared disk, and only the process that holds the folder writes.
"""

from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import AbstractContextManager, closing
from dataclasses import dataclass
from functools import partial
from math import inf
from typing import TypeVar

import joblib
from threadpoolctl import threadpool_limits

from pipeline.errors import InputError, ProlearnError
from pipeline.jobs.cluster import cluster
from pipeline.jobs.processes import processes
from pipeline.jobs.spread import Pool, WorkersLostError, spread
from pipeline.jobs.worker import work
from pipeline.progress import SILENT, Progress

MOST_LOSSES = 3
"""Times in a row that workers may be lost before a single shard is done."""

SCHEDULER_WAIT = 300.0
"""Seconds in which a scheduler that was lost may come back, unless a person says otherwise."""

Task = TypeVar("Task")
Content = TypeVar("Content")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Workers:
    """Where shards are worked on.

    Attributes:
        jobs: processes on this machine; -1 for one a core. A cluster uses all that it has.
        scheduler: address of a Dask cluster's scheduler, such as tcp://10.0.0.1:8786, or None for
            this machine.
        scheduler_wait: seconds in which a scheduler that was lost may come back.
    """

    jobs: int = -1
    scheduler: str | None = None
    scheduler_wait: float = SCHEDULER_WAIT

    def __post_init__(self) -> None:
        """Refuse what nothing can be run on."""
        if self.jobs == 0:
            raise InputError("jobs is 0; expected a number of processes, or -1 for all cores.")
        if not 0 <= self.scheduler_wait < inf:
            raise InputError(
                f"the wait for a lost scheduler is {self.scheduler_wait:g}; expected seconds, 0 or "
                "more."
            )

    def work(
        self,
        function: Callable[[Task, Content], Result],
        tasks: Sequence[Task],
        load: Callable[[Task], Content],
        progress: Progress = SILENT,
    ) -> Generator[tuple[Task, Result], None, None]:
        """Each task with its result, as they are done, in any order.

        What a killed worker or a lost scheduler had in hand is done again.

        Args:
            function: what to do, importable on every worker.
            tasks: what to do it with.
            load: what else a task needs, read here when its turn comes; pickled for the worker.
            progress: told of what is lost.

        Raises:
            ProlearnError: where workers are killed again and again, none can be had, or a lost
                scheduler does not come back.
        """
        waiting, losses, again = dict(enumerate(tasks)), 0, False
        while waiting:
            try:
                with closing(self._once(function, dict(waiting), load, again, progress)) as results:
                    for number, result in results:
                        losses = 0
                        yield waiting.pop(number), result
            except WorkersLostError as lost:
                losses, again = losses + 1, True
                if losses == MOST_LOSSES:
                    raise ProlearnError(lost.again) from lost
                progress.say(str(lost))

    def _once(
        self,
        function: Callable[[Task, Content], Result],
        tasks: Mapping[int, Task],
        load: Callable[[Task], Content],
        again: bool,
        progress: Progress,
    ) -> Generator[tuple[int, Result], None, None]:
        """Results by the tasks' numbers, until all are there or workers are lost."""
        pool: AbstractContextManager[Pool]
        if self.scheduler:
            pool = cluster(self.scheduler, self.scheduler_wait, again, progress)
        elif (jobs := joblib.effective_n_jobs(self.jobs)) > 1:
            pool = processes(jobs)
        else:
            with threadpool_limits(1):
                for number, task in tasks.items():
                    yield number, function(task, load(task))
            return
        calls = (
            (number, partial(work, function, task, load(task))) for number, task in tasks.items()
        )
        with pool as workers:
            yield from spread(workers, calls)
