"""Averages over trials by planner, defined once for summaries, tables and figures."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import PercentFormatter

from pipeline.experiments.paper import LARGEST_SIZE, NETWORK_SIZE
from pipeline.experiments.records import FLOWN, PLAN, PREDICTED
from pipeline.figures.intervals import wilson
from pipeline.figures.labels import count, error, in_order, name_of, number, ratio, share
from pipeline.figures.style import PAGE_WIDTH, Style, fit_scale
from pipeline.figures.tables import Column, Table

Aggregation = str | Callable[["pd.Series[Any]"], object]
"""How a column becomes one number, as an aggregation of pandas."""


@dataclass(frozen=True)
class Average(Column):
    """A column of a summary: over the trials of each training first, then over the trainings."""

    column: str = ""  # of the trials, which is averaged
    over_trials: Aggregation = "mean"  # over the trials of one training
    over_seeds: Aggregation = "mean"  # over the trainings that differ in their seed alone


def average(
    title: str,
    source: str,
    text: Callable[..., str] | None,
    column: str = "",
    over_trials: Aggregation = "mean",
    over_seeds: Aggregation = "mean",
    *,
    spread: bool = False,
    wilson: bool = False,
) -> Average:
    """An average, optionally with its spread between trainings or Wilson's interval."""
    stem = source.removesuffix("_mean").removesuffix("_share")
    between = f"{stem}_spread" if spread else ""
    ends = (f"{stem}_low", f"{stem}_high") if wilson else None
    how: Any = {"column": column, "over_trials": over_trials, "over_seeds": over_seeds}
    return Average(title, source, text, between, ends, **how)


TRIALS = average("Trials", "trials", count, "trial", "nunique", "max")


def aggregate(
    rows: pd.DataFrame,
    group: Sequence[str],
    averages: Sequence[Average],
    order: Mapping[str, Sequence[str]],
) -> pd.DataFrame:
    """Averages over the trials of each group, with the numbers of trainings (seeds) and trials.

    Rows are trials, with their training_seed. The result is sorted by the group's columns: by the
    given ``order`` of values, else ascending; planners by ``in_order``.
    """
    averages = (TRIALS, *averages)
    each = rows.groupby([*group, "training_seed"], as_index=False, sort=False).agg(
        **{one.source: (one.column, one.over_trials) for one in averages}
    )
    summary = aggregate_trainings(each, group, averages, order)
    for one in averages:
        if one.interval:
            # All trainings have the same trials, so more of them do not narrow the interval.
            pairs = zip(summary[one.source].astype(float), summary["trials"], strict=True)
            summary[list(one.interval)] = [wilson(share, int(trials)) for share, trials in pairs]
    return summary


def aggregate_trainings(
    each: pd.DataFrame,
    group: Sequence[str],
    averages: Sequence[Average],
    order: Mapping[str, Sequence[str]],
) -> pd.DataFrame:
    """Averages over trainings that differ in their seed alone, with spreads in the last columns.

    Rows are trainings, with their training_seed and the averages' ``source``.
    """
    groups = each.groupby(list(group), as_index=False, sort=False)
    found = groups.agg({one.source: one.over_seeds for one in averages})
    found.insert(len(group), "seeds", groups["training_seed"].nunique()["training_seed"])
    spreads = {one.source: one.spread for one in averages if one.spread}
    found[list(spreads.values())] = groups[list(spreads)].std()[list(spreads)]
    known = dict(order)
    if "planner" in group:
        known["planner"] = in_order(found["planner"])

    def rank(column: "pd.Series[Any]") -> "pd.Series[Any]":
        values = known.get(str(column.name))
        return column if values is None else column.map({v: k for k, v in enumerate(values)})

    return found.sort_values(list(group), key=rank, ignore_index=True, kind="stable")


PLANNER_KEY = ["planner", "recipe", "reading"]  # columns that identify a planner in a summary
# Columns on the page, for rows from ``with_names``
N, PLANNER, RECIPE = Column("n", "n", count), Column("Planner", "name"), Column("Recipe", "recipe")
PLANNER_COLUMNS = [PLANNER, RECIPE, Column("Reading", "reading")]

COLLISIONS = average("Collisions, av.", "collisions_mean", number, "node_collisions", spread=True)
MOST_COLLISIONS = average(
    "Collisions, max.", "collisions_max", count, COLLISIONS.column, "max", "max"
)
CONFLICTS = average("Pairs too close, av.", "conflicts_mean", number, "pair_conflicts")
SAFE = average("Safe at all times", "safe_share", share, "safe", spread=True, wilson=True)
SEPARATION = average(
    "Separation, least (m)", "separation_min", number, "min_separation", "min", "min"
)
FUEL = average("Fuel, av. (m/s²)", "fuel_mean", number, "fuel", spread=True)
BOUND = average("Bound, av. (m/s²)", "bound_mean", number, "fuel_lower_bound")
FUEL_RATIO = average("Fuel / bound, av.", "fuel_ratio", ratio, "fuel_ratio", spread=True)
BOUNDARY = average("Boundary error (m)", "boundary_error", error, "boundary_error")
DYNAMICS = average("Dynamics error (m)", "dynamics_error", error, "dynamics_error")
SECONDS = average("Time, av. (s)", "seconds_mean", number, "seconds")
TIMED = average("Timed", "timed", count, SECONDS.column, "count", "max")
SOLVES = average("Convex solves, av.", "convex_solves_mean", number, "convex_solves")

AVERAGES = (
    *(COLLISIONS, MOST_COLLISIONS, CONFLICTS, SAFE, SEPARATION, FUEL, BOUND, FUEL_RATIO),
    *(BOUNDARY, DYNAMICS, SECONDS, TIMED, SOLVES),
)

NEGLIGIBLE_FUEL = 1e-9  # a bound below this is rounding: fuel has no ratio to it, m/s²

ORDER = {"recipe": ["", "paper", "tuned"], "reading": [PLAN, PREDICTED, FLOWN]}
"""Order of a planner's rows in tables; other values come last."""


def summarize(trials: pd.DataFrame, by: Sequence[str] = ("n",)) -> pd.DataFrame:
    """Averages over the trials of each planner, recipe and reading, in the order of tables.

    Rows have columns ``PLANNER_KEY``, ``by``, seeds, trials and those of ``AVERAGES``; the share of
    safe trials is not a number where predicted.
    """
    return aggregate(prepared(trials), [*PLANNER_KEY, *by], AVERAGES, ORDER)


def prepared(trials: pd.DataFrame) -> pd.DataFrame:
    """Trials with a column fuel_ratio (fuel over bound), and safe as 1, 0, or NaN if predicted."""
    bound = trials["fuel_lower_bound"].astype(float)
    return trials.assign(
        safe=as_share(trials["safe"]).where(trials["reading"] != PREDICTED),
        fuel_ratio=trials["fuel"].astype(float) / bound.where(bound > NEGLIGIBLE_FUEL),
    )


def as_share(safe: "pd.Series[bool]") -> "pd.Series[float]":
    """Safe as 1; unsafe and unknown as 0."""
    return safe.astype("boolean").fillna(False).astype(float)


def with_names(rows: pd.DataFrame) -> pd.DataFrame:
    """Rows with a column name: the planners' names as printed."""
    return rows.assign(name=[name_of(planner) for planner in rows["planner"]])


def sizes_of_paper(rows: pd.DataFrame) -> pd.DataFrame:
    """Rows of swarms that are no larger than the paper's largest, n = 30."""
    return rows[rows["n"].astype(int) <= LARGEST_SIZE]


def timed_trials(summary: pd.DataFrame) -> str:
    """Least and most timed trials of a row, as text such as 5 to 20; empty if none was timed."""
    found = sorted(set(summary[TIMED.source]) - {0})
    return " to ".join(dict.fromkeys(count(float(k)) for k in (*found[:1], *found[-1:])))


def reference_size(trials: pd.DataFrame) -> int:
    """The paper's n=10, or the size nearest to it that has trials (the smaller of two)."""
    return min(sorted(map(int, trials["n"].unique())), key=lambda n: abs(n - NETWORK_SIZE))


SHOWN = {"collisions": COLLISIONS, "safe": SAFE, "fuel": FUEL_RATIO}
"""Averages with a table against swarm size or transfer time, by the table's name."""


def tables_against(
    summary: pd.DataFrame, experiment: str, variable: str, printed: Mapping[str, str]
) -> dict[str, Table]:
    """A table for each average of SHOWN: a row for each planner, a column for each value.

    The CSV file has all values of the variable; the page has the keys of ``printed``, under the
    headings that these map to. Predictions have no share of safe trials.
    """
    tables = {}
    for name, avg in SHOWN.items():
        rows = summary[summary["reading"] != PREDICTED] if avg is SAFE else summary
        frame, values = pivot_average(rows, PLANNER_KEY, variable, avg, printed)
        columns = [*PLANNER_COLUMNS, *values]
        tables[name] = Table(f"{experiment}-{name}", with_names(frame), columns)
    return tables


def printed_values(values: Iterable[Any], usual: Iterable[Any]) -> list[Any]:
    """Values with a column on the page: all if few, else the least, the greatest and the usual."""
    found, usual = sorted(set(values)), set(usual)
    few = len(found) <= len(usual) + 1
    return found if few else [v for v in found if v in usual | {found[0], found[-1]}]


def pivot_average(
    rows: pd.DataFrame, index: list[str], variable: str, avg: Average, printed: Mapping[str, str]
) -> tuple[pd.DataFrame, list[Average]]:
    """An average with a column for each value of a variable, in the order of the rows.

    Ends of intervals and spreads between trainings, if any, are in columns ``VALUE low``,
    ``VALUE high`` and ``VALUE ±``. Returns the frame and the columns ``printed`` on the page.
    """
    frame, headings = rows[index].drop_duplicates(), list(dict.fromkeys(rows[variable]))
    suffixes = {avg.source: "", **dict(zip(avg.interval or (), (" low", " high"), strict=False))}
    spread = bool(avg.spread) and rows[avg.spread].notna().any()
    if spread:
        suffixes[avg.spread] = " ±"
    for source, suffix in suffixes.items():
        values = rows.pivot(index=index, columns=variable, values=source)[headings]
        frame = frame.merge(values.add_suffix(suffix).reset_index(), on=index, how="left")
    columns = [
        replace(
            avg,
            title=title,
            source=value,
            spread=f"{value} ±" if spread else "",
            interval=(f"{value} low", f"{value} high") if avg.interval else None,
        )
        for value, title in printed.items()
    ]
    return frame, columns


class Panel(NamedTuple):
    """A panel of ``lines_figure``: rows of a summary, one for each planner and abscissa."""

    rows: pd.DataFrame
    average: Average
    title: str = ""


def lines_figure(
    grid: Sequence[Sequence[Panel]],
    against: tuple[str, str],
    styles: Mapping[str, Style],
    size: tuple[float, float],
    quoted: Sequence[float] = (),
    handles: Sequence[Line2D] = (),
    **shared: Any,
) -> tuple[Figure, Any]:
    """Averages against a variable: a line for each planner, a band for its spread.

    All panels of one average share a scale, which covers the ``quoted`` values. ``against`` is the
    column on the horizontal axis and its label; ``handles`` are further entries of the legend; size
    is in inches; ``shared`` goes to ``Figure.subplots``.
    """
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(len(grid), len(grid[0]), sharex=True, squeeze=False, **shared)
    panels = [panel for line in grid for panel in line]
    for ax, (rows, avg, title) in zip(axes.flat, panels, strict=True):
        _draw_lines(ax, rows, against[0], avg, styles)
        ax.set_title(title)
        if avg.text is share:
            ax.set_ylim(-0.03, 1.03)
            ax.yaxis.set_major_formatter(PercentFormatter(1.0))
        else:
            alike = [panel.rows[avg.source] for panel in panels if panel.average is avg]
            fit_scale(ax, "y", [*pd.concat(alike), *quoted])
    for line, shown in zip(axes, grid, strict=True):
        for k, (ax, panel) in enumerate(zip(line, shown, strict=True)):
            if not k or shown[k - 1].average is not panel.average:
                ax.set_ylabel(panel.average.title)
    for ax in axes[-1]:
        ax.set_xlabel(against[1])
    planners = planner_handles(pd.concat([panel.rows["planner"] for panel in panels]), styles)
    handles, columns = [*planners, *handles], 3 if size[0] < PAGE_WIDTH else 4
    figure.legend(handles=handles, loc="outside lower center", ncols=columns, handlelength=3)
    return figure, axes


def _draw_lines(
    ax: Axes, rows: pd.DataFrame, against: str, avg: Average, styles: Mapping[str, Style]
) -> None:
    for k, planner in enumerate(in_order(rows["planner"])):
        line = rows[rows["planner"] == planner].drop_duplicates(against).sort_values(against)
        x, y, style = line[against], line[avg.source], styles[planner]
        step = max(1, len(line) // 8)  # some eight markers a line, staggered between lines
        ax.plot(x, y, markevery=(k % step, step), **style.drawn)
        if avg.spread and line[avg.spread].notna().any():
            band = line[avg.spread]
            ax.fill_between(x, y - band, y + band, color=style.colour, alpha=0.2, linewidth=0)


def planner_handles(planners: Iterable[str], styles: Mapping[str, Style]) -> list[Line2D]:
    """Legend entries of planners."""
    return [Line2D([], [], label=name_of(p), **styles[p].drawn) for p in in_order(planners)]
