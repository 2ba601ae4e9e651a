"""A pool of worker processes on this machine, by the loky that joblib brings along."""

import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from functools import lru_cache
from multiprocessing import resource_tracker
from pathlib import Path
from types import FrameType
from typing import Any

from joblib.externals.loky.backend import resource_tracker as loky_tracker
from joblib.externals.loky.process_executor import ProcessPoolExecutor, TerminatedWorkerError
from joblib.parallel import ParallelBackendBase

from pipeline.jobs.parent import end_with
from pipeline.jobs.spread import Call, WorkersLostError

IDLE_SECONDS = 300
"""After so long without work a worker ends; the next work starts another."""

SEMAPHORES = Path("/dev/shm")
"""Where Linux keeps named semaphores, as files."""


@contextmanager
def processes(jobs: int) -> Iterator["Processes"]:
    """A pool of processes; killed where the block is left before all is done, else kept for more.

    Args:
        jobs: how many.
    """
    _remove_left_semaphores()
    executor = _executor(jobs, os.getpid())
    try:
        yield Processes(executor, jobs)
    except BaseException:
        _executor.cache_clear()
        executor.shutdown(kill_workers=True)
        raise


class Processes:
    """Worker processes of this machine, as a pool."""

    def __init__(self, executor: ProcessPoolExecutor, jobs: int) -> None:
        self._executor, self._jobs = executor, jobs

    def room(self) -> int:
        """A call for each worker, and another for when that is done."""
        return 2 * self._jobs

    def submit(self, call: Call) -> Future[Any]:
        """Have a call made; starts the workers that are not there."""
        with _killed_workers(), _starting_processes():
            return self._executor.submit(call)

    def result(self, future: Future[Any]) -> Any:
        """What a call gave or raised."""
        with _killed_workers():
            return future.result()

    def look(self) -> None:
        """Nothing: loky looks for killed workers itself."""


@lru_cache(maxsize=1)
def _executor(jobs: int, parent: int) -> ProcessPoolExecutor:
    return ProcessPoolExecutor(
        jobs,
        timeout=IDLE_SECONDS,
        initializer=end_with,
        initargs=(parent,),
        env=dict.fromkeys(ParallelBackendBase.MAX_NUM_THREADS_VARS, "1"),
    )


@contextmanager
def _killed_workers() -> Iterator[None]:
    try:
        yield
    except TerminatedWorkerError as error:
        raise WorkersLostError(
            "a worker process was killed, perhaps for want of memory; what it had in hand is done "
            "again.",
            "worker processes are killed again and again, perhaps for want of memory; the shards "
            "that were done are kept: run the same command again with fewer --jobs.",
        ) from error


@contextmanager
def _starting_processes() -> Iterator[None]:
    """In the block Ctrl-C and SIGTERM wait, and processes that start never see a Ctrl-C.

    A terminal sends Ctrl-C to all of them, and one that is still importing would print a
    traceback; this process tells them when to stop.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    for tracker in (resource_tracker, loky_tracker):
        tracker.ensure_running()  # one that started in the block would undo it
    with _waiting_signals():
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _waiting_signals() -> Iterator[None]:
    """Signals that end this process are handled after the block.

    A mask would not do: where another thread has none, this one still runs the handler.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []

    def note(number: int, _: FrameType | None) -> None:
        came.append(number)

    before = {s: signal.signal(s, note) for s in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for ending, handler in before.items():
            signal.signal(ending, handler)
        for number in came:
            signal.raise_signal(number)


def _remove_left_semaphores() -> None:
    """Remove the semaphores of processes that were killed together with their resource trackers.

    loky names a semaphore after the process that made it.
    """
    for path in SEMAPHORES.glob("sem.loky-*"):
        with suppress(OSError, ValueError):
            if path.stat().st_uid == os.getuid() and not _is_there(int(path.name.split("-")[1])):
                path.unlink()


def _is_there(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True
