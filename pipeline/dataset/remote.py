"""Dataset folders behind a URL: on object stores, in memory, wherever Arrow or fsspec reaches."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import fsspec
import pyarrow as pa
from pyarrow import fs

from pipeline.dataset.folder import Folder, Stamp, reason, writing
from pipeline.errors import InputError, ProlearnError


@dataclass(frozen=True)
class RemoteFolder(Folder):
    """A folder on a filesystem of Arrow or fsspec, where a single put makes a file visible."""

    url: str
    files: Any
    root: str

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
            raise ProlearnError(f"{_public(url)} is not reached ({reason(error)}).") from error
        try:
            found, root = fsspec.url_to_fs(url)
        except (ValueError, ImportError) as error:
            raise InputError(
                f"{_public(url)} is on no known filesystem ({error}); expected a path, or a URL "
                "that pyarrow or fsspec reads."
            ) from error
        return cls(url, fs.PyFileSystem(fs.FSSpecHandler(found)), root)

    def __str__(self) -> str:
        return _public(self.url)

    def is_there(self) -> bool:
        """Whether the folder exists."""
        return self._type(self.root) == fs.FileType.Directory

    def names(self) -> list[str]:
        """Every file in it and below, in order."""
        below = fs.FileSelector(self.root, allow_not_found=True, recursive=True)
        with _reaching(self.url):
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
        with _reaching(self.url):
            info = self.files.get_file_info(self._path(name))
        known = info.type == fs.FileType.File and info.size is not None and info.mtime_ns
        return (info.size, info.mtime_ns) if known else None

    def read(self, name: str) -> bytes:
        """A file's content."""
        with self.opened(name) as file:
            return file.read()

    def opened(self, name: str) -> Any:
        """A file for Arrow to read parts of."""
        return self.files.open_input_file(self._path(name))

    def publish(self, name: str, content: bytes) -> None:
        """Put the file with one write, which the filesystem makes visible when it is complete."""
        path = self._path(name)
        with writing(self, name):
            self.files.create_dir(path.rpartition("/")[0], recursive=True)
            with self.files.open_output_stream(path) as file:
                file.write(content)

    def remove(self, name: str) -> None:
        """Remove a file."""
        with writing(self, name):
            self.files.delete_file(self._path(name))

    def _path(self, name: str) -> str:
        return f"{self.root.rstrip('/')}/{name}"

    def _type(self, path: str) -> Any:
        with _reaching(self.url):
            return self.files.get_file_info(path).type


def _public(url: str) -> str:
    """A URL without the secret that it may carry."""
    return re.sub(r"//[^/@]*@", "//", url)


@contextmanager
def _reaching(url: str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise ProlearnError(f"{_public(url)} is not reached ({reason(error)}).") from error
