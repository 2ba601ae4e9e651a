"""Time from each seed (the paper's Figure 8): of the plain SCP beside the expert, of the expert."""

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pipeline.exhibits.axes import fit_scale
from pipeline.exhibits.planners import label_name, planner_of
from pipeline.exhibits.style import GREY, PAGE_WIDTH, Style, in_style
from pipeline.experiments.experiment3.rows import CONVERGED, EXPERT, FIRST_SAFE, NO_SEED, PLAIN
from pipeline.experiments.experiment3.summary import seeds_in_order

WHISKERS = (5, 95)
"""Percentiles that the whiskers reach to."""

UNTIL = {CONVERGED: "until converged", FIRST_SAFE: "until the first safe plan"}
"""What the stopping rules are called."""

NAMES = {PLAIN: "Plain SCP", EXPERT: "Our expert"}
"""What the optimizers are called."""


@in_style
def warmstart_figure(warmstarts: pd.DataFrame, n: int, look: Mapping[str, Style]) -> Figure:
    """The expert's run times from each seed at swarm size n, a panel for each stopping rule."""
    rows = warmstarts[(warmstarts["n"] == n) & (warmstarts["optimizer"] == EXPERT)]
    panels = {
        f"n = {n}, {UNTIL.get(rule, rule)}": rows[rows["rule"] == rule]
        for rule in sorted(rows["rule"].unique())
    }
    figure, _ = _panels(panels, look)
    return figure


@in_style
def optimizers_figure(warmstarts: pd.DataFrame, n: int, look: Mapping[str, Style]) -> Figure:
    """Run times until converged from each seed at swarm size n, a panel for each optimizer."""
    rows = warmstarts[(warmstarts["n"] == n) & (warmstarts["rule"] == CONVERGED)]
    panels = {
        f"{name}, n = {n}": rows[rows["optimizer"] == optimizer]
        for optimizer, name in NAMES.items()
        if (rows["optimizer"] == optimizer).any()
    }
    figure, seeds = _panels(panels, look)
    for ax, shown in zip(figure.axes, panels.values(), strict=True):
        for row in (k for k, seed in enumerate(seeds) if seed not in set(shown["seed"])):
            note = "its own start: as without a seed" if seeds[row] == "own LP" else "not run"
            where = ax.get_yaxis_transform()
            ax.text(0.97, row, note, transform=where, ha="right", va="center", color=GREY, size=7)
    return figure


def _panels(
    panels: Mapping[str, pd.DataFrame], look: Mapping[str, Style]
) -> tuple[Figure, list[str]]:
    """A panel of boxes for each title, on common axes, and the seeds from top to bottom."""
    rows = pd.concat(list(panels.values()))
    seeds = seeds_in_order(rows["seed"])
    figure = Figure(figsize=(PAGE_WIDTH, 0.9 + 0.24 * len(seeds)), layout="constrained")
    axes = figure.subplots(1, len(panels), sharey=True, sharex=True, squeeze=False)[0]
    for ax, (title, part) in zip(axes, panels.items(), strict=True):
        _boxes(ax, part, seeds, look)
        ax.set_title(title)
        ax.set_xlabel("time per instance (s)")
    spans = [
        part.groupby("seed")["seconds"].quantile(np.array(WHISKERS) / 100).dropna()
        for part in panels.values()
    ]
    fit_scale(axes[0], "x", np.concatenate(spans), log=True)
    axes[0].set_yticks(range(len(seeds)), [label_name(s) for s in seeds])
    axes[0].set_ylim(len(seeds) - 0.5, -0.5)
    return figure, seeds


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
        whiskerprops={"color": GREY, "linewidth": 0.8},
        capprops={"color": GREY, "linewidth": 0.8},
    )
    for box, seed in zip(shown["boxes"], seeds, strict=True):
        colour = "#FFFFFF" if seed == NO_SEED else look[planner_of(seed)].colour
        box.set(facecolor=colour, edgecolor=GREY, linewidth=0.7)
    none = [t for t, s in zip(times, seeds, strict=True) if s == NO_SEED and len(t)]
    if none:
        median = float(pd.Series(none[0]).median())
        ax.axvline(median, color=GREY, linewidth=0.8, linestyle=(0, (4, 3)), zorder=0.5)
    ax.grid(axis="y", visible=False)
    ax.tick_params(axis="y", length=0)
