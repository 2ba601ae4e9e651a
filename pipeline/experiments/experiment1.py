"""Experiment 1: collisions and fuel of ten spacecraft (the paper's Table 2, Figures 2 and 3)."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pipeline.experiments import averages, paper
from pipeline.experiments.averages import BOUND, COLLISIONS, FUEL, Average
from pipeline.experiments.records import FLOWN, PREDICTED
from pipeline.experiments.verdicts import DECOUPLED, Finding, Rules, decide, network_findings
from pipeline.figures import labels
from pipeline.figures.labels import EXPERTS, number, span
from pipeline.figures.style import GREY, PAGE_WIDTH, Style, fit_scale, in_style
from pipeline.figures.tables import Column, Picture, Section, Table

COLUMNS = [
    *(*averages.PLANNER_COLUMNS, COLLISIONS, Column("paper", "paper_collisions_mean", number)),
    *(averages.MOST_COLLISIONS, Column("paper", "paper_collisions_max", labels.count)),
    *(averages.CONFLICTS, averages.SAFE, FUEL, Column("paper", "paper_fuel_mean", number)),
    *(averages.FUEL_RATIO, averages.BOUNDARY, averages.DYNAMICS),
]


def section(summary: pd.DataFrame, n: int, styles: Mapping[str, Style]) -> Section:
    """Table and figure of the averages from ``summarize`` at one swarm size."""
    table = objectives_table(summary, n)
    trials = table.frame["trials"]
    expert = table.frame[table.frame["planner"] == "expert"]
    unsafe = (1 - expert[averages.SAFE.source].astype(float)) * expert["trials"]
    values = {
        "paper": paper,
        "n": n,
        "refiner": summary["planner"].isin(labels.REFINERS).any(),
        "trials": sorted({int(trials.min()), int(trials.max())}),
        "without_plan": round(float(unsafe.sum())),
        "table_2": table,
        "figures_2_3": Picture("experiment1", objectives_figure(summary, n, styles)),
    }
    return Section("pipeline/experiments/experiment1.md.jinja", values)


def objectives_table(summary: pd.DataFrame, n: int) -> Table:
    """The columns of the paper's Table 2 at one swarm size; its own numbers beside them at n=10."""
    frame = averages.with_names(summary[summary["n"] == n].reset_index(drop=True))
    known = paper.OBJECTIVES if n == paper.NETWORK_SIZE else paper.OBJECTIVES.head(0)
    quoted = known.reindex(["expert" if p in EXPERTS else p for p in frame["planner"]])
    frame = frame.join(quoted.add_prefix("paper_").set_index(frame.index))
    return Table("experiment1", frame, COLUMNS)


RECIPE_MARKERS = {"": "D", "paper": "o", "tuned": "s"}
OFFSET = 0.13  # of a planner's recipes from its row, so that equal values do not hide each other

DOTTED: dict[str, Any] = {"color": GREY, "linewidth": 0.8, "linestyle": (0, (1, 1.5))}
MARK: dict[str, Any] = {"color": GREY, "linestyle": "none"}
PAPER: dict[str, Any] = {
    "linestyle": "none",
    "marker": "|",
    "markersize": 13,
    "markeredgewidth": 1.6,
    "color": "black",
    "zorder": 2,
}
LEGEND: dict[str, dict[str, Any]] = {
    "expert or baseline": {**MARK, "marker": RECIPE_MARKERS[""]},
    "paper recipe": {**MARK, "marker": RECIPE_MARKERS["paper"]},
    "tuned recipe": {**MARK, "marker": RECIPE_MARKERS["tuned"]},
    "hollow: as predicted": {**MARK, "marker": "o", "markerfacecolor": "white"},
    "lower bound": DOTTED,
    "reported in the paper": PAPER,
}
"""Legend: matplotlib's arguments by label; the last entry only where the paper has numbers."""


@in_style
def objectives_figure(summary: pd.DataFrame, n: int, styles: Mapping[str, Style]) -> Figure:
    """Average collisions and average fuel of each planner, one row each, at swarm size n."""
    rows = summary[summary["n"] == n]
    planners = labels.in_order(rows["planner"])
    figure = Figure(figsize=(PAGE_WIDTH, 1.35 + 0.3 * len(planners)), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    collisions, fuel = paper.COLLISIONS.get(n, {}), paper.FUEL.get(n, {})
    bound = float(rows[BOUND.source].mean())
    right.axvline(bound, **DOTTED)
    for ax, avg, quoted, least in ((left, COLLISIONS, collisions, 0.0), (right, FUEL, fuel, bound)):
        _dots(ax, rows, styles, avg, quoted)
        fit_scale(ax, "x", [*rows[avg.source], *quoted.values(), least])
        ax.tick_params(axis="y", length=0)
    left.set_xlabel("node collisions per trial, average")
    right.set_xlabel("fuel per trial, average (m/s²)")
    left.set_yticks(np.arange(len(planners)), [labels.name_of(p) for p in planners])
    left.set_ylim(len(planners) - 0.5, -0.5)
    handles = [Line2D([], [], label=label, **drawn) for label, drawn in LEGEND.items()]
    if n != paper.NETWORK_SIZE:
        handles.pop()
    figure.legend(handles=handles, loc="outside lower center", ncols=3)
    return figure


def _dots(
    ax: Axes,
    rows: pd.DataFrame,
    styles: Mapping[str, Style],
    avg: Average,
    quoted: Mapping[str, float],
) -> None:
    planners = labels.in_order(rows["planner"])
    recipes = sorted(set(rows["recipe"]) - {""})
    for row in rows.to_dict("records"):
        planner, recipe = str(row["planner"]), str(row["recipe"])
        shift = OFFSET * (2 * recipes.index(recipe) - len(recipes) + 1) if recipe in recipes else 0
        hollow, colour = row["reading"] == PREDICTED, styles[planner].colour
        ax.errorbar(
            float(row[avg.source]),
            planners.index(planner) + shift,
            xerr=None if pd.isna(row[avg.spread]) else float(row[avg.spread]),
            ecolor=colour,
            elinewidth=0.9,
            linestyle="none",
            marker=RECIPE_MARKERS.get(recipe, "D"),
            markerfacecolor="white" if hollow else colour,
            markeredgecolor=colour,
            # A hollow marker shows as a ring around a filled one at the same value.
            markersize=6.8 if hollow else 4.2,
            clip_on=False,
            zorder=3,
        )
    for k, planner in enumerate(planners):
        # The paper's "true" is compared with both experts: it separates craft at the nodes only.
        reported = quoted.get("expert" if planner in EXPERTS else planner)
        if reported is not None:
            ax.plot(reported, k, **PAPER)


NEAR = 2.0  # factor either way within which a number is called near the paper's
FEWER, CHEAPER = 0.5, 0.1  # targets of the tuned networks: shares of the paper's numbers

REPRODUCED: Rules = (((True, True), "Yes"), ((False, True), "In part"), ((False, False), "No"))
"""By whether all numbers of all networks are as asked, and whether any is."""


def findings(trials: pd.DataFrame, training: pd.DataFrame, n: int) -> Iterator[Finding]:
    """Whether each group of networks that were flown at swarm size n plans safely and cheaply."""
    predicate = f"plan safely and cheaply (n = {n})?"
    return network_findings(predicate, trials, training, n, papers="Do the paper's networks")


def paper_findings(summary: pd.DataFrame) -> Iterator[Finding]:
    """Findings on the paper's networks against its Table 2, one for each training recipe."""
    here = summary[summary["n"] == paper.NETWORK_SIZE]
    baseline = "".join(
        f"Decoupled optimum: {number(row[COLLISIONS.source])} collisions, "
        f"fuel {number(row[FUEL.source])}"
        for row in here[here["planner"] == DECOUPLED].to_dict("records")
    )
    quoted = paper.OBJECTIVES.drop("expert")[[COLLISIONS.source, FUEL.source]]
    for recipe, reading in (("paper", PREDICTED), ("tuned", FLOWN)):
        rows = here[(here["recipe"] == recipe) & (here["reading"] == reading)]
        rows = rows[rows["planner"].isin(quoted.index)].set_index("planner")
        if rows.empty:
            continue
        over = rows[quoted.columns] / quoted.loc[rows.index]
        collisions, fuel = (span(over[name]) for name in quoted)
        spans = f"collisions {collisions} and fuel {fuel} times the paper's"
        if recipe == "paper":
            question = "Does the paper's recipe give the paper's Table 2?"
            good = (over >= 1 / NEAR) & (over <= NEAR)
            names = rows.index.map(labels.name_of)
            collisions, fuel = (", ".join(names[good[name]]) or "none" for name in quoted)
            near = f"within a factor of {NEAR:g}: collisions {collisions}, fuel {fuel}"
            numbers = f"as predicted, {spans}; {near}"
        else:
            question = "Has the tuned recipe half of the paper's collisions at a tenth of its fuel?"
            good = over <= [FEWER, CHEAPER]
            fewer, cheaper = good.sum()
            numbers = f"flown, {spans}; {fewer} and {cheaper} of {len(rows)} networks do"
        verdict = decide(REPRODUCED, bool(good.all(axis=None)), bool(good.any(axis=None)))
        yield Finding(question, verdict, numbers, baseline)
