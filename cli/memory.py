"""Commands that ask for more memory than there is end in a sentence, not by the kernel's hand."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pipeline.errors import ProlearnError

GROUP = Path("/sys/fs/cgroup")
"""Where a container says what it may take."""


@contextmanager
def within_memory() -> Iterator[None]:
    """In the block this process gets no more memory than is free, where the system is Linux.

    Linux grants what it does not have, and kills who uses it. With a limit the request fails.

    Raises:
        ProlearnError: in place of a MemoryError.
    """
    free = available()
    try:
        with _limited(free):
            yield
    except MemoryError as error:
        room = "" if free is None else f" than the {free / 1e9:.3g} GB that are free"
        raise ProlearnError(
            f"this takes more memory{room}; expected fewer craft, fewer nodes, or intervals of "
            "fewer revolutions."
        ) from error


def available() -> int | None:
    """Memory in bytes that is free for this process, or None where the system does not say."""
    try:
        system = _kilobytes(Path("/proc/meminfo"), "MemAvailable")
    except (OSError, ValueError):
        return None
    try:
        most, used = (int((GROUP / f"memory.{name}").read_text()) for name in ("max", "current"))
        stat = dict(line.split() for line in (GROUP / "memory.stat").read_text().splitlines())
        cached = int(stat["inactive_file"])  # of files, given back when memory is asked for
    except (OSError, ValueError, KeyError):  # no container, or one without a limit
        return system
    return min(system, max(most - used + cached, 0))


@contextmanager
def _limited(free: int | None) -> Iterator[None]:
    """In the block private memory grows by at most so many bytes."""
    if free is None or sys.platform != "linux":
        yield
        return
    import resource

    soft, hard = before = resource.getrlimit(resource.RLIMIT_DATA)
    wanted = _kilobytes(Path("/proc/self/status"), "VmData") + free
    limits = [one for one in (wanted, soft, hard) if one != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_DATA, (min(limits), hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)


def _kilobytes(path: Path, name: str) -> int:
    """A number of /proc in bytes.

    Raises:
        ValueError: where the file has no such line.
    """
    for line in path.read_text().splitlines():
        if line.startswith(f"{name}:"):
            return 1024 * int(line.split()[1])
    raise ValueError(f"{path} has no {name}")
