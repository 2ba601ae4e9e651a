"""Blank figure files, for tests of everything but the figures.

To lay out and draw all figures of a report takes longer than all else that it needs.
"""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from pipeline.figures.style import save

if TYPE_CHECKING:
    import pytest

SAVE = ("cli.jobs.run_tables.save", "pipeline.report.save", "registry.training.save_figure")
"""What writes figures, where each is called."""


def leave_blank(patch: "pytest.MonkeyPatch | None" = None) -> None:
    """Write blank figures until the patch is undone, or in a process of its own to its end."""
    for name in SAVE:
        if patch:
            patch.setattr(name, save_blank)
        else:
            module, _, function = name.rpartition(".")
            setattr(import_module(module), function, save_blank)


def save_blank(_: Figure, path: Path, *suffixes: list[str]) -> None:
    """Save a blank figure in place of the given one."""
    save(Figure(), path, *suffixes)
