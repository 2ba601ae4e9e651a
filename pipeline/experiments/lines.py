"""Lines of the summary's averages against a variable, one a planner, and their legend."""

from collections.abc import Iterable, Mapping

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from pipeline.exhibits.planners import in_order, name_of
from pipeline.exhibits.style import Style
from pipeline.experiments.averages import SPREAD


def draw_lines(
    ax: Axes, rows: pd.DataFrame, against: str, value: str, look: Mapping[str, Style]
) -> None:
    """One line for each planner; a band is the spread over its training seeds, where it has one.

    Args:
        ax: where to draw.
        rows: of the summary, one for each planner and value of ``against``.
        against: column for the horizontal axis.
        value: column for the vertical axis.
        look: a style for each planner.
    """
    for k, planner in enumerate(in_order(rows["planner"])):
        line = rows[rows["planner"] == planner].drop_duplicates(against).sort_values(against)
        style = look[planner]
        ax.plot(
            line[against],
            line[value],
            color=style.colour,
            marker=style.marker,
            linestyle=style.line,
            markevery=_every(len(line), k),
        )
        spread = SPREAD.get(value)
        if spread and line[spread].notna().any():
            low, high = line[value] - line[spread], line[value] + line[spread]
            ax.fill_between(line[against], low, high, color=style.colour, alpha=0.2, linewidth=0)


def planner_handles(planners: Iterable[str], look: Mapping[str, Style]) -> list[Line2D]:
    """A legend's entry for each planner."""
    return [
        Line2D(
            [],
            [],
            color=look[p].colour,
            marker=look[p].marker,
            linestyle=look[p].line,
            label=name_of(p),
        )
        for p in in_order(planners)
    ]


def _every(points: int, k: int) -> tuple[int, int]:
    """Which points carry a marker: some eight, not the same ones on neighbouring lines."""
    step = max(1, points // 8)
    return k % step, step
