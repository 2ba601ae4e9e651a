"""Calls made by worker processes of this machine, by joblib's loky."""

import os
import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from multiprocessing import connection, resource_tracker
from multiprocessing.util import Finalize
from pathlib import Path
from types import FrameType
from typing import Any

import joblib
from joblib.externals.loky.backend import resource_tracker as loky_tracker
from joblib.externals.loky.process_executor import BrokenProcessPool, TerminatedWorkerError

from pipeline.parallel import collect_garbage_seldom

SEMAPHORES = Path("/dev/shm")  # where Linux keeps named semaphores, as files
KEPT, SAME = "what was done is kept", "the same command again (with --resume if it has that)"
SAFE_PATH = "PYTHONSAFEPATH"  # Python's variable that leaves the current folder out of its path
WATCH_SECONDS = 0.5  # interval at which workers and their parent check that the other is alive
FEEDER_SECONDS = 1.0  # longest that the end of this process waits for a closed queue's thread


class WorkersLostError(Exception):
    """Workers, or the connection to them, are lost with all calls under way."""

    def __init__(self, once: str, repeatedly: str) -> None:
        super().__init__(once)
        self.repeatedly = repeatedly  # the message where it happens again and again


def run_in_processes(calls: Iterable[Callable[[], Any]], jobs: int) -> Iterator[Any]:
    """Results of calls as they are done, each drawn when due; WorkersLostError after a kill."""
    _remove_left_semaphores()
    # Loky ends a worker whose memory grows, by a cache of data or a library, and starts another.
    warnings.filterwarnings("ignore", "A worker stopped while some jobs", UserWarning)
    parallel = joblib.Parallel(
        n_jobs=jobs,
        backend="loky",
        return_as="generator_unordered",
        batch_size=1,
        max_nbytes=None,  # nothing is large enough for a file in shared memory, which a kill leaves
        initializer=_begin_worker,
        initargs=(os.getpid(),),
    )
    broken = threading.Event()
    try:
        with ExitStack() as stack:  # an interrupt that waited finds the results to close
            stack.enter_context(_no_imports_from_here())
            with _starting_processes():
                delayed = (joblib.delayed(call)() for call in calls)
                started = parallel(delayed)
                stack.enter_context(_broken_by_lost_results(parallel._backend._workers, broken))
                results = stack.enter_context(closing(started))
                stack.push(_silence_cancelled)
            for result in results:  # noqa: UP028, `yield from` would close them before the above
                yield result
    except BrokenProcessPool as error:
        if not (isinstance(error, TerminatedWorkerError) or broken.is_set()):
            raise
        raise WorkersLostError(
            "a worker process was killed, perhaps for want of memory; what it had in hand is done "
            "again.",
            f"worker processes are killed again and again, perhaps for want of memory; {KEPT}: run "
            f"{SAME}, with fewer --jobs.",
        ) from error


@contextmanager
def _broken_by_lost_results(pool: Any, broken: threading.Event) -> Iterator[None]:
    """In the block, break loky's pool if a worker is killed while it sends a result; set the event.

    Loky itself would wait for the rest forever: the pipe of results stays open, as this process
    and the other workers could write to it, and those wait for the lock that the killed one held.
    """
    done, processes, results = threading.Event(), pool._processes, pool._result_queue

    def watch() -> None:
        dead_before: set[int] = set()
        while not done.wait(WATCH_SECONDS):
            workers = {worker.sentinel: worker.pid for worker in list(processes.values())}
            dead = {workers[ended] for ended in connection.wait(workers, timeout=0)}
            if dead & dead_before:  # loky takes out the dead within milliseconds otherwise
                broken.set()
                for pid in {*workers.values()} - dead:
                    with suppress(ProcessLookupError):
                        os.kill(pid, signal.SIGKILL)
                results._writer.close()  # now the pipe has an end
                return
            dead_before = dead

    watching = threading.Thread(target=watch, daemon=True)
    watching.start()
    try:
        yield
    finally:
        done.set()
        watching.join()


def _silence_cancelled(kind: type[BaseException] | None, *_: object) -> None:
    """Suppress tracebacks and warnings of joblib and loky after unfinished results are closed."""
    if kind is None:
        return
    usual = threading.excepthook

    def hook(raised: threading.ExceptHookArgs) -> None:
        handing_out = raised.thread is not None and raised.thread.name == "ExecutorManagerThread"
        if not (handing_out and raised.exc_type is KeyError):
            usual(raised)

    threading.excepthook = hook
    warnings.filterwarnings("ignore", category=UserWarning, module="joblib.parallel")
    # At exit, after queues (10) are closed and before semaphores (0) are removed
    Finalize(None, _wait_for_feeders, exitpriority=5)


def _wait_for_feeders() -> None:
    """Join the threads of closed queues, which unlink semaphores as they end.

    Where the process ends between that and its report to loky's resource tracker, the tracker
    warns of leaked semaphores.
    """
    for thread in threading.enumerate():
        if thread.name == "QueueFeederThread":
            thread.join(timeout=FEEDER_SECONDS)


@contextmanager
def _no_imports_from_here() -> Iterator[None]:
    """In the block, processes that start import nothing from the current folder.

    It would come first in their path, and any file there, such as ``random.py``, could take the
    place of a module.
    """
    usual = os.environ.get(SAFE_PATH)
    os.environ[SAFE_PATH] = "1"
    try:
        yield
    finally:
        if usual is None:
            del os.environ[SAFE_PATH]
        else:
            os.environ[SAFE_PATH] = usual


def _begin_worker(parent: int) -> None:
    """Set up a worker: it collects garbage seldom, and ends when its parent has, even by a kill."""
    collect_garbage_seldom()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH_SECONDS)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _starting_processes() -> Iterator[None]:
    """Delay Ctrl-C and SIGTERM in the block; processes started in it never see a Ctrl-C.

    A terminal sends Ctrl-C to all processes, and one that is still importing would print a
    traceback; this process tells the others when to stop.
    """
    for tracker in (resource_tracker, loky_tracker):
        tracker.ensure_running()  # started in the block, it would undo this
    with waiting_signals():
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def waiting_signals() -> Iterator[None]:
    """Delay the handlers of signals that end this process until the block is done.

    A mask is not enough: a signal that a thread without it receives still runs the handler here.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: list[int] = []

    def note(number: int, _: FrameType | None) -> None:
        received.append(number)

    before = {s: signal.signal(s, note) for s in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for ending, handler in before.items():
            signal.signal(ending, handler)
        for number in received:
            signal.raise_signal(number)


def _remove_left_semaphores() -> None:
    """Remove semaphores, which name their process, of processes that were killed."""
    for path in SEMAPHORES.glob("sem.loky-*"):
        with suppress(OSError, ValueError):
            if path.stat().st_uid == os.getuid():
                try:
                    os.kill(int(path.name.split("-")[1]), 0)
                except ProcessLookupError:
                    path.unlink()
