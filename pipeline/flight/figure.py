"""Figure of trials: distributions of least separations, errors at the goal, and Δv."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pipeline.figures import style
from pipeline.flight.summary import finite
from pipeline.flight.trials import Trials

LINES: Sequence[Mapping[str, Any]] = (
    {"color": style.CONFLICT_COLOUR, "linestyle": "--", "zorder": 3},
    {"color": style.INITIAL_COLOUR, "linestyle": "-.", "zorder": 4},
    {"color": style.GOAL_COLOUR, "linewidth": 3.0, "alpha": 0.5, "zorder": 2},
)
"""Of loops, in their order; the last is wide and below, since the one before may run along it."""

APART = {"min_separation": "least separation (m)"}
CLEAR = {"min_clearance": "least clearance (m)"}  # instead, where sizes are not alike
PANELS = {"goal_error": "error at the goal (m)", "delta_v": "Δv of all craft (m/s)"}
"""Columns that are shown, with their axes' labels."""


@style.in_style
def trials_figure(tables: Mapping[str, Trials], radius: float, size: float, title: str) -> Figure:
    """Empirical distribution of each quantity over the trials, a line for each loop.

    The collision radius, m, is marked, and the physical size, m, where trials come near it. Where
    craft have radii of their own or there are obstacles, clearance takes the place of separation.
    """
    figure = Figure(figsize=(style.PAGE_WIDTH, 3.1), layout="constrained")
    clear = any("min_clearance" in trials for trials in tables.values())
    shown = {**(CLEAR if clear else APART), **PANELS}
    panels = figure.subplots(1, len(shown), sharey=True)
    for ax, (column, label) in zip(panels, shown.items(), strict=True):
        values = [finite(trials, column) for trials in tables.values()]
        for loop, found, line in zip(tables, values, LINES, strict=False):
            if len(found):
                ax.ecdf(found, label=loop, **line)
        if column not in CLEAR:  # which may be negative
            style.fit_scale(ax, "x", np.concatenate(values).tolist())
        ax.set_ylim(-0.02, 1.02)
        ax.set_xlabel(label)
    panels[0].set_ylabel("share of trials at or below")
    _mark(panels[0], 0.0 if clear else radius, "clear" if clear else "r_col")
    if not clear and panels[0].get_xlim()[0] < 2 * size:
        _mark(panels[0], size, "size")
    figure.suptitle(title, x=0.01, ha="left")
    handles, labels = panels[1].get_legend_handles_labels()
    if len(tables) > 1:
        figure.legend(handles, labels, loc="outside lower center", ncols=len(tables))
    return figure


def _mark(ax: Axes, distance: float, label: str) -> None:
    """A line at a distance, with its name at the top."""
    ax.axvline(distance, color=style.GREY, linewidth=0.9)
    at: dict[str, Any] = {"xycoords": ax.get_xaxis_transform(), "textcoords": "offset points"}
    ax.annotate(label, (distance, 1.0), xytext=(2, 1), color=style.GREY, fontsize=7.5, **at)
