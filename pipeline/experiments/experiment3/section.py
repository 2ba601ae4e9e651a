"""The section on experiment 3: the paper's Figure 8 for the plain SCP and for the expert."""

from collections.abc import Mapping
from typing import Any

import pandas as pd

from pipeline.exhibits.blocks import Column, Picture, Table
from pipeline.exhibits.planners import label_name
from pipeline.exhibits.sections import Section
from pipeline.exhibits.style import Style
from pipeline.experiments import paper
from pipeline.experiments.experiment3 import summary
from pipeline.experiments.experiment3.figure import WHISKERS, optimizers_figure, warmstart_figure
from pipeline.experiments.experiment3.rows import EXPERT, OPTIMIZERS, PLAIN

SEED = Column("Seed", "name")
SOLVES = (summary.SOLVES, summary.ONE_SOLVE)

COLUMNS = {
    PLAIN: [
        *(SEED, *SOLVES, summary.MEAN, summary.DEVIATION, summary.MEDIAN, summary.TIME_RATIO),
        *(summary.GAP, summary.CLEAR, summary.SAFE),
    ],
    EXPERT: [
        *(Column("Stop", "rule"), SEED, *SOLVES, summary.MEDIAN, summary.TIME_RATIO),
        *(summary.GAP, summary.SAFE),
    ],
}
"""What the table of each optimizer shows."""


def section(warmstarts: pd.DataFrame, look: Mapping[str, Style]) -> Section:
    """Figure and table of each optimizer at each swarm size."""
    values: dict[str, Any] = {"whiskers": WHISKERS, "paper": paper}
    for optimizer in OPTIMIZERS:
        sizes = warmstarts.loc[warmstarts["optimizer"] == optimizer, "n"]
        values[optimizer] = [
            {
                "n": n,
                "boxes": warmstart_picture(warmstarts, optimizer, n, look),
                "seeds": warmstart_table(warmstarts, optimizer, n),
            }
            for n in sorted(map(int, set(sizes)))
        ]
    return Section("pipeline/experiments/experiment3/section.md.jinja", values)


def warmstart_picture(
    warmstarts: pd.DataFrame, optimizer: str, n: int, look: Mapping[str, Style]
) -> Picture:
    """Times of the plain SCP beside the expert's, or of the expert by stopping rule."""
    if optimizer == PLAIN:
        return Picture(f"experiment3-optimizers-n{n}", optimizers_figure(warmstarts, n, look))
    return Picture(f"experiment3-n{n}", warmstart_figure(warmstarts, n, look))


def warmstart_table(warmstarts: pd.DataFrame, optimizer: str, n: int) -> Table:
    """Each seed under each stopping rule of an optimizer at one swarm size."""
    rows = warmstarts[(warmstarts["optimizer"] == optimizer) & (warmstarts["n"] == n)]
    frame = summary.summarize_warmstarts(rows)
    frame = frame.assign(name=[label_name(seed) for seed in frame["seed"]])
    name = "experiment3-plain" if optimizer == PLAIN else "experiment3"
    return Table(f"{name}-n{n}", frame, COLUMNS[optimizer], int(frame["seeds"].max()))
