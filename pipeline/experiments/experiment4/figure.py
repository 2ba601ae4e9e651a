"""Collisions, safety and fuel against the transfer time (experiment 4)."""

from collections.abc import Mapping

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pipeline.exhibits.planners import is_network
from pipeline.exhibits.style import GREY, PAGE_WIDTH, Style, in_style
from pipeline.experiments.against import SHOWN
from pipeline.experiments.experiment4.run import WAYS
from pipeline.experiments.experiment4.summary import of_way, trained_on
from pipeline.experiments.lines import draw_lines, planner_handles, scale
from pipeline.experiments.trials import PREDICTED


def recipes_of(summary: pd.DataFrame) -> list[str]:
    """The recipes of the networks that took part; one without a name where there is none."""
    return sorted(set(summary.loc[summary["planner"].map(is_network), "recipe"])) or [""]


@in_style
def times_figure(summary: pd.DataFrame, recipe: str, look: Mapping[str, Style]) -> Figure:
    """The networks of one recipe, flown, with experts and baselines.

    A row of panels for each average of SHOWN; other T on the left, other Δt on the right. A band
    is the standard deviation between trainings, where there are several.

    Args:
        summary: from ``summarize_times``.
        recipe: of the networks.
        look: a style for each planner.
    """
    mine = ~summary["planner"].map(is_network) | (summary["recipe"] == recipe)
    shown = summary[mine & (summary["reading"] != PREDICTED)]
    trained = trained_on(summary)
    figure = Figure(figsize=(PAGE_WIDTH, 8.2), layout="constrained")
    panels = figure.subplots(len(SHOWN), len(WAYS), sharex=True, sharey="row")
    for line, average in zip(panels, SHOWN.values(), strict=True):
        for ax, way in zip(line, WAYS, strict=True):
            rows = of_way(shown, way)
            ax.axvline(trained.minutes, color=GREY, linewidth=0.8, linestyle=(0, (4, 3)))
            draw_lines(ax, rows, "minutes", average, look)
        line[0].set_ylabel(average.label)
        scale(line[0], average, shown[average.source])
    panels[0, 0].set_title(f"other T, Δt = {trained.time_step:g} s")
    panels[0, 1].set_title(f"other Δt, T = {trained.nodes}")
    for ax in panels[-1]:
        ax.xaxis.set_major_locator(MaxNLocator(nbins=8, steps=[1, 2, 5, 10]))
        ax.set_xlabel("transfer time (min)")
    handles = planner_handles(shown["planner"], look)
    figure.legend(handles=handles, loc="outside lower center", ncols=4, handlelength=3)
    return figure
