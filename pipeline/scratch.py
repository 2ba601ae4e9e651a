"""Scratch folders, and lock files, held by the operating system, that show if their owner lives."""

import os
import re
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from uuid import uuid4

from filelock import FileLock

# With the machine's name: others may share the folder and not see this machine's locks
PREFIX = f"prolearn-scratch-{os.uname().nodename}-"
SUFFIX = ".lock"
TOKEN = len(uuid4().hex)  # characters between a prefix and the suffix
# Attempts to remove a folder, and s between them
MOST_REMOVALS, REMOVAL_SECONDS = 10, 0.1
NO_LOCK = (OSError, NotImplementedError)  # where a folder or file system allows none


@contextmanager
def held_lock_file(folder: Path, prefix: str, *, keep_on_error: bool = False) -> Iterator[str]:
    """Hold a lock file ``<prefix><token>.lock`` of its own for the block, and remove it after.

    Yields the name without ``.lock``. Where there can be no lock, there is none, and nobody takes
    this process for dead. With ``keep_on_error`` the file stays, unlocked, where the block raises:
    the next ``clear_dead`` then does what the block may have left undone.
    """
    name = f"{prefix}{uuid4().hex}"
    path = folder / f"{name}{SUFFIX}"
    lock = FileLock(path)
    with suppress(*NO_LOCK):
        folder.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    removed = not keep_on_error
    try:
        yield name
        removed = True
    finally:
        with suppress(OSError):
            if removed and lock.is_locked:
                path.unlink(missing_ok=True)
        lock.release()


def clear_dead(folder: Path, prefix: str, clear: Callable[[str], None]) -> None:
    """Clear away what dead processes of this user left, and then their lock files.

    ``clear`` is given the name that ``held_lock_file`` gave; where it raises OSError the lock file
    stays for the next time. Another process that does the same finds the lock held, or no file.
    """
    fits = re.compile(rf"{re.escape(prefix)}.{{{TOKEN}}}{re.escape(SUFFIX)}").fullmatch
    with suppress(OSError):
        names = filter(fits, (entry.name for entry in os.scandir(folder)))
        for path in sorted(folder / name for name in names):
            with suppress(*NO_LOCK):
                if path.lstat().st_uid == os.geteuid():  # others may write to the folder, too
                    with FileLock(path, timeout=0):  # a Timeout is an OSError: its holder lives
                        clear(path.name.removesuffix(SUFFIX))
                        path.unlink(missing_ok=True)


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """A temporary folder for the block; those of processes that were killed are removed first."""
    clear_scratch()
    place = Path(tempfile.gettempdir())
    with held_lock_file(place, PREFIX) as name:
        folder = place / name
        folder.mkdir(mode=0o700)
        try:
            yield folder
        finally:
            _remove(folder)


def _remove(folder: Path) -> None:
    """Remove a folder, with retries: a thread that outlives an interrupt may still write to it."""
    for _ in range(MOST_REMOVALS):
        shutil.rmtree(folder, ignore_errors=True)
        if not folder.exists():
            return
        time.sleep(REMOVAL_SECONDS)


def clear_scratch() -> None:
    """Remove the temporary folders of processes that were killed."""
    place = Path(tempfile.gettempdir())

    def remove(name: str) -> None:
        if (place / name).exists():
            shutil.rmtree(place / name)

    clear_dead(place, PREFIX, remove)


def own_folder(what: str) -> str:
    """A temporary folder that this user alone may write to and that stays; OSError if another may.

    For caches of libraries, where there is none in the home: what is in them may be run.
    """
    folder = Path(tempfile.gettempdir(), f"prolearn-{what}-{os.getuid()}")
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    if folder.is_symlink() or found.st_uid != os.getuid() or found.st_mode & 0o077:
        raise PermissionError(f"{folder} is another's")
    return str(folder)


@contextmanager
def temporary_files_in(folder: Path) -> Iterator[None]:
    """Let libraries that make temporary files in the block make them in a folder."""
    before = tempfile.tempdir
    tempfile.tempdir = str(folder)
    try:
        yield
    finally:
        tempfile.tempdir = before
