"""Files that appear whole or not at all."""

import contextlib
import csv
import os
import re
import sys
from collections.abc import Iterable, Iterator
from io import BytesIO, StringIO, TextIOWrapper
from math import isnan
from pathlib import Path
from typing import Any, BinaryIO
from uuid import uuid4

from pipeline.errors import InputError, check_kind
from pipeline.text import public_url, visible

STDIO = Path("-")  # instead of a file: standard input or standard output
PIECE = 2**20  # bytes that are read at once
DATASET = "_manifest.json", "_scenarios"  # what every dataset's folder holds
# Names of unfinished files: the name of the file and a unique token
_UNFINISHED = re.compile(r"\.(.+)\.[0-9a-f]{32}\.tmp", re.DOTALL)
_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:")  # with which a URL begins; not a drive's letter


def path_of(given: str | os.PathLike[str]) -> Path:
    """Convert text or a path to a Path; InputError for anything else."""
    check_kind("path", given, str | os.PathLike)
    if "\0" in os.fspath(given):
        raise InputError(f"path is {given!r}; expected one without a null character.")
    return Path(given)


def refuse_url(path: Path) -> None:
    """Raise InputError for a URL, which as a path is a folder named by its scheme."""
    scheme, *rest = path.parts or ("",)
    if _SCHEME.fullmatch(scheme):
        url = public_url(f"{scheme}//{'/'.join(rest)}")
        raise InputError(f"{url} is a URL; expected a path on this machine.")


def unfinished(path: Path) -> Path | None:
    """The final path of a temporary file of ours, or None for any other file."""
    found = _UNFINISHED.fullmatch(path.name)
    return path.with_name(found[1]) if found else None


def refuse_stdio(path: Path) -> None:
    """Refuse the path -, which means standard input or output, with an InputError."""
    if path.parts[:1] == STDIO.parts:
        raise InputError("'-' is standard input or output; expected the name of a file or folder.")


def make_folder(folder: Path) -> None:
    """Make a folder and those above it.

    InputError where one of them is a file, for a URL, and for standard output.
    """
    refuse_url(folder)
    refuse_stdio(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        raise InputError(f"{lowest_existing(folder)} is a file; expected a folder.") from error


def lowest_existing(folder: Path) -> Path:
    """The folder itself if it exists, or its lowest parent that does."""
    return next(path for path in (folder, *folder.parents) if os.path.lexists(path))


@contextlib.contextmanager
def _named(name: object) -> Iterator[None]:
    """Add a file's name to an OSError of the block that has none, as of a full disk."""
    try:
        yield
    except OSError as error:
        if error.errno is not None and error.filename is None:
            error.filename = str(name)
        raise


def refuse_special(path: Path) -> None:
    """Raise InputError for a pipe, a socket, a device or a URL, where no file can be written."""
    refuse_url(path)
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise InputError(
            f"{path} is a pipe, a socket or a device; expected the name of a file, or, where the "
            "command has it, standard output: give --out -."
        )


def refuse_dataset(path: Path) -> None:
    """Raise InputError for a place in a dataset's folder, where other files are foreign."""
    for folder in Path(os.path.realpath(path)).parents if path != STDIO else ():
        if all(os.path.lexists(folder / name) for name in DATASET):
            raise InputError(
                f"{path} is inside {folder}, which is a dataset's folder; expected another place, "
                "since `prolearn verify` takes all else there for foreign: name one outside."
            )


def refuse_undecodable(path: Path) -> None:
    """Raise InputError for a path that is not UTF-8, which some libraries cannot open."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise InputError(
            f"The name {path} is not UTF-8; expected one that is: rename it or give another."
        ) from None


def refuse_unwritable(path: Path) -> None:
    """Raise InputError or OSError where no file can or should be written, and leave no file."""
    refuse_dataset(path)
    target = _resolved(path)
    refuse_stdio(target.parent)
    folder = lowest_existing(target.parent)
    if not folder.is_dir():
        raise InputError(f"{folder} is a file; expected a folder.")
    temporary = folder / _temporary_name(target)
    try:
        temporary.touch()
    except OSError as error:
        error.filename = str(path)
        raise
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()


def _resolved(path: Path) -> Path:
    """A path with symbolic links followed; InputError where no file can be written there."""
    refuse_special(path)
    if path.is_symlink():
        path = Path(os.path.realpath(path))
        if path.is_symlink():
            raise InputError(f"{path} is a link that leads to itself; expected the name of a file.")
    if path.is_dir():
        raise InputError(f"{path} is a folder; expected the name of a file.")
    return path


def _temporary_name(path: Path) -> str:
    return f".{path.name}.{uuid4().hex}.tmp"


@contextlib.contextmanager
def published(path: Path) -> Iterator[Path]:
    """A temporary path beside ``path`` that takes its place, flushed to disk, on success.

    A reader sees the old file, or none, or the whole new one, whenever the writer is killed. A file
    that is replaced keeps its mode; of a symbolic link the file that it names is replaced.
    InputError where it is a folder, a pipe or a device, or its folder is a file.
    """
    path = _resolved(path)
    make_folder(path.parent)
    # Named here and made in the block: a file made before it would outlive an interrupt between.
    temporary = path.parent / _temporary_name(path)
    mode = path.stat().st_mode & 0o777 if path.exists() else None
    try:
        with _named(path):
            temporary.touch(0o666 if mode is None else mode | 0o600)  # less what umask takes away
            yield temporary
            _flush(temporary)
            if mode is not None:
                temporary.chmod(mode)
        temporary.replace(path)
        _flush(path.parent)
    finally:
        temporary.unlink(missing_ok=True)


def stem_of(path: Path) -> str:
    """A file's name without its suffix, or stdin."""
    return "stdin" if path == STDIO else path.stem


def read_bytes(path: Path, most: int) -> bytes:
    """The content of a file or of standard input, cut off after so many bytes."""
    if path == STDIO:
        if sys.stdin is None:
            raise InputError("stdin is closed; expected content in it: name a file instead of -.")
        return _up_to(sys.stdin.buffer, most)
    refuse_url(path)
    with path.open("rb") as file:
        return _up_to(file, most)


def _up_to(file: BinaryIO, most: int) -> bytes:
    """So many bytes of a file or fewer, in pieces: one read takes memory for all it asks for."""
    content = BytesIO()
    for start in range(0, most, PIECE):
        asked = min(PIECE, most - start)
        if content.write(file.read(asked)) < asked:
            break  # at its end; a terminal would be asked for more
    return content.getvalue()


def write_text(path: Path, text: str) -> None:
    """Write a text file that appears whole, or to standard output; both are in UTF-8."""
    if path == STDIO:
        if sys.stdout is None:
            raise InputError("stdout is closed; expected it to take a document: leave it open.")
        with _named("stdout"):
            sys.stdout.flush()
            if isinstance(sys.stdout, TextIOWrapper):  # in the locale's encoding, for people
                sys.stdout.buffer.write(text.encode())
            else:
                sys.stdout.write(text)
            sys.stdout.flush()
        return
    with published(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_rows(path: Path, names: Iterable[str], rows: Iterable[Iterable[Any]]) -> None:
    """Write a CSV file whole; None and NaN are empty, invisible characters escaped."""
    text = StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(map(visible, names))
    writer.writerows(map(_cell, row) for row in rows)
    write_text(path, text.getvalue())


def _cell(value: Any) -> Any:
    if isinstance(value, str):
        return visible(value)
    return None if isinstance(value, float) and isnan(value) else value


def _flush(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
