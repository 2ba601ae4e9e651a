"""One writer of a folder of shards at a time."""

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
from pipeline.storage import LOCK, PLACES, WRITER, WRITTEN
from pipeline.storage.folder import Folder


@contextmanager
def sole_writer(folder: Folder, owned: str) -> Iterator[None]:
    """Hold a folder for writing, and remove the unfinished files of killed writers.

    The lock is the operating system's, so it ends with its holder, however that ends. Object
    stores have none: two runs there both finish, with identical bytes.

    ``owned`` is the pattern of its shards and of other files that its writers make; unfinished
    files of other names are somebody else's, and stay.

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
        now = datetime.now().astimezone().isoformat(timespec="seconds")
        writer = f"process {os.getpid()} on {socket.gethostname()}, since {now}"
        try:
            folder.publish(WRITER, writer.encode())
            yield
        finally:
            with suppress(ProlearnError):
                folder.remove(WRITER)


def _unfinished(folder: Path, owned: re.Pattern[str]) -> list[str]:
    found = []
    for path in (path for place in PLACES for path in folder.glob(f"{place}.*.tmp")):
        target = unfinished(path)
        name = target and target.relative_to(folder).as_posix()
        if name and owned.fullmatch(name) and path.is_file():
            found.append(path.relative_to(folder).as_posix())
    return found


def _locked(folder: Folder, path: Path) -> AbstractContextManager[object]:
    try:
        path.mkdir(parents=True, exist_ok=True)
        return FileLock(path / LOCK, timeout=0).acquire()
    except Timeout as error:
        holder = "another process"
        with suppress(OSError):
            holder = folder.read(WRITER).decode()
        raise InputError(
            f"{folder} is being written by {holder}; wait for it or give another folder."
        ) from error
    except (OSError, NotImplementedError) as error:
        raise ProlearnError(
            f"{folder} cannot be written to ({error}); give a folder that can."
        ) from error
