"""Work in forked children that are killed (-9) at one step after the other.

Scripts that use this run in a process of their own, forked from one that has imported everything.
"""

import os
import signal
import sys
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path

from forked import Forked


def run_script(forked: Forked, script: str, *arguments: object) -> str:
    """Run a Python script, which can import tests/support, and return its standard output."""
    run = forked.run([*map(str, arguments)], Path.cwd(), code=script)
    assert run.returncode == 0, run.stderr
    return run.stdout


def in_a_child(work: Callable[[], object]) -> int:
    """Exit status of work in a forked child; 9 for an error, -9 where it was killed."""
    child = os.fork()
    if child == 0:
        try:
            work()
        except BaseException as error:
            print(repr(error), file=sys.stderr, flush=True)
            os._exit(9)
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def die() -> None:
    """Kill this process."""
    os.kill(os.getpid(), signal.SIGKILL)


def die_at_flush(step: int) -> None:
    """Kill this process before a flush of a file or a folder to disk, counted from 0.

    The system call, not our code, is where it ends.
    """
    flush, left = os.fsync, [step]

    def fsync(handle: int) -> None:
        if left[0] == 0:
            die()
        left[0] -= 1
        flush(handle)

    os.fsync = fsync  # type: ignore[assignment]


def kills(killed: Callable[[int], object]) -> Iterator[int]:
    """Each step at which a child was killed, until the first that no kill reached.

    Args:
        killed: work that kills its process at a step.
    """
    for step in count():
        status = in_a_child(lambda: killed(step))  # noqa: B023, called at once
        if status == 0:
            return
        assert status == -signal.SIGKILL, status
        yield step


def run_again(work: Callable[[], object]) -> None:
    """Work in a forked child that must succeed."""
    assert in_a_child(work) == 0
