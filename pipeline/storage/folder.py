"""A folder of files, on this machine or behind a URL."""

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import unquote, unquote_to_bytes

import pyarrow as pa
from pyarrow import fs

from pipeline.errors import InputError, ProlearnError
from pipeline.files import (
    make_folder,
    path_of,
    published,
    refuse_stdio,
    refuse_undecodable,
    unfinished,
)
from pipeline.text import first_line, public, public_url

Where = str | Path  # a path, or a URL such as s3://bucket/n10

# Schemes left to Arrow; not abfs, for which fsspec also takes an account from the environment
ARROW_SCHEMES = ("s3", "gs", "gcs", "hdfs", "viewfs")
GCS_SECONDS = 30  # of retries, which no signal ends and which Arrow continues for minutes

WITHOUT_FOLDERS = ("s3", "gcs", "abfs")  # Arrow's filesystems where no folder need be created

Stamp = tuple[int, int]  # size in bytes and time of the last change in ns


@dataclass(frozen=True)
class Folder:
    """A folder whose files are named by their path in it; no message has its URL's secrets."""

    url: str = field(repr=False)  # path or URL as it was given, secrets included
    files: Any = field(repr=False)  # Arrow's filesystem below the folder
    local: Path | None = None  # its path if on this machine, where files can be locked

    def __str__(self) -> str:
        return str(self.local or public_url(self.url))

    @property
    def address(self) -> str:
        """Absolute path or URL, by which processes with another current folder open it."""
        return str(self.local.absolute()) if self.local else self.url

    def reason(self, error: Exception) -> str:
        """What is wrong, without the secrets of the folder's URL."""
        return _reason(error, self.url)

    def is_present(self) -> bool:
        """Whether the folder exists."""
        return self._info("").type == fs.FileType.Directory

    def names(self) -> list[str]:
        """Every finished file in it and below, sorted, save keys with empty parts, as in a//b."""
        if self.local:  # not by Arrow, which follows links to folders, even in endless circles
            paths = [path for path in self.local.rglob("*") if path.is_file()]
            found = [path.relative_to(self.local).as_posix() for path in paths]
        else:
            found = [info.path for info in self._listed(recursive=True) if info.is_file]
            if self.files.base_fs.type_name in WITHOUT_FOLDERS:  # Arrow lists such keys, no more
                found = [key for key in found if "" not in key.split("/")]
            found = [name.lstrip("/") for name in found]
            if self.url.startswith(("http://", "https://")):  # where names are parts of links
                found = [unquote(name) for name in found]
        return sorted(name for name in found if not unfinished(Path(name)))

    def top(self) -> list[str]:
        """Names of files and folders directly inside it, sorted."""
        if self.local is None:
            return sorted(info.base_name for info in self._listed(recursive=False))
        with self._reaching():  # not by Arrow, which fails at names that are not UTF-8
            there = self.local.iterdir() if self.local.is_dir() else ()
            return sorted(path.name for path in there)

    def exists(self, name: str) -> bool:
        """Whether a file is there."""
        if self.local is None:
            return bool(self._info(name).is_file)
        with self._reaching():
            return (self.local / name).is_file()

    def size(self, name: str) -> int:
        """A file's size in bytes."""
        return int(self._info(name).size or 0)

    def stamp(self, name: str) -> Stamp | None:
        """A file's size and last change; None where it is missing or the store keeps none."""
        info = self._info(name)
        known = info.is_file and info.size is not None and info.mtime_ns
        return (info.size, info.mtime_ns) if known else None

    def read(self, name: str) -> bytes:
        """A file's content; OSError where it cannot be read."""
        with self._without_secrets(), self.files.open_input_file(name) as file:
            return file.read()

    def publish(self, name: str, content: bytes) -> None:
        """Write a file: on this machine by a rename, whole and flushed, elsewhere by one put.

        On object stores a put makes the whole file visible at once. For other stores Arrow has no
        atomic rename: a half-written file may be seen, whose digest is then not the manifest's.
        ProlearnError where the folder cannot be written to; what was there is intact.
        """
        with self._writing(name):
            if self.local:
                with published(self.local / name) as temporary:
                    temporary.write_bytes(content)
                return
            self._make_parent(name)
            with self.files.open_output_stream(name) as file:
                file.write(content)

    def remove(self, name: str) -> None:
        """Remove a file; ProlearnError where the folder cannot be written to."""
        with self._writing(name):
            self.files.delete_file(name)

    def move(self, name: str, to: str) -> None:
        """Move a file; ProlearnError where the folder cannot be written to."""
        with self._writing(to):
            if self.local:
                make_folder((self.local / to).parent)
                shutil.move(self.local / name, self.local / to)  # links may lead to other disks
                return
            self._make_parent(to)
            self.files.move(name, to)

    def _listed(self, *, recursive: bool) -> list[Any]:
        """List a folder's entries, or all below it, as Arrow's FileInfo; empty if it is missing."""
        inside = fs.FileSelector("", allow_not_found=True, recursive=recursive)
        with self._reaching():
            try:
                return list(self.files.get_file_info(inside))
            except NotADirectoryError:  # what fsspec calls a page of the web without links
                return []

    def _make_parent(self, name: str) -> None:
        if self.files.base_fs.type_name in WITHOUT_FOLDERS:
            return
        above = f"{self.files.base_path}{name}".rpartition("/")[0]
        self.files.base_fs.create_dir(above, recursive=True)

    def _info(self, name: str) -> Any:
        with self._reaching():
            return self.files.get_file_info(name)

    def _reaching(self) -> AbstractContextManager[None]:
        return self._without_secrets(lambda reason: f"{self} is not reached ({reason}).")

    def _writing(self, name: str) -> AbstractContextManager[None]:
        return self._without_secrets(
            lambda reason: (
                f"{name} cannot be written to {self} ({reason}); what was there is intact: "
                "make room or give a folder that can be written to, and run the same command again."
            )
        )

    @contextmanager
    def _without_secrets(self, sentence: Callable[[str], str] | None = None) -> Iterator[None]:
        """Turn errors of libraries into ProlearnErrors or OSErrors without the URL's secrets."""
        try:
            yield
        except NotImplementedError:  # as of the web, which can only be read
            raise InputError(
                f"{self} is of a kind that cannot be written to; expected a folder, or a bucket "
                "such as s3://bucket/folder: give one of these."
            ) from None
        except Exception as error:
            reason, number = self.reason(error), getattr(error, "errno", None)
            if sentence:
                raise ProlearnError(sentence(reason)) from None
            raise (OSError(number, reason) if number else OSError(reason)) from None


def open_folder(where: Where | Folder) -> Folder:
    """The folder at a path or URL, which need not exist yet; InputError for an unknown kind."""
    if isinstance(where, Folder):
        return where
    url = str(where)
    if url.lower().startswith("file://"):
        return open_folder(_local_path(url))
    scheme, mark, rest = url.partition("://")
    if mark:
        url = f"{scheme.lower()}://{rest}"
        files, root = _filesystem(url)
        return Folder(url, fs.SubTreeFileSystem(root, files))
    path = path_of(where)
    refuse_stdio(path)
    refuse_undecodable(path)
    # Arrow takes a:b, without a slash before the colon, for a URI and aborts the process.
    base = str(path) if path.is_absolute() else f"./{path}"
    return Folder(str(path), fs.SubTreeFileSystem(base, fs.LocalFileSystem()), path)


def _local_path(url: str) -> Path:
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
    return Path(slash + os.fsdecode(unquote_to_bytes(os.fsencode(path))))


def _filesystem(url: str) -> tuple[Any, str]:
    """Arrow's own filesystem for a URL, or else fsspec's, and the folder's path there."""
    scheme, limited = url.partition("://")[0], url
    if scheme in ("gs", "gcs") and "retry_limit_seconds=" not in url:
        limited += f"{'&' if '?' in url else '?'}retry_limit_seconds={GCS_SECONDS}"
    # Else S3 gets checksums among the content, where servers that do not know them leave them.
    os.environ.setdefault("AWS_REQUEST_CHECKSUM_CALCULATION", "when_required")
    try:
        try:
            return fs.FileSystem.from_uri(limited)
        except (pa.ArrowInvalid, pa.ArrowNotImplementedError) as error:
            if scheme in ARROW_SCHEMES and isinstance(error, pa.ArrowInvalid):
                raise InputError(
                    f"{public_url(url)} is no URL that pyarrow reads ({_reason(error, url)}); "
                    "expected one with settings that pyarrow knows."
                ) from None
            if url.startswith("ftp:///"):  # of which fsspec prints a traceback besides
                raise InputError(
                    f"{public_url(url)} names no server; expected ftp://SERVER/FOLDER."
                ) from None
            import fsspec  # only for kinds of URL that Arrow does not know

            files, root = fsspec.url_to_fs(url)
            return fs.PyFileSystem(fs.FSSpecHandler(files)), root
    except InputError:
        raise
    except OSError as error:
        raise ProlearnError(f"{public_url(url)} is not reached ({_reason(error, url)}).") from None
    except ImportError as error:
        raise InputError(
            f"{public_url(url)} needs a package that is not installed ({public(error, url)}); "
            "expected it, or another place: install it, or give a path or an s3:// URL."
        ) from None
    except Exception as error:  # whatever a package raises of a URL without what it needs
        raise InputError(
            f"{public_url(url)} is on no known filesystem ({public(error, url)}); expected a "
            "path, or a URL that pyarrow or fsspec reads."
        ) from None


def _reason(error: Exception, url: str) -> str:
    """The first line of an error of the operating system or a store, without a URL's secrets."""
    return public(first_line(getattr(error, "strerror", None) or error), url)
