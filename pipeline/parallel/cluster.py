"""A pool of the workers of a Dask cluster, whose scheduler may be lost and come back."""

import logging
import socket
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from itertools import islice
from queue import Empty, SimpleQueue
from time import monotonic, sleep
from typing import TYPE_CHECKING, Any

from pipeline.errors import InputError, ProlearnError, missing_extra_hint
from pipeline.parallel.processes import KEPT, SAME, WorkersLostError
from pipeline.progress import Progress
from pipeline.text import public, public_url

if TYPE_CHECKING:
    from distributed import Client, Future

CONNECT_SECONDS = 10.0  # how long a scheduler may take to answer, and then to have a first worker
TRY_SECONDS = 0.5  # how often a connection to a scheduler is tried
CHECK_SECONDS = 1.0  # how often the connection is checked while no call ends
COUNT_SECONDS = 2.0  # how often the workers are counted


@contextmanager
def cluster(
    scheduler: str, wait: float, retrying: bool, progress: Progress
) -> Iterator["DaskCluster"]:
    """Connect to a Dask scheduler; ProlearnError where none answers or it has no workers.

    One that was lost (``retrying``) has ``wait`` seconds to answer, and may have no workers yet.
    """
    where = public_url(scheduler)
    with _without_logs():
        _check_certificates(scheduler)
        # Calls carry some MB of content, which Dask takes for a mistake.
        warnings.filterwarnings("ignore", "Sending large graph", UserWarning)
        try:
            client = _client(scheduler, wait if retrying and wait else CONNECT_SECONDS)
        except (OSError, ValueError) as error:
            raise ProlearnError(
                f"the Dask scheduler at {where} is gone and did not come back within {wait:g} s; "
                f"{KEPT}: start it and its workers, and run {SAME}."
                if retrying
                else f"no Dask scheduler answers at {where} ({public(error, scheduler)}); start "
                "one with `dask scheduler`."
            ) from error
        try:
            pool = DaskCluster(client, where, wait)
            if not pool.has_workers(0.0 if retrying else CONNECT_SECONDS):
                none = f"the Dask scheduler at {where} has no workers"
                start = f"start some with `dask worker {where}`."
                if not retrying:
                    raise ProlearnError(f"{none}; {start}")
                progress.say(f"{none} yet; {start}")
            yield pool
        finally:
            with suppress(Exception):  # of a scheduler that is gone
                client.close(CONNECT_SECONDS)


class DaskCluster:
    """The workers of a Dask cluster, as a pool."""

    def __init__(self, client: "Client", where: str, wait: float) -> None:
        self._client, self._where, self._wait = client, where, wait
        self._connection = client.scheduler_comm
        self._threads, self._counted = 0, -COUNT_SECONDS

    def has_workers(self, seconds: float) -> bool:
        """Whether workers come within some seconds; a call is sent, for which clusters may grow."""
        with self._connected():
            there = bool(self._client.ncores())
            if there or not seconds:
                return there
            try:
                self._client.submit(int, pure=False).result(seconds)
            except TimeoutError:
                return False
            return True

    def results(self, calls: Iterator[Callable[[], Any]]) -> Iterator[Any]:
        """Results of calls in the order in which they are done; raises what a call raises.

        A call is drawn when due, so that not all need to fit in memory. WorkersLostError where
        workers are lost; calls without a result are to be made again.
        """
        done: SimpleQueue[Future] = SimpleQueue()
        under_way = 0
        while True:
            for call in islice(calls, max(0, self._room() - under_way)):
                with self._connected():
                    future = self._client.submit(call, pure=False)
                under_way += 1
                future.add_done_callback(done.put)
            if not under_way:
                return
            future = self._next(done)
            under_way -= 1
            yield self._result(future)

    def _room(self) -> int:
        """The most calls under way: one running and one waiting for each thread of the workers."""
        if monotonic() - self._counted >= COUNT_SECONDS:
            self._check()
            with self._connected():
                self._threads = sum(self._client.ncores().values())
            self._counted = monotonic()
        return 2 * max(self._threads, 1)

    def _next(self, done: "SimpleQueue[Future]") -> "Future":
        while True:
            try:
                return done.get(timeout=CHECK_SECONDS)
            except Empty:
                self._check()

    def _result(self, future: "Future") -> Any:
        """The result of a call that has ended, or the error that it raised."""
        from distributed import KilledWorker

        if future.status != "error":
            with self._connected():
                return future.result()
        try:
            return future.result()
        except KilledWorker as error:
            killed = "workers of the Dask cluster were killed, perhaps for want of memory"
            raise WorkersLostError(
                f"{killed}; what they had in hand is done again.",
                f"{killed}, again and again; {KEPT}: give each worker more memory and run {SAME}.",
            ) from error

    def _check(self) -> None:
        if self._is_broken():
            raise self._gone()

    def _is_broken(self) -> bool:
        """Whether the connection of the calls is gone; Dask's client makes a new one by itself."""
        now = self._client.scheduler_comm
        return now is None or now is not self._connection or now.closed()

    @contextmanager
    def _connected(self) -> Iterator[None]:
        """Any error in the block that a broken connection caused becomes WorkersLostError."""
        try:
            yield
        except Exception as error:
            if isinstance(error, (OSError, CancelledError)) or self._is_broken():
                raise self._gone() from error
            raise

    def _gone(self) -> Exception:
        gone = f"the Dask scheduler at {self._where} is gone"
        if not self._wait:
            return ProlearnError(f"{gone}; {KEPT}: start it and run {SAME}.")
        return WorkersLostError(
            f"{gone}; waiting up to {self._wait:g} s for it to come back, to do again what was in "
            "hand.",
            f"{gone} again and again; {KEPT}: see why in its log, and run {SAME}.",
        )


def _check_certificates(scheduler: str) -> None:
    """Raise InputError for a TLS scheduler if Dask's own configuration has no certificates."""
    from distributed.security import Security

    with_tls = scheduler.startswith("tls://")
    if with_tls and Security().get_connection_args("client").get("ssl_context") is None:
        raise InputError(
            f"the scheduler is {public_url(scheduler)} and Dask has no certificates for it; "
            "expected distributed.comm.tls.ca-file, client.cert and client.key in its "
            "configuration or environment: see docs/dataset.md."
        )


def _client(scheduler: str, seconds: float) -> "Client":
    """A client of a scheduler once it answers; OSError where it does not in time."""
    from distributed import Client
    from distributed.comm import get_address_host_port

    end = monotonic() + seconds
    while True:
        timeout = min(CONNECT_SECONDS, max(TRY_SECONDS, end - monotonic()))
        try:
            # Tried without a client, since one that is still connecting delays a Ctrl-C.
            with socket.create_connection(get_address_host_port(scheduler), timeout):
                pass
            return Client(scheduler, timeout=timeout, set_as_default=False)
        except OSError:
            if monotonic() >= end:
                raise
            sleep(min(TRY_SECONDS, max(0.0, end - monotonic())))


@contextmanager
def _without_logs() -> Iterator[None]:
    """Hide the tracebacks that Dask logs when a scheduler is lost; InputError without Dask."""
    with missing_extra_hint():
        import distributed  # noqa: F401, its loggers have their levels from then on
    loggers = [logging.getLogger(name) for name in ("distributed", "distributed.client")]
    before = [logger.level for logger in loggers]
    try:
        for logger in loggers:
            logger.setLevel(logging.CRITICAL)
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)
