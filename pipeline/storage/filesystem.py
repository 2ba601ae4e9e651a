"""Where the URL of a folder leads: to a path of this machine, or to a filesystem elsewhere."""

import os
from pathlib import Path
from typing import Any
from urllib.parse import unquote_to_bytes

import pyarrow as pa
from pyarrow import fs

from pipeline.errors import InputError, ProlearnError
from pipeline.urls import public, public_url


def path_of(url: str) -> Path:
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


def filesystem_of(url: str) -> tuple[Any, str]:
    """Arrow's own filesystem for a URL, or else fsspec's, and the folder's path there.

    Raises:
        InputError: where neither knows the kind of URL.
        ProlearnError: where it is not reached.
    """
    try:
        try:
            return fs.FileSystem.from_uri(url)
        except (pa.ArrowInvalid, pa.ArrowNotImplementedError):
            import fsspec  # for kinds of URL alone that Arrow does not know

            files, root = fsspec.url_to_fs(url)
            return fs.PyFileSystem(fs.FSSpecHandler(files)), root
    except OSError as error:
        told = reason(error, url)
        raise ProlearnError(f"{public_url(url)} is not reached ({told}).") from None
    except (ValueError, ImportError) as error:
        raise InputError(
            f"{public_url(url)} is on no known filesystem ({public(error, url)}); expected a "
            "path, or a URL that pyarrow or fsspec reads."
        ) from None


def reason(error: Exception, url: str) -> str:
    """What the operating system, or a store, says is wrong, without the secrets of a URL."""
    said = getattr(error, "strerror", None) or str(error)
    return public(next(iter(said.strip().splitlines()), type(error).__name__), url)
