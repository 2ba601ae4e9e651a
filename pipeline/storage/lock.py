"""One writer of a dataset folder at a time."""

import os
import re
import socket
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from datetime import datetime
from pathlib import Path

from filelock import FileLock, Timeout

from pipeline.errors import InputError, ProlearnError
from pipeline.files import unfinished
from pipeline.storage.folder import Folder
from pipeline.storage.layout import LOCK, PLACES, WRITER, WRITTEN


@contextmanager
def sole_writer(folder: Folder, owned: str) -> Iterator[None]:
    """Hold a folder for writing, and remove the unfinished files of killed writers.

    The lock is the operating system's, so it ends with its holder, however that ends. Object
    stores have none: there two runs both finish, with identical bytes.

    Args:
        folder: to be held.
        owned: pattern of the names of its shards and of other files that its writers make. An
            unfinished file of any other name is somebody else's, and stays.

    Raises:
        InputError: where another process holds it.
        ProlearnError: where the folder cannot be written to.
    """
    if folder.local is None:
        yield
        return
    with _locked(folder, folder.local):
        for name in _unfinished(folder.local, re.compile(f"{WRITTEN}|{owned}")):
            folder.remove(name)
        try:
            folder.publish(WRITER, _whoami().encode())
            yield
        finally:
            with suppress(ProlearnError):
                folder.remove(WRITER)


def _unfinished(folder: Path, owned: re.Pattern[str]) -> list[str]:
    """Names of unfinished files that a writer of this folder has left."""
    found = []
    for path in (path for place in PLACES for path in folder.glob(f"{place}.*.tmp")):
        meant = unfinished(path)
        name = meant and meant.relative_to(folder).as_posix()
        if name and owned.fullmatch(name) and path.is_file():
            found.append(path.relative_to(folder).as_posix())
    return found


def _locked(folder: Folder, path: Path) -> AbstractContextManager[object]:
    """The lock of a folder, held until this context is left."""
    try:
        path.mkdir(parents=True, exist_ok=True)
        return FileLock(path / LOCK, timeout=0).acquire()
    except Timeout as error:
        raise InputError(
            f"{folder} is being written by {_holder(folder)}; wait for it or give another folder."
        ) from error
    except (OSError, NotImplementedError) as error:
        raise ProlearnError(
            f"{folder} cannot be written to ({error}); give a folder that can."
        ) from error


def _holder(folder: Folder) -> str:
    try:
        return folder.read(WRITER).decode()
    except OSError:
        return "another process"


def _whoami() -> str:
    now = datetime.now().astimezone().isoformat(timespec="seconds")
    return f"process {os.getpid()} on {socket.gethostname()}, since {now}"
