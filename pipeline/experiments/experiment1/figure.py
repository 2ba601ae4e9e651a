"""Collisions and fuel at one swarm size (the paper's Figures 2 and 3)."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pipeline.exhibits.axes import fit_scale
from pipeline.exhibits.planners import EXPERTS, in_order, name_of
from pipeline.exhibits.style import GREY, PAGE_WIDTH, Style, in_style
from pipeline.experiments import paper
from pipeline.experiments.averages import Average
from pipeline.experiments.summary import BOUND, COLLISIONS, FUEL
from pipeline.experiments.trials import PREDICTED

RECIPE_MARKERS = {"": "D", "paper": "o", "tuned": "s"}
ROW_HEIGHT = 0.3
OFFSET = 0.13
"""Rows between two recipes of one planner, so that equal values do not hide each other."""


@in_style
def objectives_figure(summary: pd.DataFrame, n: int, look: Mapping[str, Style]) -> Figure:
    """Average collisions and average fuel of each planner, one row each, at swarm size n."""
    rows = summary[summary["n"] == n]
    planners = in_order(rows["planner"])
    figure = Figure(figsize=(PAGE_WIDTH, 1.35 + ROW_HEIGHT * len(planners)), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    quoted = n == paper.NETWORK_SIZE
    _dots(left, rows, look, COLLISIONS, paper.collisions_at(n))
    _dots(right, rows, look, FUEL, paper.fuel_at(n))
    bound = float(rows[BOUND.source].mean())
    right.axvline(bound, color=GREY, linewidth=0.8, linestyle=(0, (1, 1.5)))
    fit_scale(left, "x", [*rows[COLLISIONS.source], *paper.collisions_at(n).values(), 0.0])
    fit_scale(right, "x", [*rows[FUEL.source], *paper.fuel_at(n).values(), bound])
    left.set_xlabel("node collisions per trial, average")
    right.set_xlabel("fuel per trial, average (m/s²)")
    left.set_yticks(np.arange(len(planners)), [name_of(p) for p in planners])
    left.set_ylim(len(planners) - 0.5, -0.5)
    for ax in (left, right):
        ax.tick_params(axis="y", length=0)
    figure.legend(handles=_legend(rows, quoted), loc="outside lower center", ncols=3)
    return figure


def _dots(
    ax: Axes,
    rows: pd.DataFrame,
    look: Mapping[str, Style],
    average: Average,
    quoted: Mapping[str, float],
) -> None:
    planners = in_order(rows["planner"])
    recipes = sorted(set(rows["recipe"]) - {""})
    for row in rows.to_dict("records"):
        planner, recipe = str(row["planner"]), str(row["recipe"])
        shift = OFFSET * (2 * recipes.index(recipe) - len(recipes) + 1) if recipe in recipes else 0
        hollow = row["reading"] == PREDICTED
        ax.errorbar(
            float(row[average.source]),
            planners.index(planner) + shift,
            xerr=None if pd.isna(row[average.spread]) else float(row[average.spread]),
            ecolor=look[planner].colour,
            elinewidth=0.9,
            linestyle="none",
            marker=RECIPE_MARKERS.get(recipe, "D"),
            markerfacecolor="white" if hollow else look[planner].colour,
            markeredgecolor=look[planner].colour,
            # A hollow marker shows as a ring around a filled one at the same value.
            markersize=6.8 if hollow else 4.2,
            clip_on=False,
            zorder=3,
        )
    for k, planner in enumerate(planners):
        # The paper's "true" stands beside both experts: it keeps craft apart at the nodes only.
        reported = quoted.get("expert" if planner in EXPERTS else planner)
        if reported is not None:
            ax.plot(reported, k, **_PAPER)


_PAPER: dict[str, Any] = {
    "linestyle": "none",
    "marker": "|",
    "markersize": 13,
    "markeredgewidth": 1.6,
    "color": "black",
    "zorder": 2,
}


def _legend(rows: pd.DataFrame, quoted: bool) -> list[Line2D]:
    shown = rows[["recipe", "reading"]].assign(raw=rows["reading"] == PREDICTED)
    kinds = shown[["recipe", "raw"]].drop_duplicates().sort_values(["recipe", "raw"])
    handles = [
        Line2D(
            [],
            [],
            linestyle="none",
            marker=RECIPE_MARKERS.get(recipe, "D"),
            color=GREY,
            markerfacecolor="white" if raw else GREY,
            label=(f"{recipe} recipe, " if recipe else "")
            + ("as predicted" if raw else "flown" if recipe else "expert or baseline"),
        )
        for recipe, raw in kinds.itertuples(index=False)
    ]
    handles.append(
        Line2D([], [], color=GREY, linewidth=0.8, linestyle=(0, (1, 1.5)), label="lower bound")
    )
    if quoted:
        handles.append(Line2D([], [], label="reported in the paper", **_PAPER))
    return handles
