"""Processes of other processes, as Linux shows them in /proc."""

from pathlib import Path

SOON = 40.0
"""Seconds: what a busy machine makes of a few, less than the minutes of a client that retries."""


def workers_of(pid: int) -> list[int]:
    """Worker processes that a process has started, however far they have come."""
    found = []
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            parent = int(entry.read_text().rpartition(")")[2].split()[1])
            line = (entry.parent / "cmdline").read_bytes()
        except OSError:
            continue
        if parent == pid and b"loky" in line and b"resource_tracker" not in line:
            found.append(int(entry.parent.name))
    return found
