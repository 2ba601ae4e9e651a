"""Lines of averages against a variable, one a planner, and their legend."""

from collections.abc import Iterable, Mapping

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import PercentFormatter

from pipeline.exhibits.axes import fit_scale
from pipeline.exhibits.planners import in_order, name_of
from pipeline.exhibits.style import Style
from pipeline.experiments.averages import Average
from pipeline.experiments.summary import SAFE


def draw_lines(
    ax: Axes, rows: pd.DataFrame, against: str, average: Average, look: Mapping[str, Style]
) -> None:
    """One line for each planner; a band is the spread over its training seeds, where it has one.

    Args:
        ax: where to draw.
        rows: of the summary, one for each planner and value of ``against``.
        against: column for the horizontal axis.
        average: for the vertical axis.
        look: a style for each planner.
    """
    value, spread = average.source, average.spread
    for k, planner in enumerate(in_order(rows["planner"])):
        line = rows[rows["planner"] == planner].drop_duplicates(against).sort_values(against)
        style, every = look[planner], _every(len(line), k)
        ax.plot(line[against], line[value], markevery=every, **style.drawn)
        if spread and line[spread].notna().any():
            low, high = line[value] - line[spread], line[value] + line[spread]
            ax.fill_between(line[against], low, high, color=style.colour, alpha=0.2, linewidth=0)


def scale(ax: Axes, average: Average, values: Iterable[float]) -> None:
    """Scale the vertical axis: all of it for a share, what suits its values for another average."""
    if average is SAFE:
        ax.set_ylim(-0.03, 1.03)
        ax.yaxis.set_major_formatter(PercentFormatter(1.0))
    else:
        fit_scale(ax, "y", values)


def planner_handles(planners: Iterable[str], look: Mapping[str, Style]) -> list[Line2D]:
    """A legend's entry for each planner."""
    return [Line2D([], [], label=name_of(p), **look[p].drawn) for p in in_order(planners)]


def _every(points: int, k: int) -> tuple[int, int]:
    """Which points carry a marker: some eight, not the same ones on neighbouring lines."""
    step = max(1, points // 8)
    return k % step, step
