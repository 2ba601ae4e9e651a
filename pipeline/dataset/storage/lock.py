"""One writer of a dataset folder at a time."""

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime

from filelock import FileLock, Timeout

from pipeline.dataset.storage.folder import Folder, LocalFolder
from pipeline.errors import InputError, ProlearnError

LOCK = "_lock"
WRITER = "_writer"
"""Says who holds the lock, for the others to read."""


@contextmanager
def sole_writer(folder: Folder) -> Iterator[None]:
    """Hold a folder for writing, and clear away what killed writers left unfinished.

    The lock is the operating system's, so it ends with its holder, however that ends. Object
    stores have none: there two runs both finish, with identical bytes.

    Raises:
        InputError: where another process holds it.
        ProlearnError: where the folder cannot be written to.
    """
    if not isinstance(folder, LocalFolder):
        yield
        return
    lock = _acquired(folder)
    try:
        folder.sweep()
        folder.publish(WRITER, _whoami().encode())
        yield
    finally:
        with suppress(ProlearnError):
            folder.remove(WRITER)
        lock.release()


def _acquired(folder: LocalFolder) -> FileLock:
    try:
        folder.path.mkdir(parents=True, exist_ok=True)
        lock = FileLock(folder.path / LOCK, timeout=0)
        lock.acquire()
    except Timeout as error:
        raise InputError(
            f"{folder} is being written by {_holder(folder)}; wait for it or give another folder."
        ) from error
    except (OSError, NotImplementedError) as error:
        raise ProlearnError(
            f"{folder} cannot be written to ({error}); give a folder that can."
        ) from error
    return lock


def _holder(folder: Folder) -> str:
    try:
        return folder.read(WRITER).decode()
    except OSError:
        return "another process"


def _whoami() -> str:
    now = datetime.now().astimezone().isoformat(timespec="seconds")
    return f"process {os.getpid()} on {socket.gethostname()}, since {now}"
