"""Experiment 2: collisions, safety, fuel and time against swarm size (Figures 4 to 7)."""

from collections.abc import Mapping
from itertools import chain
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from pipeline.experiments import averages, paper, verdicts
from pipeline.experiments.averages import COLLISIONS, Average, Panel
from pipeline.experiments.records import FLOWN, PLAN, PREDICTED
from pipeline.experiments.verdicts import ANY, Finding, Rules
from pipeline.figures.labels import FEED_FORWARD, RECURRENT, in_order, is_network, name_of, number
from pipeline.figures.style import GREY, PAGE_WIDTH, Style, in_style
from pipeline.figures.tables import Picture, Section, Table

PRINTED_SIZES = {2, 5, 10, 20, 30}  # that the page shows where evaluated; the CSV files have all


def section(summary: pd.DataFrame, look: Mapping[str, Style]) -> Section:
    """Figures and tables of the averages from ``summarize``, where several n up to 30 have some."""
    summary = averages.sizes_of_paper(summary)
    sizes = sorted(map(int, summary["n"].unique()))
    values: dict[str, Any] = {"sizes": sizes}
    if len(sizes) > 1:
        values |= {"paper": paper, "tables": sizes_tables(summary)}
        values["pictures"] = {
            name: Picture(f"experiment2-{name}", sizes_figure(summary, what, look))
            for name, what in QUANTITIES.items()
            if summary[what.average.source].notna().any()
        }
    return Section("pipeline/experiments/experiment2.md.jinja", values)


def sizes_tables(summary: pd.DataFrame) -> dict[str, Table]:
    """Collisions, share of safe trials and fuel: a column for each of a few swarm sizes."""
    sizes = averages.printed_of(summary["n"], PRINTED_SIZES)
    rows = summary.assign(size=summary["n"].astype(str))
    return averages.tables_against(rows, "experiment2", "size", {str(n): f"n = {n}" for n in sizes})


class Quantity(NamedTuple):
    """An average that is drawn against n."""

    average: Average
    readings: tuple[str, ...] = (PREDICTED, FLOWN)  # of networks: a row of panels each
    paper: Mapping[int, Mapping[str, float]] = MappingProxyType({})  # by n and planner


QUANTITIES = {
    "collisions": Quantity(COLLISIONS, paper=paper.COLLISIONS),
    "safe": Quantity(averages.SAFE, (FLOWN,)),
    "fuel": Quantity(averages.FUEL, paper=paper.FUEL),
    "seconds": Quantity(
        averages.SECONDS, (FLOWN,), {paper.LARGEST_SIZE: {"expert": paper.EXPERT_SECONDS_AT_30}}
    ),
}

DODGE = 0.4  # spacecraft by which the paper's markers at one n are moved apart, to be told apart
HOLLOW: dict[str, Any] = {"linestyle": "none", "markerfacecolor": "white"}  # the paper's markers


@in_style
def sizes_figure(summary: pd.DataFrame, what: Quantity, look: Mapping[str, Style]) -> Figure:
    """One quantity against n: a row of panels for each reading, a column for each recipe.

    Experts, baselines and planners without a recipe whose output is a plan stand in every panel.
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

    def panel(reading: str, recipe: str) -> Panel:
        mine = networks[(networks["reading"] == reading) & (networks["recipe"] == recipe)]
        said = [f"{recipe} recipe"] if recipe else []
        if len(what.readings) > 1 or not recipe:
            said.append("as predicted" if reading == PREDICTED else "flown")
        title = "" if mine.empty else ", ".join(said)
        return Panel(pd.concat([others, mine]), what.average, title)

    grid = [[panel(reading, recipe) for recipe in recipes] for reading in readings]
    width = PAGE_WIDTH if len(recipes) > 1 else 0.75 * PAGE_WIDTH
    label = "hollow: in the paper"
    papers = Line2D([], [], marker="o", markeredgecolor=GREY, label=label, **HOLLOW)
    figure, axes = averages.lines_figure(
        grid,
        ("n", "spacecraft n"),
        look,
        (width, 1.1 + 2.3 * len(readings)),
        quoted=[value for points in what.paper.values() for value in points.values()],
        handles=[papers] if what.paper else [],
        sharey=True,
    )
    axes[0, 0].xaxis.set_major_locator(MaxNLocator(nbins=6, integer=True, steps=[1, 5, 10]))
    for ax, drawn in zip(axes.flat, chain.from_iterable(grid), strict=True):
        for n, quoted in what.paper.items():
            shown = [p for p in in_order(quoted) if p in set(drawn.rows["planner"])]
            for k, planner in enumerate(shown):
                style = {"marker": look[planner].marker, "markeredgecolor": look[planner].colour}
                at = n + DODGE * (k - (len(shown) - 1) / 2)
                ax.plot(at, quoted[planner], markersize=4.8, zorder=4, **style, **HOLLOW)
    return figure


def size_findings(trials: pd.DataFrame, training: pd.DataFrame, n: int) -> list[Finding]:
    """Findings on the largest swarm flown, up to n = 30; none if that is experiment 1's ``n``."""
    trials = averages.sizes_of_paper(trials)
    largest = max(map(int, verdicts.flown_networks(trials)["n"]), default=n)
    if largest == n:
        return []
    asked = f"trained at n = {paper.NETWORK_SIZE} serve others (n = {largest})?"
    return verdicts.network_findings(asked, trials, training, largest)


FAMILIES: Rules = (
    ((True, True, ANY), "Confirmed"),
    ((True, ANY, True), "Contradicted"),
    ((True, ANY, ANY), "Open: within the spread"),
    ((False, True, ANY), "Open: one training of some, points to yes"),
    ((False, ANY, True), "Open: one training of some, points to no"),
    ((False, ANY, ANY), "Open: one training of some, no trend"),
)
"""By whether there are several trainings of each, feed-forward networks collide less, and more."""


def family_findings(summary: pd.DataFrame) -> list[Finding]:
    """Whether feed-forward networks collide less than LSTMs, where both took part in one recipe."""
    summary = averages.sizes_of_paper(summary)
    networks = summary[summary["planner"].isin(FEED_FORWARD | RECURRENT)]
    for recipe in ("paper", "tuned", ""):
        for reading in (PREDICTED, FLOWN):
            rows = networks[(networks["recipe"] == recipe) & (networks["reading"] == reading)]
            rows = rows[rows["n"] == rows["n"].max()]
            forward, recurrent = (rows[rows["planner"].isin(f)] for f in (FEED_FORWARD, RECURRENT))
            if not (forward.empty or recurrent.empty):
                return [_on_families(summary, forward, recurrent)]
    return []


def _on_families(summary: pd.DataFrame, forward: pd.DataFrame, recurrent: pd.DataFrame) -> Finding:
    first = forward.iloc[0]
    n, how = int(first["n"]), "as predicted" if first["reading"] == PREDICTED else "flown"
    recipe = f", {first['recipe']} recipe" if first["recipe"] else ""
    several = min(int(rows["seeds"].min()) for rows in (forward, recurrent)) > 1
    less, more = _all_below(forward, recurrent), _all_below(recurrent, forward)
    quoted = paper.COLLISIONS[paper.LARGEST_SIZE]
    free = summary[(summary["planner"] == verdicts.DECOUPLED) & (summary["n"] == n)]
    return Finding(
        "Do feed-forward networks collide less than LSTMs in larger swarms, as in the paper?",
        verdicts.decide(FAMILIES, several, less, more),
        f"node collisions at n = {n}{recipe}, {how}: {_listed(forward)} against "
        f"{_listed(recurrent)} (paper: {quoted['ff1']} at best against {quoted['lstm1']} at worst)",
        f"Decoupled optimum: {number(free[COLLISIONS.source].iloc[0])}" if len(free) else "",
    )


def _all_below(these: pd.DataFrame, those: pd.DataFrame) -> bool:
    """Whether all of these collide less than all of those, by more than the seeds' spread."""
    worst = these.nlargest(1, COLLISIONS.source).iloc[0]
    best = those.nsmallest(1, COLLISIONS.source).iloc[0]
    noise = np.nanmax([0.0, worst[COLLISIONS.spread], best[COLLISIONS.spread]])
    return bool(best[COLLISIONS.source] - worst[COLLISIONS.source] > noise)


def _listed(rows: pd.DataFrame) -> str:
    columns = rows[["planner", COLLISIONS.source, COLLISIONS.spread]]
    return ", ".join(
        f"{name_of(planner)} {number(mean)}" + ("" if pd.isna(spread) else f" ± {number(spread)}")
        for planner, mean, spread in columns.itertuples(index=False)
    )
