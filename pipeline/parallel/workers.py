"""Tasks done by several processes, on this machine or on a Dask cluster.

Workers get values and return values: they touch no file, so that a killed one leaves nothing
behind, a cluster needs no shared disk, and only the process that holds the folder writes.
Where they share its storage (``Workers.shared``), they read and write shards themselves
(pipeline/storage/shared.py), since one process cannot carry the bytes of hundreds.
"""

import functools
import sys
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError
from typing import TypeVar

import joblib
from threadpoolctl import ThreadpoolController, threadpool_limits

from pipeline.errors import InputError, ProlearnError, check_range
from pipeline.parallel.cluster import cluster
from pipeline.parallel.processes import WorkersLostError, run_in_processes
from pipeline.progress import SILENT, Progress
from pipeline.provenance import DecidedBy, made_with, version_change

MOST_LOSSES = 3  # losses of workers in a row, without a task done, that end the work
MOST_JOBS = 1024  # processes on this machine
SCHEDULER_WAIT = 300.0  # s in which a lost scheduler may come back, unless said otherwise
MOST_WAIT = 1e7  # longest such wait, s: four months

Task = TypeVar("Task")
Content = TypeVar("Content")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Workers:
    """Processes of this machine or a Dask cluster that do tasks; here a single one needs none."""

    jobs: int = -1  # processes of this machine; -1: one for each core
    scheduler: str | None = None  # address of a Dask scheduler, such as tcp://10.0.0.1:8786
    scheduler_wait: float = SCHEDULER_WAIT  # s in which a lost scheduler may come back
    shared: bool = False  # whether they reach folders of shards, to read and write there themselves
    progress: Progress = SILENT  # report of how much of the work is done

    def __post_init__(self) -> None:
        if self.jobs == 0 or not -MOST_JOBS <= self.jobs <= MOST_JOBS:
            raise InputError(
                f"jobs is {self.jobs}; expected a number of processes up to {MOST_JOBS}, or -1 for "
                "all cores."
            )
        check_range("the wait for a lost scheduler", self.scheduler_wait, 0, MOST_WAIT)

    def with_progress(self, progress: Progress) -> "Workers":
        """The same workers with another progress report."""
        return replace(self, progress=progress)

    def work(
        self,
        function: Callable[[Task, Content], Result],
        tasks: Sequence[Task],
        load: Callable[[Task], Content],
    ) -> Generator[tuple[Task, Result], None, None]:
        """Each task with its result, as they are done, in any order.

        What a killed worker or a lost scheduler had in hand is done again; ProlearnError where that
        happens repeatedly. ``function`` must be importable on every worker; its second argument is
        what ``load`` reads, in this process, when the task's turn comes.
        """
        waiting, losses, retrying = dict(enumerate(tasks)), 0, False
        while waiting:
            try:
                with closing(self._once(function, dict(waiting), load, retrying)) as results:
                    for number, result in results:
                        losses = 0
                        yield waiting.pop(number), result
            except WorkersLostError as lost:
                losses, retrying = losses + 1, True
                if losses == MOST_LOSSES:
                    raise ProlearnError(lost.repeatedly) from lost
                self.progress.say(str(lost))

    def _once(
        self,
        function: Callable[[Task, Content], Result],
        tasks: Mapping[int, Task],
        load: Callable[[Task], Content],
        retrying: bool,
    ) -> Generator[tuple[int, Result], None, None]:
        """Results by the tasks' numbers, until all are there or workers are lost."""
        jobs = joblib.effective_n_jobs(self.jobs)
        if self.scheduler is None and (jobs == 1 or (len(tasks) == 1 and not retrying)):
            with _thread_pools(len(sys.modules)).limit(limits=1):
                for number, task in tasks.items():
                    yield number, function(task, load(task))
            return
        calls = (
            functools.partial(_call, function, number, task, _loaded(load, task))
            for number, task in tasks.items()
        )
        if self.scheduler is None:
            yield from run_in_processes(calls, jobs)
            return
        with cluster(self.scheduler, self.scheduler_wait, retrying, self.progress) as workers:
            yield from workers.results(calls)


ALL_CORES = Workers()  # a process for each core of this machine


@functools.lru_cache(maxsize=1)
def _thread_pools(_modules: int) -> ThreadpoolController:
    """Thread pools of the loaded libraries, found again once more modules are imported."""
    return ThreadpoolController()


def _loaded(load: Callable[[Task], Content], task: Task) -> Content | Exception:
    """The content of a task, or the error of loading it: joblib hides errors raised there."""
    try:
        return load(task)
    except Exception as error:
        return error


def _call(
    function: Callable[[Task, Content], Result],
    number: int,
    task: Task,
    content: Content | Exception,
) -> tuple[int, Result]:
    """In a worker: one task on one thread; an error in loading is raised here."""
    if isinstance(content, Exception):
        raise content
    threadpool_limits(1)  # for good, since a worker's threads share it; it must not change sums
    return number, function(task, content)


def check_worker(expected: Mapping[str, str], decided_by: DecidedBy) -> None:
    """In a worker: ProlearnError where versions differ from those where the work was begun."""
    try:
        change = version_change(expected, made_with(*decided_by))
    except PackageNotFoundError as error:
        change = f"{error.name}, which is not installed"
    if change:
        raise ProlearnError(
            f"this is made with {change} on a worker; expected the same versions on all "
            "machines: install them there and run the same command again."
        )
