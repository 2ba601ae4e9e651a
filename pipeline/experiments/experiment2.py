"""Experiment 2: collisions, safety, fuel and time against swarm size (Figures 4 to 7)."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain, product
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
from pipeline.experiments.verdicts import Finding
from pipeline.figures import labels
from pipeline.figures.intervals import mean_interval
from pipeline.figures.labels import is_network, name_of, number, span
from pipeline.figures.style import GREY, PAGE_WIDTH, Style, in_style
from pipeline.figures.tables import Picture, Section, Table

PRINTED_SIZES = {2, 5, 10, 20, 30}  # that the page shows where evaluated; the CSV files have all


def section(summary: pd.DataFrame, styles: Mapping[str, Style]) -> Section:
    """Figures and tables of the averages from ``summarize``, if these are of several n up to 30."""
    summary = averages.sizes_of_paper(summary)
    sizes = sorted(map(int, summary["n"].unique()))
    values: dict[str, Any] = {"sizes": sizes}
    if len(sizes) > 1:
        values |= {"paper": paper, "tables": sizes_tables(summary)}
        values["timed"] = averages.timed_trials(summary)
        values["pictures"] = {
            name: Picture(f"experiment2-{name}", sizes_figure(summary, quantity, styles))
            for name, quantity in QUANTITIES.items()
            if summary[quantity.average.source].notna().any()
        }
    return Section("pipeline/experiments/experiment2.md.jinja", values)


def sizes_tables(summary: pd.DataFrame) -> dict[str, Table]:
    """Collisions, share of safe trials and fuel: a column for each of a few swarm sizes."""
    sizes = averages.printed_values(summary["n"], PRINTED_SIZES)
    rows = summary.assign(size=summary["n"].astype(str))
    return averages.tables_against(rows, "experiment2", "size", {str(n): f"n = {n}" for n in sizes})


class Quantity(NamedTuple):
    """An average that is drawn against n."""

    average: Average
    readings: tuple[str, ...] = (PREDICTED, FLOWN)  # of networks: a row of panels each
    paper: Mapping[int, Mapping[str, float]] = MappingProxyType({})  # its values by n and planner


QUANTITIES = {
    "collisions": Quantity(COLLISIONS, paper=paper.COLLISIONS),
    "safe": Quantity(averages.SAFE, (FLOWN,)),
    "fuel": Quantity(averages.FUEL, paper=paper.FUEL),
    "seconds": Quantity(
        averages.SECONDS, (FLOWN,), {paper.LARGEST_SIZE: {"expert": paper.EXPERT_SECONDS_AT_30}}
    ),
}

DODGE = 0.4  # horizontal distance of the paper's markers at one n, spacecraft
HOLLOW: dict[str, Any] = {"linestyle": "none", "markerfacecolor": "white"}  # the paper's markers


@in_style
def sizes_figure(summary: pd.DataFrame, quantity: Quantity, styles: Mapping[str, Style]) -> Figure:
    """One quantity against n: a row of panels for each reading, a column for each recipe.

    Experts, baselines and planners without a recipe whose output is a plan are in every panel.
    """
    rows = summary.dropna(subset=[quantity.average.source])
    # A network whose output is a plan is drawn among those that are flown, by its recipe.
    plan = (rows["reading"] == PLAN) & (rows["recipe"] != "") & rows["planner"].map(is_network)
    rows = rows.assign(reading=rows["reading"].mask(plan, FLOWN))
    raw_network = rows["planner"].map(is_network) & (rows["reading"] != PLAN)
    networks, others = rows[raw_network], rows[~raw_network & (rows["reading"] != PREDICTED)]
    present = set(networks["reading"])
    readings = [r for r in quantity.readings if r in present] or sorted(present) or [FLOWN]
    recipes = sorted(set(networks["recipe"])) or [""]

    def panel(reading: str, recipe: str) -> Panel:
        mine = networks[(networks["reading"] == reading) & (networks["recipe"] == recipe)]
        words = [f"{recipe} recipe"] if recipe else []
        if len(quantity.readings) > 1 or not recipe:
            words.append("as predicted" if reading == PREDICTED else "flown")
        title = "" if mine.empty else ", ".join(words)
        return Panel(pd.concat([others, mine]), quantity.average, title)

    grid = [[panel(reading, recipe) for recipe in recipes] for reading in readings]
    width = PAGE_WIDTH if len(recipes) > 1 else 0.75 * PAGE_WIDTH
    label = "hollow: in the paper"
    papers = Line2D([], [], marker="o", markeredgecolor=GREY, label=label, **HOLLOW)
    figure, axes = averages.lines_figure(
        grid,
        ("n", "spacecraft n"),
        styles,
        (width, 1.1 + 2.3 * len(readings)),
        quoted=[value for points in quantity.paper.values() for value in points.values()],
        handles=[papers] if quantity.paper else [],
        sharey=True,
    )
    axes[0, 0].xaxis.set_major_locator(MaxNLocator(nbins=6, integer=True, steps=[1, 5, 10]))
    for ax, drawn in zip(axes.flat, chain.from_iterable(grid), strict=True):
        for n, quoted in quantity.paper.items():
            shown = [p for p in labels.in_order(quoted) if p in set(drawn.rows["planner"])]
            for k, planner in enumerate(shown):
                its = styles[planner]
                style = {"marker": its.marker, "markeredgecolor": its.colour}
                at = n + DODGE * (k - (len(shown) - 1) / 2)
                ax.plot(at, quoted[planner], markersize=4.8, zorder=4, **style, **HOLLOW)
    return figure


def size_findings(trials: pd.DataFrame, training: pd.DataFrame, n: int) -> Iterator[Finding]:
    """Findings on the largest swarm flown, up to n = 30.

    None if that is experiment 1's ``n``, nor for a group of networks some of which were trained at
    that size.
    """
    trials = averages.sizes_of_paper(trials)
    flown = verdicts.flown_networks(trials)
    largest = max(map(int, flown["n"]), default=n)
    for group in verdicts.groups(flown.loc[flown["n"] == largest, "planner"]):
        own = training[training["arch"].isin(group.planners)]
        home = sorted(map(int, set(own["n"].dropna())))
        if largest not in (n, *home):
            trained = f"trained at n = {' or '.join(map(str, home))} " if home else ""
            predicate = f"{trained}work at other sizes (n = {largest})?"
            mine = trials[trials["planner"].isin([*group.planners, verdicts.DECOUPLED])]
            yield from verdicts.network_findings(predicate, mine, own, largest)


def trained_alike(summary: pd.DataFrame, training: pd.DataFrame) -> pd.DataFrame:
    """Select the rows of recipes whose networks were all trained at one swarm size."""
    known = training[training["arch"].isin(labels.FEED_FORWARD | labels.RECURRENT)]
    sizes = known.groupby("recipe")["n"].nunique()
    return summary[~summary["recipe"].isin(sizes.index[sizes > 1])]


def family_findings(summary: pd.DataFrame) -> list[Finding]:
    """Whether feed-forward networks collide less than LSTMs, if both were trained by one recipe.

    None of one size alone, unless it is larger than that of the paper's training.
    """
    sizes = sorted({int(n) for n in averages.sizes_of_paper(summary)["n"]})
    if not sizes or sizes[-1] <= min(sizes[0], paper.NETWORK_SIZE):
        return []
    question = "Do feed-forward networks collide less than LSTMs in larger swarms, as in the paper?"
    families, drawn = (labels.FEED_FORWARD, labels.RECURRENT), QUANTITIES["collisions"]
    return _compare_families(summary, question, "node collisions", drawn, families)


def fuel_findings(summary: pd.DataFrame) -> list[Finding]:
    """Whether LSTMs burn less than feed-forward networks, in the largest swarm and at n = 10."""
    question = "Do LSTMs burn less fuel than feed-forward networks (n = {n}), as in the paper?"
    families, sizes = (labels.RECURRENT, labels.FEED_FORWARD), (paper.NETWORK_SIZE,)
    return _compare_families(summary, question, "fuel in m/s²", QUANTITIES["fuel"], families, sizes)


def _compare_families(
    summary: pd.DataFrame,
    question: str,
    name: str,
    quantity: Quantity,
    families: tuple[Iterable[str], Iterable[str]],
    sizes: Sequence[int] = (),
) -> list[Finding]:
    """Findings on whether an average is lower for one family of networks than for the other.

    One for the largest swarm, and one for each of some other sizes.
    """
    summary = averages.sizes_of_paper(summary)
    networks = summary[summary["planner"].isin(labels.FEED_FORWARD | labels.RECURRENT)]
    by_size = summary[summary["planner"] == verdicts.DECOUPLED].set_index("n")
    decoupled = by_size[quantity.average.source]
    for recipe, reading in product(("paper", "tuned", ""), (PREDICTED, FLOWN)):
        rows = networks[(networks["recipe"] == recipe) & (networks["reading"] == reading)]
        how = f"{recipe} recipe, " if recipe else ""
        how += "as predicted" if reading == PREDICTED else "flown"
        found = []
        for n in sorted({*sizes, *rows["n"].nlargest(1)}):
            compared = verdicts.compare_families(rows[rows["n"] == n], *families, quantity.average)
            if compared is None:
                continue
            verdict, numbers = compared
            quoted = [value for p, value in quantity.paper.get(n, {}).items() if is_network(p)]
            if quoted:
                numbers += f" (paper: {min(quoted)} at best against {max(quoted)} at worst)"
            numbers = f"{name} at n = {n}, {how}: {numbers}"
            baseline = f"Decoupled optimum: {number(decoupled[n])}" if n in decoupled else ""
            found.append(Finding(question.format(n=n), verdict, numbers, baseline))
        if found:
            return found
    return []


def time_findings(trials: pd.DataFrame) -> Iterator[Finding]:
    """Whether the time of the paper's networks grows less with n than the experts'.

    Experts and networks were timed on the same scenarios of each n, so the ratios of their times
    are compared between the smallest and the largest swarm, by geometric means. One training is
    enough, since weights do not decide how long a network takes.
    """
    timed = averages.sizes_of_paper(trials).dropna(subset=["seconds"])
    flown = verdicts.flown_networks(timed)
    networks = flown[flown["planner"].map(labels.is_of_paper).astype(bool)]
    experts = timed[timed["planner"].isin(labels.EXPERTS)]
    sizes = sorted(set(networks["n"]) & set(experts["n"]))
    if len(sizes) < 2:
        return
    ends = sizes[0], sizes[-1]

    def logs(rows: pd.DataFrame) -> pd.DataFrame:
        """Logarithms of seconds: a row for each of both n, a column for each scenario."""
        each = rows.assign(log=np.log(rows["seconds"].astype(float)))
        return each.pivot_table("log", "n", "trial").reindex(ends)

    def growth(rows: pd.DataFrame) -> float:
        """Ratio of the geometric mean times at both n, from their logarithms."""
        return float(np.exp(np.diff(rows.mean(axis=1)).item()))

    ours = [logs(rows) for _, rows in networks.groupby(["planner", "recipe"])]
    theirs = {str(name): logs(rows) for name, rows in experts.groupby("planner")}
    differences = []
    for mine, other in product(ours, theirs.values()):
        small, large = (mean_interval(row[~np.isnan(row)]) for row in (mine - other).to_numpy())
        differences.append((large[0] - small[1], large[1] - small[0]))
    of_experts = [f"{name_of(name)} {number(growth(rows))}" for name, rows in theirs.items()]
    yield Finding(
        "Does the networks' time to plan grow less with n than the expert's, as in the paper?",
        verdicts.verdict_on_lower(True, differences),
        f"from n = {ends[0]} to n = {ends[1]}: networks {span(map(growth, ours))} times, "
        f"{', '.join(of_experts)}",
    )
