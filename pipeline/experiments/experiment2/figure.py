"""Collisions, safety, fuel and run time against n (the paper's Figures 4 to 7)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from pipeline.exhibits.planners import in_order, is_network
from pipeline.exhibits.style import GREY, PAGE_WIDTH, Style, in_style
from pipeline.experiments import paper
from pipeline.experiments.averages import Average
from pipeline.experiments.lines import draw_lines, planner_handles, scale
from pipeline.experiments.summary import COLLISIONS, FUEL, SAFE, SECONDS
from pipeline.experiments.trials import FLOWN, PLAN, PREDICTED

Points = Mapping[int, Mapping[str, float]]
"""What the paper reports: by n, then by planner."""

DODGE = 0.4
"""Spacecraft by which the paper's markers at one n are moved apart, to be told from each other."""

HOLLOW: dict[str, Any] = {"linestyle": "none", "markerfacecolor": "white"}
"""The paper's markers."""


@dataclass(frozen=True)
class Quantity:
    """What is drawn against n.

    Attributes:
        average: of the trials.
        readings: readings of networks that get a row of panels.
        paper: the paper's own points.
    """

    average: Average
    readings: tuple[str, ...] = (PREDICTED, FLOWN)
    paper: Points | None = None


_SIZES = (paper.NETWORK_SIZE, paper.LARGEST_SIZE)

QUANTITIES = {
    "collisions": Quantity(COLLISIONS, paper={n: paper.collisions_at(n) for n in _SIZES}),
    "safe": Quantity(SAFE, readings=(FLOWN,)),
    "fuel": Quantity(FUEL, paper={n: paper.fuel_at(n) for n in _SIZES}),
    "seconds": Quantity(
        SECONDS,
        readings=(FLOWN,),
        paper={paper.LARGEST_SIZE: {"expert": paper.EXPERT_SECONDS_AT_30}},
    ),
}


@in_style
def scaling_figure(summary: pd.DataFrame, what: Quantity, look: Mapping[str, Style]) -> Figure:
    """One quantity against n: a row of panels for each reading, a column for each recipe.

    Experts, baselines and planners without a recipe whose output is a plan stand in every panel.
    A band is the standard deviation between trainings, where there are several.
    """
    rows = summary.dropna(subset=[what.average.source])
    # A network whose output is a plan stands with those that are flown, by its recipe.
    plan = (rows["reading"] == PLAN) & (rows["recipe"] != "") & rows["planner"].map(is_network)
    rows = rows.assign(reading=rows["reading"].mask(plan, FLOWN))
    raw_network = rows["planner"].map(is_network) & (rows["reading"] != PLAN)
    networks, others = rows[raw_network], rows[~raw_network & (rows["reading"] != PREDICTED)]
    present = set(networks["reading"])
    readings = [r for r in what.readings if r in present] or sorted(present) or [FLOWN]
    recipes = sorted(set(networks["recipe"])) or [""]
    width = PAGE_WIDTH if len(recipes) > 1 else 0.75 * PAGE_WIDTH
    figure = Figure(figsize=(width, 1.1 + 2.3 * len(readings)), layout="constrained")
    panels = figure.subplots(len(readings), len(recipes), sharex=True, sharey=True, squeeze=False)
    for i, reading in enumerate(readings):
        for j, recipe in enumerate(recipes):
            mine = networks[(networks["reading"] == reading) & (networks["recipe"] == recipe)]
            _panel(panels[i, j], pd.concat([others, mine]), what, look)
            if not mine.empty:
                panels[i, j].set_title(_title(reading, recipe, what))
        panels[i, 0].set_ylabel(what.average.label)
    for ax in panels[-1]:
        ax.set_xlabel("spacecraft n")
    panels[0, 0].xaxis.set_major_locator(MaxNLocator(nbins=6, integer=True, steps=[1, 5, 10]))
    quoted = [v for points in (what.paper or {}).values() for v in points.values()]
    scale(panels[0, 0], what.average, [*rows[what.average.source], *quoted])
    shown = pd.concat([others, networks[networks["reading"].isin(readings)]])
    handles = planner_handles(shown["planner"], look)
    if what.paper is not None:
        label = "hollow: in the paper"
        handles.append(Line2D([], [], marker="o", markeredgecolor=GREY, label=label, **HOLLOW))
    across = 4 if len(recipes) > 1 else 3
    figure.legend(handles=handles, loc="outside lower center", ncols=across, handlelength=3)
    return figure


def _panel(ax: Axes, rows: pd.DataFrame, what: Quantity, look: Mapping[str, Style]) -> None:
    draw_lines(ax, rows, "n", what.average, look)
    for n, quoted in (what.paper or {}).items():
        _paper_points(ax, n, quoted, in_order(rows["planner"]), look)


def _paper_points(
    ax: Axes,
    n: int,
    quoted: Mapping[str, float],
    planners: Sequence[str],
    look: Mapping[str, Style],
) -> None:
    shown = [p for p in in_order(quoted) if p in planners]
    for k, planner in enumerate(shown):
        ax.plot(
            n + DODGE * (k - (len(shown) - 1) / 2),
            quoted[planner],
            marker=look[planner].marker,
            markeredgecolor=look[planner].colour,
            markersize=4.8,
            zorder=4,
            **HOLLOW,
        )


def _title(reading: str, recipe: str, what: Quantity) -> str:
    how = "as predicted" if reading == PREDICTED else "flown"
    if len(what.readings) == 1 and recipe:
        return f"{recipe} recipe"
    return f"{recipe} recipe, {how}" if recipe else how
