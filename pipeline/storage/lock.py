"""One writer of a dataset folder at a time."""

import os
import socket
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from datetime import datetime
from pathlib import Path

from filelock import FileLock, Timeout

from pipeline.errors import InputError, ProlearnError
from pipeline.files import UNFINISHED
from pipeline.storage.folder import Folder
from pipeline.storage.layout import LOCK, WRITER


@contextmanager
def sole_writer(folder: Folder) -> Iterator[None]:
    """Hold a folder for writing, and clear away what killed writers left unfinished.

    The lock is the operating system's, so it ends with its holder, however that ends. Object
    stores have none: there two runs both finish, with identical bytes.

    Raises:
        InputError: where another process holds it.
        ProlearnError: where the folder cannot be written to.
    """
    if folder.local is None:
        yield
        return
    with _locked(folder, folder.local):
        for left in [path for path in folder.local.rglob(UNFINISHED) if path.is_file()]:
            folder.remove(left.relative_to(folder.local).as_posix())
        try:
            folder.publish(WRITER, _whoami().encode())
            yield
        finally:
            with suppress(ProlearnError):
                folder.remove(WRITER)


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
