"""Files of figures on which nothing is drawn, for tests of what goes with them.

To lay out and draw all figures of a report takes longer than all else that it needs.
"""

import pytest
from matplotlib.figure import Figure

from pipeline.figures.style import save

SAVE = ("cli.jobs.run_tables.save", "pipeline.report.save", "registry.training.save_figure")
"""What writes figures, where each is called."""


def leave_blank(patch: pytest.MonkeyPatch) -> None:
    """Write blank figures until the patch is undone."""
    for name in SAVE:
        patch.setattr(name, lambda _, *files: save(Figure(), *files))
