"""Work on shards by joblib's workers, on this machine or on a Dask cluster.

Workers are given bytes and give bytes back: they touch no file, so that a killed one leaves
nothing behind, a cluster needs no shared disk, and only the process that holds the folder writes.
"""

import os
import signal
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from multiprocessing import resource_tracker
from typing import TypeVar

import joblib
from joblib.externals.loky.backend import resource_tracker as loky_tracker
from joblib.externals.loky.process_executor import TerminatedWorkerError
from threadpoolctl import threadpool_limits

from pipeline.errors import InputError, ProlearnError
from pipeline.jobs.worker import loaded, work
from pipeline.progress import SILENT, Progress
from pipeline.urls import public, public_url

MOST_KILLS = 3
"""Times in a row that workers may be killed before a single shard is done."""

MOST_JOBS = 1024
"""Processes on this machine."""

CONNECT_SECONDS = 10
"""How long a scheduler may take to answer."""

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
    """

    jobs: int = -1
    scheduler: str | None = None

    def __post_init__(self) -> None:
        """Refuse what nothing can be run on."""
        if self.jobs == 0 or not -MOST_JOBS <= self.jobs <= MOST_JOBS:
            raise InputError(
                f"jobs is {self.jobs}; expected a number of processes up to {MOST_JOBS}, or -1 for "
                "all cores."
            )

    def work(
        self,
        function: Callable[[Task, Content], Result],
        tasks: Sequence[Task],
        load: Callable[[Task], Content],
        progress: Progress = SILENT,
    ) -> Generator[tuple[Task, Result], None, None]:
        """Each task with its result, as they are done, in any order.

        What a killed worker had in hand is done again by new ones.

        Args:
            function: what to do, importable on every worker.
            tasks: what to do it with.
            load: what a task needs, such as bytes of a file, read here when its turn comes.
            progress: told of killed workers.

        Raises:
            ProlearnError: where workers are killed again and again, or none can be had.
        """
        waiting, kills = dict(enumerate(tasks)), 0
        while waiting:
            try:
                with closing(self._once(function, dict(waiting), load)) as results:
                    for number, result in results:
                        kills = 0
                        yield waiting.pop(number), result
            except _killed() as error:
                kills += 1
                if kills == MOST_KILLS:
                    raise ProlearnError(
                        "worker processes are killed again and again, perhaps for want of "
                        "memory; the shards that were done are kept: run the same command again "
                        "with fewer --jobs."
                    ) from error
                progress.say(
                    "a worker process was killed, perhaps for want of memory; what it had in "
                    "hand is done again."
                )

    def _once(
        self,
        function: Callable[[Task, Content], Result],
        tasks: Mapping[int, Task],
        load: Callable[[Task], Content],
    ) -> Generator[tuple[int, Result], None, None]:
        here = self.scheduler is None
        if here and joblib.effective_n_jobs(self.jobs) == 1:
            with threadpool_limits(1):
                for number, task in tasks.items():
                    yield number, function(task, load(task))
            return
        parent = os.getpid() if here else None
        calls = (
            joblib.delayed(work)(function, number, task, loaded(load, task), parent)
            for number, task in tasks.items()
        )
        with _cluster(self.scheduler) if self.scheduler else joblib.parallel_config("loky"):
            parallel = joblib.Parallel(
                n_jobs=self.jobs, return_as="generator_unordered", batch_size=1
            )
            with ExitStack() as stack:  # an interrupt that waited finds the results to close
                with _deaf_to_interrupts():
                    results = stack.enter_context(closing(parallel(calls)))
                for number, result in results:
                    if isinstance(result, ProlearnError):
                        raise result
                    yield number, result


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """Processes that start in the block never see Ctrl-C, which a terminal sends to all of them.

    One that is still importing would print a traceback; this process tells them when to stop.
    Its own Ctrl-C waits until the block has ended.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    for tracker in (resource_tracker, loky_tracker):
        tracker.ensure_running()  # one that started in the block would undo it
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _cluster(scheduler: str) -> Iterator[None]:
    """In the block joblib works on the Dask cluster of a scheduler."""
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError(
            "backend is 'dask' and Dask is not installed; install it with "
            "`pip install 'prolearn[dask]'`."
        ) from error
    where = public_url(scheduler)
    try:
        client = Client(scheduler, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ProlearnError(
            f"no Dask scheduler answers at {where} ({public(error, scheduler)}); start one with "
            "`dask scheduler`."
        ) from error
    try:
        with client, joblib.parallel_config("dask", client=client):
            yield
    except TimeoutError as error:
        raise ProlearnError(
            f"the scheduler at {where} has no workers; start some with `dask worker {where}`."
        ) from error


def _killed() -> tuple[type[Exception], ...]:
    """What the loss of a worker looks like; Dask itself replaces lost ones a few times."""
    try:
        from distributed import KilledWorker
    except ImportError:
        return (TerminatedWorkerError,)
    return TerminatedWorkerError, KilledWorker
