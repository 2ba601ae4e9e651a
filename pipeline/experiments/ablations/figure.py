"""Unsafe trials and fuel against the number of rounds."""

from collections.abc import Mapping

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pipeline.exhibits.axes import fit_scale
from pipeline.exhibits.style import GREY, PAGE_WIDTH, Style, in_style
from pipeline.experiments.ablations.ground import grounds
from pipeline.experiments.ablations.summary import EXCESS, UNSAFE_SHARE
from pipeline.experiments.answer import FREE
from pipeline.experiments.lines import draw_lines, planner_handles
from pipeline.networks.refiner.ablations import RULE, SHORT, TUNED

SHORT_COLOUR = "#E69F00"
"""Of Okabe and Ito's palette, beside whatever colour the tuned refiner has."""


def lines_of(summary: pd.DataFrame) -> pd.DataFrame:
    """The rows of tuned, short and the rule, each begun at 0 rounds by the own LP.

    Args:
        summary: from ``summarize_ablations``.
    """
    drawn = summary[summary["recipe"].isin([TUNED, SHORT]) | (summary["planner"] == RULE)]
    drawn = drawn[drawn["rounds"] > 0]
    starts = summary[summary["planner"] == FREE]
    begun = [starts.assign(name=name) for name in dict.fromkeys(drawn["name"])]
    return pd.concat([*begun, drawn], ignore_index=True)


@in_style
def rounds_figure(summary: pd.DataFrame, look: Mapping[str, Style]) -> Figure:
    """Unsafe trials above, fuel over its bound below; a column for each family and n.

    The dashed line is the number of rounds that an answer takes; a band is the standard deviation
    between trainings, where there are several.

    Args:
        summary: from ``summarize_ablations``.
        look: a style for each planner.
    """
    lines, own = _in_percent(lines_of(summary)), int(summary["own_rounds"].iloc[0])
    parts, named = grounds(lines), _styles(lines, look)
    width = PAGE_WIDTH if len(parts) > 1 else 0.6 * PAGE_WIDTH
    figure = Figure(figsize=(width, 5.2), layout="constrained")
    panels = figure.subplots(2, len(parts), sharex=True, squeeze=False)
    for k, (ground, rows) in enumerate(parts.items()):
        unsafe, fuel = panels[:, k]
        draw_lines(unsafe, rows, "rounds", UNSAFE_SHARE, named)
        fit_scale(unsafe, "y", lines[UNSAFE_SHARE.source])  # the same on each
        draw_lines(fuel, rows[rows["rounds"] > 0], "rounds", EXCESS, named)
        for ax in (unsafe, fuel):
            ax.axvline(own, color=GREY, linewidth=0.8, linestyle=(0, (4, 3)), zorder=1)
        unsafe.set_title(ground.label)
        fuel.set_xlabel("rounds")
        fuel.xaxis.set_major_locator(MaxNLocator(nbins=7, integer=True))
    for ax, average in zip(panels[:, 0], (UNSAFE_SHARE, EXCESS), strict=True):
        ax.set_ylabel(average.label)
    handles = planner_handles(named, named)
    figure.legend(handles=handles, loc="outside lower center", ncols=4, handlelength=3)
    return figure


def _in_percent(lines: pd.DataFrame) -> pd.DataFrame:
    """The same with names for planners, a line each."""
    averages = (UNSAFE_SHARE, EXCESS)
    columns = [column for average in averages for column in (average.source, average.spread)]
    percents = {column: 100 * lines[column] for column in columns}
    return lines.assign(group=lines["planner"], planner=lines["name"], **percents)


def _styles(lines: pd.DataFrame, look: Mapping[str, Style]) -> dict[str, Style]:
    """By name; the rule is grey, tuned has its network's colour."""
    found = {}
    for planner, recipe, name in lines[["group", "recipe", "name"]].itertuples(index=False):
        if planner == RULE:
            found[name] = Style(GREY, "x", ":")
        elif recipe == TUNED:
            found[name] = Style(look[planner].colour, "o", "-")
        elif recipe == SHORT:
            found[name] = Style(SHORT_COLOUR, "s", "--")
    return found
