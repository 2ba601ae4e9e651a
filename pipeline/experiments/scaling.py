"""Scaling beyond the paper's largest swarm, n = 30."""

from collections.abc import Iterator, Mapping

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator, StrMethodFormatter

from pipeline.experiments import averages, paper, verdicts
from pipeline.experiments.averages import COLLISIONS, FUEL_RATIO, SECONDS, Panel, average
from pipeline.experiments.records import PREDICTED
from pipeline.experiments.verdicts import DECOUPLED, Finding, performance
from pipeline.figures.labels import in_order, is_of_paper, number, share
from pipeline.figures.style import PAGE_WIDTH, Style, in_style
from pipeline.figures.tables import Picture, Section, Table

SHOWN = ("expert", "minimum energy", DECOUPLED)  # planners that are shown beside networks

UNSAFE = average("Unsafe at any time", "unsafe_share", share, spread=True, wilson=True)
EXCESS = average("Fuel above the bound, av. (%)", "excess", number, spread=True)

DRAWN = (COLLISIONS, UNSAFE, EXCESS, SECONDS)
"""Averages drawn against n; fuel as its excess, since hundredths of the ratio count."""

COLUMNS = [
    *(averages.N, averages.PLANNER, averages.RECIPE),
    *(averages.TRIALS, COLLISIONS, UNSAFE, FUEL_RATIO, SECONDS),
]


def sections(
    trials: pd.DataFrame, training: pd.DataFrame, styles: Mapping[str, Style]
) -> list[Section]:
    """The section on swarms beyond n = 30, where any were evaluated."""
    shown = larger_swarms(trials, training)
    if shown.empty:
        return []
    summary = summarize_larger(shown)
    values = {
        "paper": paper,
        "sizes": sorted({int(n) for n in shown["n"]}),
        "one_represents": shown["planner"].map(is_of_paper).any(),
        "safe": share(verdicts.SAFE),
        "cheap": verdicts.CHEAP,
        "picture": Picture("beyond", scaling_figure(summary, styles)),
        "averages": scaling_table(summary),
        "timed": averages.timed_trials(summary),
    }
    return [Section("pipeline/experiments/scaling.md.jinja", values)]


def larger_swarms(trials: pd.DataFrame, training: pd.DataFrame) -> pd.DataFrame:
    """Trials of sizes above n = 30 and of the largest up to it; none without sizes above.

    Kept are the planners SHOWN and networks as flown: of the paper's the one that is best on
    validation (all if that was not recorded), and all others.
    """
    rows = trials[trials["reading"] != PREDICTED]
    sizes = rows["n"].astype(int)
    if not (sizes > paper.LARGEST_SIZE).any():
        return rows.head(0)
    home = sizes[sizes <= paper.LARGEST_SIZE].max()
    kept = [rows[rows["planner"].isin(SHOWN)]]
    for group in verdicts.groups(rows["planner"]):
        mine = group.of(rows)
        name = verdicts.representative(mine, training) if group.papers else None
        kept.append(mine if name is None else verdicts.rows_of(mine, name))
    shown = pd.concat(kept)
    return shown[(shown["n"] > paper.LARGEST_SIZE) | (shown["n"] == home)]


def summarize_larger(trials: pd.DataFrame) -> pd.DataFrame:
    """``summarize`` with UNSAFE and EXCESS, sorted by size."""
    summary = averages.summarize(trials)
    found = summary.assign(
        unsafe_share=1 - summary["safe_share"],
        unsafe_spread=summary["safe_spread"],
        unsafe_low=1 - summary["safe_high"],
        unsafe_high=1 - summary["safe_low"],
        # The excess of decoupled optima is rounding.
        excess=(100 * (summary["fuel_ratio"] - 1)).round(9),
        excess_spread=100 * summary["fuel_ratio_spread"],
    )
    return found.sort_values("n", kind="stable", ignore_index=True)


def scaling_table(summary: pd.DataFrame) -> Table:
    """A row for each size and planner, from ``summarize_larger``."""
    return Table("beyond", averages.with_names(summary), COLUMNS)


DODGE = 1.025  # factor in n by which intervals at one size are moved apart


@in_style
def scaling_figure(summary: pd.DataFrame, styles: Mapping[str, Style]) -> Figure:
    """A panel for each average of DRAWN against n, on a log scale, from ``summarize_larger``."""
    panels = [Panel(summary.dropna(subset=[one.source]), one) for one in DRAWN]
    against = "n", "spacecraft n"
    grid = [panels[:2], panels[2:]]
    figure, axes = averages.lines_figure(grid, against, styles, (PAGE_WIDTH, 5.4))
    planners = in_order(summary["planner"])
    for row in summary.to_dict("records"):
        k = planners.index(row["planner"]) - (len(planners) - 1) / 2
        at, colour = row["n"] * DODGE**k, styles[row["planner"]].colour
        axes[0, 1].vlines(at, row["unsafe_low"], row["unsafe_high"], color=colour, linewidth=0.8)
    axes[0, 0].set_xscale("log")
    axis = axes[0, 0].xaxis
    axis.set_major_locator(FixedLocator(sorted(set(summary["n"]))))
    axis.set_major_formatter(StrMethodFormatter("{x:.0f}"))
    axis.set_minor_locator(NullLocator())
    return figure


def findings(shown: pd.DataFrame, training: pd.DataFrame) -> Iterator[Finding]:
    """Whether each group of networks is safe and cheap on the trials from ``larger_swarms``."""
    baseline, decoupled = "", shown[shown["planner"] == DECOUPLED]
    if not decoupled.empty:
        largest = decoupled["n"].max()
        text = performance(decoupled[decoupled["n"] == largest]).text
        baseline = f"Decoupled optimum at n = {largest}: {text}"
    for group in verdicts.groups(shown["planner"]):
        rows = group.of(shown)
        if (name := verdicts.representative(rows, training)) is None:
            continue
        sizes = verdicts.rows_of(rows, name).groupby("n")
        at = {f"n = {n}": performance(part) for n, part in sizes}
        predicate = f"plan safely and cheaply beyond n = {paper.LARGEST_SIZE}?"
        each = "; ".join(f"at {size} {one.text}" for size, one in at.items())
        numbers = f"{next(iter(at.values())).name}: {each}"
        verdict = verdicts.where_safe_and_cheap(at)
        yield Finding(group.question(predicate), verdict, numbers, baseline)
