"""The folder of a dataset, on this machine or wherever else a URL leads."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pyarrow import fs

from pipeline.errors import ProlearnError
from pipeline.files import published, unfinished
from pipeline.storage.filesystem import filesystem_of, path_of, reason
from pipeline.urls import public_url

Where = str | Path
"""A path, or a URL such as s3://bucket/n10."""

Stamp = tuple[int, int]
"""Size in bytes and time of the last change in ns: a file with the same ones has not changed."""


@dataclass(frozen=True)
class Folder:
    """Files by their name inside a folder.

    Attributes:
        url: path or URL as it was given, secrets and all.
        files: Arrow's filesystem, from the folder on; it knows the secrets too.
        local: the path on this machine, where files can be renamed and locked, or None.
    """

    url: str = field(repr=False)
    files: Any = field(repr=False)
    local: Path | None = None

    def __str__(self) -> str:
        """The folder as it was given, without the secrets of a URL."""
        return str(self.local or public_url(self.url))

    def told(self, error: Exception) -> str:
        """What is wrong, without the secrets of the folder's URL."""
        return reason(error, self.url)

    def is_there(self) -> bool:
        """Whether the folder exists."""
        return self._info("").type == fs.FileType.Directory

    def names(self) -> list[str]:
        """Every file in it and below, in order; unfinished ones are left out."""
        if self.local:  # not by Arrow, which follows links to folders, round in circles too
            paths = [path for path in self.local.rglob("*") if path.is_file()]
            found = [path.relative_to(self.local).as_posix() for path in paths]
        else:
            every = fs.FileSelector("", allow_not_found=True, recursive=True)
            with self._reaching():
                infos = [info for info in self.files.get_file_info(every) if info.is_file]
            found = [info.path.lstrip("/") for info in infos]
        return sorted(name for name in found if not unfinished(Path(name)))

    def top(self) -> list[str]:
        """Names of files and folders right inside it, in order."""
        inside = fs.FileSelector("", allow_not_found=True)
        with self._reaching():
            return sorted(info.base_name for info in self.files.get_file_info(inside))

    def exists(self, name: str) -> bool:
        """Whether a file is there."""
        return self._info(name).is_file

    def size(self, name: str) -> int:
        """A file's size in bytes."""
        return int(self._info(name).size or 0)

    def stamp(self, name: str) -> Stamp | None:
        """A file's size and last change, or None where it is not there or the store keeps none."""
        info = self._info(name)
        known = info.is_file and info.size is not None and info.mtime_ns
        return (info.size, info.mtime_ns) if known else None

    def read(self, name: str) -> bytes:
        """A file's content.

        Raises:
            OSError: where it cannot be read.
        """
        with self._telling(), self.files.open_input_file(name) as file:
            return file.read()

    def opened(self, name: str) -> Any:
        """A file for Arrow to read parts of.

        Raises:
            OSError: where it cannot be read.
        """
        with self._telling():
            return self.files.open_input_file(name)

    def publish(self, name: str, content: bytes) -> None:
        """Put a file there: on this machine by a rename, whole and flushed, elsewhere by one put.

        On object stores a put makes a file visible, whole. Others have no atomic rename that Arrow
        reaches: a file may be seen while it is written, and its digest is then not the manifest's.

        Raises:
            ProlearnError: where the folder cannot be written to; what was there is intact.
        """
        with self._writing(name):
            if self.local:
                with published(self.local / name) as temporary:
                    temporary.write_bytes(content)
                return
            self._make_above(name)
            with self.files.open_output_stream(name) as file:
                file.write(content)

    def remove(self, name: str) -> None:
        """Remove a file.

        Raises:
            ProlearnError: where the folder cannot be written to.
        """
        with self._writing(name):
            self.files.delete_file(name)

    def move(self, name: str, to: str) -> None:
        """Give a file another name, whatever it holds and whoever may read it.

        Raises:
            ProlearnError: where the folder cannot be written to.
        """
        with self._writing(to):
            self._make_above(to)
            self.files.move(name, to)

    def _make_above(self, name: str) -> None:
        above = f"{self.files.base_path}{name}".rpartition("/")[0]
        self.files.base_fs.create_dir(above, recursive=True)

    def _info(self, name: str) -> Any:
        with self._reaching():
            return self.files.get_file_info(name)

    def _reaching(self) -> AbstractContextManager[None]:
        return self._telling(lambda told: f"{self} is not reached ({told}).")

    def _writing(self, name: str) -> AbstractContextManager[None]:
        return self._telling(
            lambda told: (
                f"{name} cannot be written to {self} ({told}); what was there is intact: "
                "make room or give a folder that can be written to, and run the same command again."
            )
        )

    @contextmanager
    def _telling(self, sentence: Callable[[str], str] | None = None) -> Iterator[None]:
        """Whatever a library raises, told without secrets, as OSError where there is no sentence.

        The original is not in the chain, since it may have secrets.
        """
        try:
            yield
        except Exception as error:
            told, number = self.told(error), getattr(error, "errno", None)
            if sentence:
                raise ProlearnError(sentence(told)) from None
            raise (OSError(number, told) if number else OSError(told)) from None


def open_folder(where: Where | Folder) -> Folder:
    """The folder at a path or URL, which need not exist yet.

    Raises:
        InputError: for a URL that leads nowhere.
        ProlearnError: where what it leads to is not reached.
    """
    if isinstance(where, Folder):
        return where
    url = str(where)
    if url.lower().startswith("file://"):
        return open_folder(path_of(url))
    if "://" in url:
        files, root = filesystem_of(url)
        return Folder(url, fs.SubTreeFileSystem(root, files))
    path = Path(where)
    return Folder(str(path), fs.SubTreeFileSystem(str(path), fs.LocalFileSystem()), path)
