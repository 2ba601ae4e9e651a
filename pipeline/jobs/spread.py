"""Calls spread over a pool of workers, and their results as they are done."""

from collections.abc import Callable, Iterator
from itertools import islice
from queue import Empty, SimpleQueue
from typing import Any, Protocol, runtime_checkable

LOOK_SECONDS = 1.0
"""How often a pool is looked at while no call ends."""

Call = Callable[[], Any]


class WorkersLostError(Exception):
    """Workers, or the way to them, are lost with all calls under way.

    Attributes:
        again: what to say where it happens again and again, with what to do then.
    """

    def __init__(self, once: str, again: str) -> None:
        super().__init__(once)
        self.again = again


@runtime_checkable
class Pool(Protocol):
    """Workers that make calls. All methods raise WorkersLostError."""

    def room(self) -> int:
        """How many calls to have under way, so that no worker waits for its next."""

    def submit(self, call: Call) -> Any:
        """Have a call made; its future, which takes add_done_callback."""

    def result(self, future: Any) -> Any:
        """What a call that has ended gave or raised."""

    def look(self) -> None:
        """See whether the workers can still be reached."""


def spread(pool: Pool, calls: Iterator[tuple[int, Call]]) -> Iterator[tuple[int, Any]]:
    """Results of numbered calls, in the order in which they are done.

    A call is drawn when its turn comes, so not all need to fit in memory at once.

    Raises:
        WorkersLostError: where workers are; calls without a result by then are to be made again.
    """
    done: SimpleQueue[Any] = SimpleQueue()
    under_way: dict[Any, int] = {}
    while True:
        for number, call in islice(calls, max(0, pool.room() - len(under_way))):
            future = pool.submit(call)
            under_way[future] = number
            future.add_done_callback(done.put)
        if not under_way:
            return
        future = _next(done, pool)
        yield under_way.pop(future), pool.result(future)


def _next(done: SimpleQueue[Any], pool: Pool) -> Any:
    while True:
        try:
            return done.get(timeout=LOOK_SECONDS)
        except Empty:
            pool.look()
