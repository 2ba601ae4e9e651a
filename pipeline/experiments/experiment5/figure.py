"""Close approaches, error at the goal and Δv of flights, by world and loop (experiment 5)."""

from collections.abc import Mapping

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import PercentFormatter

from pipeline.exhibits.axes import fit_scale
from pipeline.exhibits.planners import in_order, name_of
from pipeline.exhibits.style import GREY, PAGE_WIDTH, Style, in_style
from pipeline.experiments.experiment5.rows import LOOPS, NO_ERRORS, WORLDS
from pipeline.experiments.experiment5.summary import DELTA_V, GOAL, GOAL_HIGH, WITHIN_RADIUS

WIDTH = 0.62
"""Of the room that the planners of one loop share, where loops are 1 apart."""

PALE = 0.6
"""Opacity of what has no errors."""

BOTTOM = 0.003
"""Least error at the goal that is shown, m; the linear world without errors has none."""


@in_style
def flights_figure(summary: pd.DataFrame, look: Mapping[str, Style]) -> Figure:
    """A column of panels for each world; a marker for each planner and loop, hollow without errors.

    Args:
        summary: from ``summarize_flights``.
        look: a style for each planner.
    """
    worlds = [world for world in WORLDS if world in set(summary["world"])]
    figure = Figure(figsize=(PAGE_WIDTH, 6.6), layout="constrained")
    panels = figure.subplots(3, len(worlds), sharex=True, sharey="row", squeeze=False)
    for (near, goal, dear), world in zip(panels.T, worlds, strict=True):
        rows = summary[summary["world"] == world]
        low, high = WITHIN_RADIUS.interval or ("", "")
        _markers(near, rows, look, WITHIN_RADIUS.source, (low, high))
        _markers(goal, rows, look, GOAL.source, (GOAL.source, GOAL_HIGH.source))
        _markers(dear, rows, look, DELTA_V.source)
        near.set_title(f"{world} world" if world == WORLDS[0] else f"nonlinear, {world}")
        dear.set_xticks(range(len(LOOPS)), LOOPS)
        dear.set_xlim(-0.5, len(LOOPS) - 0.5)
        for ax in (near, goal, dear):
            ax.grid(visible=False, axis="x")
    near, goal, dear = panels[:, 0]
    near.set_ylim(-0.03, max(0.1, 1.1 * float(summary[high].max())))
    near.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    fit_scale(goal, "y", [v for v in summary[GOAL_HIGH.source] if v > BOTTOM], log=True)
    goal.set_ylim(bottom=BOTTOM)
    for ax, label in zip(
        (near, goal, dear),
        (WITHIN_RADIUS.label, "off goal, median to 95 % (m)", DELTA_V.label),
        strict=True,
    ):
        ax.set_ylabel(label)
    figure.legend(handles=_legend(summary, look), loc="outside lower center", ncols=6)
    return figure


def _markers(
    ax: Axes,
    rows: pd.DataFrame,
    look: Mapping[str, Style],
    source: str,
    ends: tuple[str, str] | None = None,
) -> None:
    """A marker for each row at its loop, planners side by side; with errors also its interval."""
    labels = _labels(rows)
    step = WIDTH / max(1, len(labels))
    for row in rows.to_dict("records"):
        planner, hollow = str(row["planner"]), row["errors"] == NO_ERRORS
        place = labels.index((planner, str(row["recipe"]))) - (len(labels) - 1) / 2
        at = LOOPS.index(str(row["loop"])) + step * place
        style = look[planner]
        if ends and not hollow:
            ax.vlines(at, row[ends[0]], row[ends[1]], color=style.colour, linewidth=0.9)
        ax.plot(
            at,
            float(row[source]),
            marker=style.marker,
            linestyle="none",
            color=style.colour,
            markerfacecolor="white" if hollow else style.colour,
            markersize=4.2,
            alpha=PALE if hollow else 1.0,  # some markers have no face
            zorder=3,
        )


def _labels(rows: pd.DataFrame) -> list[tuple[str, str]]:
    """Planners with their recipes, in reading order."""
    order, known = in_order(rows["planner"]), zip(rows["planner"], rows["recipe"], strict=True)
    return sorted(set(known), key=lambda one: (order.index(one[0]), one[1]))


def _legend(summary: pd.DataFrame, look: Mapping[str, Style]) -> list[Line2D]:
    handles = [
        Line2D([], [], label=name_of(p), **{**look[p].drawn, "linestyle": "none"})
        for p in in_order(summary["planner"])
    ]
    kinds = {"with errors": GREY, "without errors": "white"}
    return handles + [
        Line2D([], [], linestyle="none", marker="o", color=GREY, markerfacecolor=face, label=label)
        for label, face in kinds.items()
    ]
