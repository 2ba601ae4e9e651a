"""Dataset folders behind a URL: on object stores, in memory, wherever Arrow or fsspec reaches."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import fsspec
import pyarrow as pa
from pyarrow import fs

from pipeline.dataset.storage.folder import Folder, Stamp, reason, writing
from pipeline.errors import InputError, ProlearnError
from pipeline.urls import public, public_url


@dataclass(frozen=True)
class RemoteFolder(Folder):
    """A folder on a filesystem of Arrow or fsspec.

    On object stores one put makes a file visible, whole. Others have no atomic rename that Arrow
    reaches: a file may be seen while it is written, and its digest is then not the manifest's.

    Attributes:
        url: as it was given, secrets and all.
        files: Arrow's filesystem.
        root: the folder's path there, in which secrets may be left.
    """

    url: str = field(repr=False)
    files: Any = field(repr=False)
    root: str = field(repr=False)

    @classmethod
    def at(cls, url: str) -> "RemoteFolder":
        """The folder of a URL, by Arrow's own filesystems or else by fsspec's.

        Raises:
            InputError: where neither knows the kind of URL.
            ProlearnError: where it is not reached.
        """
        try:
            return cls(url, *fs.FileSystem.from_uri(url))
        except (pa.ArrowInvalid, pa.ArrowNotImplementedError):
            pass
        except OSError as error:
            raise _not_reached(url, error) from None
        try:
            found, root = fsspec.url_to_fs(url)
        except OSError as error:
            raise _not_reached(url, error) from None
        except (ValueError, ImportError) as error:
            raise InputError(
                f"{public_url(url)} is on no known filesystem ({public(error, url)}); expected a "
                "path, or a URL that pyarrow or fsspec reads."
            ) from None
        return cls(url, fs.PyFileSystem(fs.FSSpecHandler(found)), root)

    def __str__(self) -> str:
        return public_url(self.url)

    def told(self, error: Exception) -> str:
        """What is wrong, without the secrets of the folder's URL."""
        return reason(error, self.url)

    def is_there(self) -> bool:
        """Whether the folder exists."""
        return self._type(self.root) == fs.FileType.Directory

    def names(self) -> list[str]:
        """Every file in it and below, in order."""
        below = fs.FileSelector(self.root, allow_not_found=True, recursive=True)
        with self._reaching():
            found = self.files.get_file_info(below)
        top = self.root.strip("/") + "/"
        return sorted(
            info.path.lstrip("/").removeprefix(top)
            for info in found
            if info.type == fs.FileType.File
        )

    def exists(self, name: str) -> bool:
        """Whether a file is there."""
        return self._type(self._path(name)) == fs.FileType.File

    def stamp(self, name: str) -> Stamp | None:
        """A file's size and last change, or None where it is not there or the store keeps none."""
        with self._reaching():
            info = self.files.get_file_info(self._path(name))
        known = info.type == fs.FileType.File and info.size is not None and info.mtime_ns
        return (info.size, info.mtime_ns) if known else None

    def read(self, name: str) -> bytes:
        """A file's content."""
        with self._telling(), self._open(name) as file:
            return file.read()

    def opened(self, name: str) -> Any:
        """A file for Arrow to read parts of."""
        with self._telling():
            return self._open(name)

    def publish(self, name: str, content: bytes) -> None:
        """Put the file with one write."""
        path = self._path(name)
        with writing(self, name), self._telling():
            self.files.create_dir(path.rpartition("/")[0], recursive=True)
            with self.files.open_output_stream(path) as file:
                file.write(content)

    def remove(self, name: str) -> None:
        """Remove a file."""
        with writing(self, name), self._telling():
            self.files.delete_file(self._path(name))

    def _path(self, name: str) -> str:
        return f"{self.root.rstrip('/')}/{name}"

    def _type(self, path: str) -> Any:
        with self._reaching():
            return self.files.get_file_info(path).type

    def _open(self, name: str) -> Any:
        return self.files.open_input_file(self._path(name))

    @contextmanager
    def _reaching(self) -> Iterator[None]:
        try:
            with self._telling():
                yield
        except OSError as error:
            raise _not_reached(self.url, error) from error

    @contextmanager
    def _telling(self) -> Iterator[None]:
        """Whatever a library raises, as an OSError without secrets, in its chain neither."""
        try:
            yield
        except Exception as error:
            told = self.told(error)
            number = getattr(error, "errno", None)
            raise (OSError(number, told) if number else OSError(told)) from None


def _not_reached(url: str, error: Exception) -> ProlearnError:
    return ProlearnError(f"{public_url(url)} is not reached ({reason(error, url)}).")
