"""The folder of a dataset, on this machine or wherever else a URL leads."""

import os
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote_to_bytes

import pyarrow as pa

from pipeline.errors import InputError, ProlearnError
from pipeline.files import PREFIX, SUFFIX, published
from pipeline.urls import public, public_url

Where = str | Path
"""A path, or a URL such as s3://bucket/n10."""

Stamp = tuple[int, int]
"""Size in bytes and time of the last change in ns: a file with the same ones has not changed."""


class Folder(ABC):
    """Files by their name inside a folder.

    What is written appears whole or not at all wherever the filesystem can do that.
    """

    @abstractmethod
    def __str__(self) -> str:
        """The folder as it was given, without the secrets of a URL."""

    def told(self, error: Exception) -> str:
        """What is wrong, without the secrets of the folder's URL."""
        return reason(error)

    @abstractmethod
    def is_there(self) -> bool:
        """Whether the folder exists."""

    @abstractmethod
    def names(self) -> list[str]:
        """Every file in it and below, in order; unfinished ones are left out."""

    @abstractmethod
    def exists(self, name: str) -> bool:
        """Whether a file is there."""

    @abstractmethod
    def stamp(self, name: str) -> Stamp | None:
        """A file's size and last change, or None where it is not there or that is not known."""

    @abstractmethod
    def read(self, name: str) -> bytes:
        """A file's content.

        Raises:
            OSError: where it cannot be read.
        """

    @abstractmethod
    def opened(self, name: str) -> Any:
        """A file for Arrow to read parts of.

        Raises:
            OSError: where it cannot be read.
        """

    @abstractmethod
    def publish(self, name: str, content: bytes) -> None:
        """Put a file there, whole.

        Raises:
            ProlearnError: where the folder cannot be written to; what was there is intact.
        """

    @abstractmethod
    def remove(self, name: str) -> None:
        """Remove a file.

        Raises:
            ProlearnError: where the folder cannot be written to.
        """


@dataclass(frozen=True)
class LocalFolder(Folder):
    """A folder of this machine, or mounted on it."""

    path: Path

    def __str__(self) -> str:
        return str(self.path)

    def is_there(self) -> bool:
        """Whether the folder exists."""
        return self.path.is_dir()

    def names(self) -> list[str]:
        """Every file in it and below, in order; unfinished ones are left out."""
        return sorted(name for name in self._all() if not _is_unfinished(name))

    def exists(self, name: str) -> bool:
        """Whether a file is there."""
        return (self.path / name).is_file()

    def stamp(self, name: str) -> Stamp | None:
        """A file's size and last change, or None where it is not there."""
        try:
            found = (self.path / name).stat()
        except OSError:
            return None
        return found.st_size, found.st_mtime_ns

    def read(self, name: str) -> bytes:
        """A file's content."""
        return (self.path / name).read_bytes()

    def opened(self, name: str) -> Any:
        """A file for Arrow to read parts of."""
        return pa.OSFile(str(self.path / name))

    def publish(self, name: str, content: bytes) -> None:
        """Write beside the place, flush to disk, rename."""
        with writing(self, name), published(self.path / name) as temporary:
            temporary.write_bytes(content)

    def remove(self, name: str) -> None:
        """Remove a file."""
        with writing(self, name):
            (self.path / name).unlink(missing_ok=True)

    def sweep(self) -> None:
        """Remove what writers that were killed left unfinished."""
        for name in filter(_is_unfinished, list(self._all())):
            self.remove(name)

    def _all(self) -> Iterator[str]:
        paths = (path for path in self.path.rglob("*") if path.is_file())
        return (path.relative_to(self.path).as_posix() for path in paths)


def open_folder(where: Where | Folder) -> Folder:
    """The folder at a path or URL, which need not exist yet.

    Raises:
        InputError: for a URL that leads nowhere.
        ProlearnError: where what it leads to is not reached.
    """
    if isinstance(where, Folder):
        return where
    if str(where).lower().startswith("file://"):
        return LocalFolder(_path_of(str(where)))
    if "://" in str(where):
        from pipeline.dataset.storage.remote import (
            RemoteFolder,  # Arrow's filesystems, for URLs alone
        )

        return RemoteFolder.at(str(where))
    return LocalFolder(Path(where))


def _path_of(url: str) -> Path:
    """The path in a file:// URL of this machine.

    Raises:
        InputError: where it is of another machine, or no path.
    """
    host, slash, path = url.partition("://")[2].partition("/")
    if host.lower() not in ("", "localhost") or not slash:
        raise InputError(
            f"{public_url(url)} is not on this machine; expected file:///FOLDER, or a URL of a "
            "filesystem that pyarrow or fsspec reaches."
        )
    if "?" in path or "#" in path:
        raise InputError(
            f"{public_url(url)} goes on with ? or #; expected file:///FOLDER, where these two are "
            "written %3F and %23."
        )
    return Path(slash + os.fsdecode(unquote_to_bytes(path)))


def _is_unfinished(name: str) -> bool:
    last = name.rpartition("/")[2]
    return last.startswith(PREFIX) and last.endswith(SUFFIX)


@contextmanager
def writing(folder: Folder, name: str) -> Iterator[None]:
    """Turn a failure to write into a sentence.

    Raises:
        ProlearnError: naming the file, the reason and what to do.
    """
    try:
        yield
    except OSError as error:
        raise ProlearnError(
            f"{name} cannot be written to {folder} ({folder.told(error)}); what was there is "
            "intact: make room or give a folder that can be written to, and run the same command "
            "again."
        ) from error


def reason(error: Exception, *urls: str) -> str:
    """What the operating system, or a store, says is wrong, without the secrets of URLs."""
    said = getattr(error, "strerror", None) or str(error)
    return public(next(iter(said.strip().splitlines()), type(error).__name__), *urls)
