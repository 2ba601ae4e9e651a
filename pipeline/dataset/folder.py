"""The folder of a dataset, on this machine or wherever else a URL leads."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa

from pipeline.errors import ProlearnError
from pipeline.files import PREFIX, SUFFIX, published

Where = str | Path
"""A path, or a URL such as s3://bucket/n10."""

Stamp = tuple[int, int]
"""Size in bytes and time of the last change in ns: a file with the same ones has not changed."""


class Folder(ABC):
    """Files by their name inside a folder; what is written appears whole or not at all."""

    @abstractmethod
    def __str__(self) -> str:
        """The folder as it was given."""

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
    """
    if isinstance(where, Folder):
        return where
    if "://" in str(where):
        from pipeline.dataset.remote import RemoteFolder  # Arrow's filesystems, for URLs alone

        return RemoteFolder.at(str(where))
    return LocalFolder(Path(where))


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
            f"{name} cannot be written to {folder} ({reason(error)}); what was there is intact: "
            "make room or give a folder that can be written to, and run the same command again."
        ) from error


def reason(error: OSError) -> str:
    """What the operating system, or a store, says is wrong."""
    return (error.strerror or str(error)).splitlines()[0]
