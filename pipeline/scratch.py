"""Folders for temporary files, removed at the end or, after a kill, by the next command."""

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pipeline.liveness import clear_dead, living

PREFIX = "prolearn-scratch-"


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """A temporary folder for the block; those of processes that were killed are removed first."""
    clear_scratch()
    place = Path(tempfile.gettempdir())
    with living(place, PREFIX) as name:
        folder = place / name
        folder.mkdir(mode=0o700)
        try:
            yield folder
        finally:
            shutil.rmtree(folder)


def clear_scratch() -> None:
    """Remove the temporary folders of processes that were killed."""
    place = Path(tempfile.gettempdir())

    def remove(name: str) -> None:
        if (place / name).exists():
            shutil.rmtree(place / name)

    clear_dead(place, PREFIX, remove)


@contextmanager
def temporary_files_in(folder: Path) -> Iterator[None]:
    """Let libraries that make temporary files in the block make them in a folder."""
    before = tempfile.tempdir
    tempfile.tempdir = str(folder)
    try:
        yield
    finally:
        tempfile.tempdir = before
