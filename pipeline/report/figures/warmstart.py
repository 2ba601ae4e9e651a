"""Time of the expert from each seed (the paper's Figure 8)."""

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pipeline.report.figures.axes import fit_scale
from pipeline.report.figures.style import PAGE_WIDTH, Style, in_style
from pipeline.report.planners import label_name, planner_of
from pipeline.report.summary.warmstart import seeds_in_order

WHISKERS = (5, 95)
"""Percentiles that the whiskers reach to."""


UNTIL = {"converged": "until converged", "first safe": "until the first safe plan"}
"""What the stopping rules are called."""


@in_style
def warmstart_figure(warmstarts: pd.DataFrame, n: int, look: Mapping[str, Style]) -> Figure:
    """A box of run times for each seed at swarm size n, a panel for each stopping rule."""
    rows = warmstarts[warmstarts["n"] == n]
    seeds, rules = seeds_in_order(rows["seed"]), sorted(rows["rule"].unique())
    figure = Figure(figsize=(PAGE_WIDTH, 0.9 + 0.24 * len(seeds)), layout="constrained")
    panels = figure.subplots(1, len(rules), sharey=True, sharex=True, squeeze=False)[0]
    for ax, rule in zip(panels, rules, strict=True):
        _boxes(ax, rows[rows["rule"] == rule], seeds, look)
        ax.set_title(f"n = {n}, {UNTIL.get(rule, rule)}")
        ax.set_xlabel("time per instance (s)")
    spans = rows.groupby(["rule", "seed"])["seconds"].quantile(np.array(WHISKERS) / 100)
    fit_scale(panels[0], "x", spans.dropna(), log=True)
    panels[0].set_yticks(range(len(seeds)), [label_name(s) for s in seeds])
    panels[0].set_ylim(len(seeds) - 0.5, -0.5)
    return figure


def _boxes(ax: Axes, rows: pd.DataFrame, seeds: list[str], look: Mapping[str, Style]) -> None:
    times = [rows.loc[rows["seed"] == s, "seconds"].dropna().to_numpy() for s in seeds]
    shown = ax.boxplot(
        times,
        positions=range(len(seeds)),
        orientation="horizontal",
        whis=WHISKERS,
        showfliers=False,
        widths=0.62,
        patch_artist=True,
        manage_ticks=False,
        medianprops={"color": "black", "linewidth": 1.4},
        whiskerprops={"color": "#4d4d4d", "linewidth": 0.8},
        capprops={"color": "#4d4d4d", "linewidth": 0.8},
    )
    for box, seed in zip(shown["boxes"], seeds, strict=True):
        colour = "#FFFFFF" if seed == "none" else look[planner_of(seed)].colour
        box.set(facecolor=colour, edgecolor="#4d4d4d", linewidth=0.7)
    none = [t for t, s in zip(times, seeds, strict=True) if s == "none" and len(t)]
    if none:
        median = float(pd.Series(none[0]).median())
        ax.axvline(median, color="#4d4d4d", linewidth=0.8, linestyle=(0, (4, 3)), zorder=0.5)
    ax.grid(axis="y", visible=False)
    ax.tick_params(axis="y", length=0)
