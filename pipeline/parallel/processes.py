"""Calls made by worker processes of this machine, by joblib's loky."""

import os
import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from multiprocessing import resource_tracker
from pathlib import Path
from types import FrameType
from typing import Any

import joblib
from joblib.externals.loky.backend import resource_tracker as loky_tracker
from joblib.externals.loky.process_executor import TerminatedWorkerError

SEMAPHORES = Path("/dev/shm")  # where Linux keeps named semaphores, as files
KEPT, SAME = "what was done is kept", "the same command again (with --resume if it has that)"
PARENT_SECONDS = 0.5  # how often a worker checks whether its parent is still there


class WorkersLostError(Exception):
    """Workers, or the connection to them, are lost with all calls under way."""

    def __init__(self, once: str, again: str) -> None:
        super().__init__(once)
        self.again = again  # what to say where it happens again and again


def run_in_processes(calls: Iterable[Callable[[], Any]], jobs: int) -> Iterator[Any]:
    """Results of calls as they are done, each drawn at its turn; WorkersLostError after a kill."""
    _remove_left_semaphores()
    # Loky ends a worker whose memory grows, by a cache of data or a library, and starts another.
    warnings.filterwarnings("ignore", "A worker stopped while some jobs", UserWarning)
    parallel = joblib.Parallel(
        n_jobs=jobs,
        backend="loky",
        return_as="generator_unordered",
        batch_size=1,
        max_nbytes=None,  # nothing is large enough for a file in shared memory, which a kill leaves
        initializer=end_with,
        initargs=(os.getpid(),),
    )
    try:
        with ExitStack() as stack:  # an interrupt that waited finds the results to close
            with _starting_processes():
                asked = (joblib.delayed(call)() for call in calls)
                results = stack.enter_context(closing(parallel(asked)))
                stack.push(_silence_cancelled)
            for result in results:  # noqa: UP028, `yield from` would close them before the above
                yield result
    except TerminatedWorkerError as error:
        raise WorkersLostError(
            "a worker process was killed, perhaps for want of memory; what it had in hand is done "
            "again.",
            f"worker processes are killed again and again, perhaps for want of memory; {KEPT}: run "
            f"{SAME}, with fewer --jobs.",
        ) from error


def _silence_cancelled(kind: type[BaseException] | None, *_: object) -> None:
    """Hide what joblib's parts report of cancelled calls where results are given up."""
    if kind is None:
        return
    usual = threading.excepthook

    def hook(raised: threading.ExceptHookArgs) -> None:
        handing_out = raised.thread is not None and raised.thread.name == "ExecutorManagerThread"
        if not (handing_out and raised.exc_type is KeyError):
            usual(raised)

    threading.excepthook = hook
    warnings.filterwarnings("ignore", category=UserWarning, module="joblib.parallel")


def end_with(parent: int) -> None:
    """End this process, as loky's worker, when the one with this id has ended, even by a kill."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(PARENT_SECONDS)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _starting_processes() -> Iterator[None]:
    """In the block Ctrl-C and SIGTERM wait, and processes that start never see a Ctrl-C.

    A terminal sends Ctrl-C to all of them, and one that is still importing would print a
    traceback; this process tells them when to stop.
    """
    for tracker in (resource_tracker, loky_tracker):
        tracker.ensure_running()  # one that started in the block would undo it
    with waiting_signals():
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def waiting_signals() -> Iterator[None]:
    """Delay the handlers of signals that end this process until the block is done.

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
    """Remove semaphores, named by process, of those killed with their resource trackers."""
    for path in SEMAPHORES.glob("sem.loky-*"):
        with suppress(OSError, ValueError):
            if path.stat().st_uid == os.getuid():
                try:
                    os.kill(int(path.name.split("-")[1]), 0)
                except ProcessLookupError:
                    path.unlink()
