"""The picture of a Monte Carlo: how trials spread in separation, error at the goal and Δv."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pipeline.figures.style import (
    CONFLICT_COLOUR,
    GOAL_COLOUR,
    GREY,
    INITIAL_COLOUR,
    PAGE_WIDTH,
    fit_scale,
    in_style,
)

HEIGHT = 3.1
"""Of the figure, inches."""

LINES: Sequence[Mapping[str, Any]] = (
    {"color": CONFLICT_COLOUR, "linestyle": "--", "zorder": 3},
    {"color": INITIAL_COLOUR, "linestyle": "-.", "zorder": 4},
    {"color": GOAL_COLOUR, "linewidth": 3.0, "alpha": 0.5, "zorder": 2},
)
"""Of loops, in their order; the last is wide and below, since the one before may run along it."""

PANELS = {
    "min_separation": "least separation (m)",
    "goal_error": "error at the goal (m)",
    "delta_v": "Δv of all craft (m/s)",
}
"""Columns that are shown, with their axes' labels."""


@in_style
def trials_figure(tables: Mapping[str, pa.Table], radius: float, size: float, title: str) -> Figure:
    """For each quantity the share of trials that are at or below a value, a line a loop.

    Args:
        tables: the trials, by loop.
        radius: r_col, m.
        size: physical size, m; shown where trials come near it.
        title: above the panels.
    """
    figure = Figure(figsize=(PAGE_WIDTH, HEIGHT), layout="constrained")
    panels = figure.subplots(1, len(PANELS), sharey=True)
    for ax, (column, label) in zip(panels, PANELS.items(), strict=True):
        _spread(ax, {loop: _finite(table, column) for loop, table in tables.items()})
        ax.set_xlabel(label)
    panels[0].set_ylabel("share of trials at or below")
    _mark(panels[0], radius, "r_col")
    if panels[0].get_xlim()[0] < 2 * size:
        _mark(panels[0], size, "size")
    figure.suptitle(title, x=0.01, ha="left")
    handles, labels = panels[1].get_legend_handles_labels()
    if len(tables) > 1:
        figure.legend(handles, labels, loc="outside lower center", ncols=len(tables))
    return figure


def _finite(table: pa.Table, column: str) -> "np.ndarray[tuple[int], np.dtype[np.float64]]":
    return table[column].drop_null().to_numpy()


def _spread(ax: Axes, values: "Mapping[str, np.ndarray[tuple[int], np.dtype[np.float64]]]") -> None:
    for (loop, found), line in zip(values.items(), LINES, strict=False):
        if len(found):
            ax.ecdf(found, label=loop, **line)
    fit_scale(ax, "x", [v for found in values.values() for v in found])
    ax.set_ylim(-0.02, 1.02)


def _mark(ax: Axes, distance: float, label: str) -> None:
    """A line at a distance, with its name at the top."""
    ax.axvline(distance, color=GREY, linewidth=0.9)
    ax.annotate(
        label,
        (distance, 1.0),
        xycoords=ax.get_xaxis_transform(),
        xytext=(2, 1),
        textcoords="offset points",
        color=GREY,
        fontsize=7.5,
    )
