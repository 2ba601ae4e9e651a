"""Collisions, safety, fuel and run time against n, from 30 craft to hundreds."""

from collections.abc import Mapping

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator, PercentFormatter, StrMethodFormatter

from pipeline.exhibits.planners import in_order
from pipeline.exhibits.style import PAGE_WIDTH, Style, in_style
from pipeline.experiments.beyond.summary import DRAWN, UNSAFE
from pipeline.experiments.lines import draw_lines, planner_handles, scale

DODGE = 1.025
"""Factor in n by which intervals at one size are moved apart."""


@in_style
def beyond_figure(summary: pd.DataFrame, look: Mapping[str, Style]) -> Figure:
    """A panel for each average of DRAWN; n on a log scale.

    Args:
        summary: from ``summarize_beyond``.
        look: a style for each planner.
    """
    figure = Figure(figsize=(PAGE_WIDTH, 5.4), layout="constrained")
    panels = list(figure.subplots(2, 2, sharex=True).flat)
    for ax, average in zip(panels, DRAWN, strict=True):
        rows = summary.dropna(subset=[average.source])
        draw_lines(ax, rows, "n", average, look)
        ax.set_ylabel(average.label)
        if average is UNSAFE:
            _intervals(ax, rows, look)
            ax.set_ylim(-0.03, 1.03)
            ax.yaxis.set_major_formatter(PercentFormatter(1.0))
        else:
            scale(ax, average, rows[average.source])
    for ax in panels[2:]:
        ax.set_xlabel("spacecraft n")
    sizes = sorted(set(summary["n"]))
    panels[0].set_xscale("log")
    panels[0].xaxis.set_major_locator(FixedLocator(sizes))
    panels[0].xaxis.set_major_formatter(StrMethodFormatter("{x:.0f}"))
    panels[0].xaxis.set_minor_locator(NullLocator())
    handles = planner_handles(summary["planner"], look)
    figure.legend(handles=handles, loc="outside lower center", ncols=5, handlelength=3)
    return figure


def _intervals(ax: Axes, rows: pd.DataFrame, look: Mapping[str, Style]) -> None:
    """The interval of each share, moved sideways where they would hide each other."""
    planners = in_order(rows["planner"])
    for row in rows.to_dict("records"):
        k = planners.index(row["planner"]) - (len(planners) - 1) / 2
        at, colour = row["n"] * DODGE**k, look[row["planner"]].colour
        ax.vlines(at, row["unsafe_low"], row["unsafe_high"], color=colour, linewidth=0.8)
