"""Work on shards by several processes, on this machine or on a Dask cluster.

Workers are given values and give values back: they touch no file, so that a killed one leaves
nothing behind, a cluster needs no shared disk, and only the process that holds the folder writes.
"""

from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

import joblib
from threadpoolctl import threadpool_limits

from pipeline.errors import InputError, ProlearnError, check_range
from pipeline.jobs.cluster import cluster
from pipeline.jobs.lost import WorkersLostError
from pipeline.jobs.processes import by_processes
from pipeline.jobs.worker import work
from pipeline.progress import SILENT, Progress

MOST_LOSSES = 3
"""Times in a row that workers may be lost before a single shard is done."""

MOST_JOBS = 1024
"""Processes on this machine."""

SCHEDULER_WAIT = 300.0
"""Seconds in which a scheduler that was lost may come back, unless a person says otherwise."""

MOST_WAIT = 1e7
"""Longest such wait, s: four months."""

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
        if self.jobs == 0 or not -MOST_JOBS <= self.jobs <= MOST_JOBS:
            raise InputError(
                f"jobs is {self.jobs}; expected a number of processes up to {MOST_JOBS}, or -1 for "
                "all cores."
            )
        check_range("the wait for a lost scheduler", self.scheduler_wait, 0, MOST_WAIT)

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
        jobs = joblib.effective_n_jobs(self.jobs)
        if self.scheduler is None and jobs == 1:
            with threadpool_limits(1):
                for number, task in tasks.items():
                    yield number, function(task, load(task))
            return
        calls = (
            partial(work, function, number, task, _loaded(load, task))
            for number, task in tasks.items()
        )
        if self.scheduler is None:
            yield from by_processes(calls, jobs)
            return
        with cluster(self.scheduler, self.scheduler_wait, again, progress) as workers:
            yield from workers.results(calls)


def _loaded(load: Callable[[Task], Content], task: Task) -> Content | Exception:
    """What a task needs; joblib asks for it in a thread where an error would go unnoticed."""
    try:
        return load(task)
    except Exception as error:
        return error
