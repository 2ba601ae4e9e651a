"""Averages of trials by planner: each defined once, for summaries, tables and figures."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import PercentFormatter

from pipeline.experiments.paper import LARGEST_SIZE, NETWORK_SIZE
from pipeline.experiments.rows import FLOWN, PLAN, PREDICTED
from pipeline.figures.intervals import wilson
from pipeline.figures.labels import count, error, in_order, name_of, number, ratio, share
from pipeline.figures.style import Style, fit_scale
from pipeline.figures.tables import Column, Table


@dataclass(frozen=True)
class Average(Column):
    """A column of a summary: the trials of each training first, then the trainings.

    ``source`` is its name there. ``spread``, the standard deviation between trainings, and
    ``interval``, Wilson's of a share, become columns beside it where they are named.

    Attributes:
        of: column of the trials.
        how: how the trials of one training become one number.
        over: how the trainings that differ in their seed alone do.
        label: of an axis that shows it.
    """

    of: str = ""
    how: "str | Callable[[pd.Series[Any]], object]" = "mean"
    over: "str | Callable[[pd.Series[Any]], object]" = "mean"
    label: str = ""


def average(title: str, source: str, text: Callable[[float], str], **more: Any) -> Average:
    """An average with its spread between trainings; its columns are named after the source."""
    stem = source.removesuffix("_mean").removesuffix("_share")
    return Average(title, source, text, spread=f"{stem}_spread", **more)


def average_share(title: str, source: str, **more: Any) -> Average:
    """The share of trials in which something holds, with Wilson's interval."""
    stem = source.removesuffix("_share")
    return Average(title, source, share, interval=(f"{stem}_low", f"{stem}_high"), **more)


TRIALS = Average("Trials", "trials", count, of="trial", how="nunique", over="max")


def averaged(
    rows: pd.DataFrame,
    group: Sequence[str],
    averages: Sequence[Average],
    order: Mapping[str, Sequence[str]] | None = None,
) -> pd.DataFrame:
    """One row for the trials of each group.

    Args:
        rows: a row each trial, with column training_seed.
        group: columns that a row of the summary stands for.
        averages: its further columns, beside trials and seeds (trainings averaged).
        order: of the values of some of the group's columns; planners have their reading order.
    """
    averages = (TRIALS, *averages)
    each = rows.groupby([*group, "training_seed"], as_index=False, sort=False).agg(
        **{a.source: (a.of, a.how) for a in averages}
    )
    summary = over_trainings(each, group, averages)
    for one in (a for a in averages if a.interval):
        # Trainings with other seeds flew the same trials, so they add none.
        pairs = zip(summary[one.source].astype(float), summary["trials"], strict=True)
        summary[list(one.interval or ())] = [wilson(s, int(k)) for s, k in pairs]
    ranks = dict(order or {})
    if "planner" in group:
        ranks["planner"] = in_order(summary["planner"])

    def rank(column: "pd.Series[Any]") -> "pd.Series[Any]":
        if (known := ranks.get(str(column.name))) is None:
            return column
        places = {value: place for place, value in enumerate(known)}
        return column.map(lambda value: places.get(value, len(places))).astype(int)

    return summary.sort_values(list(group), key=rank, ignore_index=True, kind="stable")


def over_trainings(
    each: pd.DataFrame, group: Sequence[str], averages: Sequence[Average]
) -> pd.DataFrame:
    """One row for the trainings that differ in their seed alone, spreads last.

    Args:
        each: a row each training, with columns training_seed and ``source`` of the averages.
        group: columns that a row stands for.
        averages: its further columns, beside seeds (trainings averaged).
    """
    groups = each.groupby(list(group), as_index=False, sort=False)
    found = groups.agg({a.source: a.over for a in averages})
    found.insert(len(group), "seeds", groups["training_seed"].nunique()["training_seed"])
    spreads = {a.source: a.spread for a in averages if a.spread}
    found[list(spreads.values())] = groups[list(spreads)].std()[list(spreads)]
    return found


PLANNER = ["planner", "recipe", "reading"]
"""Columns by which a row of a summary stands for a planner."""

NAMED = [Column("Planner", "name"), Column("Recipe", "recipe"), Column("Reading", "reading")]
"""The same on the page, for rows from ``named``."""

LEAST: dict[str, Any] = {"how": "min", "over": "min"}
MOST: dict[str, Any] = {"how": "max", "over": "max"}

COLLISIONS = average(
    *("Collisions, av.", "collisions_mean", number),
    of="node_collisions",
    label="node collisions, average",
)
MOST_COLLISIONS = Average("Collisions, max.", "collisions_max", count, of="node_collisions", **MOST)
CONFLICTS = Average("Pairs too close, av.", "conflicts_mean", number, of="pair_conflicts")
SAFE = average_share(
    *("Safe at all times", "safe_share"),
    spread="safe_spread",
    of="safe",
    label="share of safe trials",
)
SEPARATION = Average(
    "Separation, least (m)", "separation_min", number, of="min_separation", **LEAST
)
FUEL = average("Fuel, av. (m/s²)", "fuel_mean", number, of="fuel", label="fuel, average (m/s²)")
BOUND = Average("Bound, av. (m/s²)", "bound_mean", number, of="fuel_lower_bound")
FUEL_RATIO = average(
    *("Fuel / bound, av.", "fuel_ratio", ratio), of="fuel_ratio", label="fuel / bound, average"
)
BOUNDARY = Average("Boundary error (m)", "boundary_error", error, of="boundary_error")
DYNAMICS = Average("Dynamics error (m)", "dynamics_error", error, of="dynamics_error")
SECONDS = Average(
    "Time, av. (s)", "seconds_mean", number, of="seconds", label="time per instance (s)"
)
SOLVES = Average("Convex solves, av.", "convex_solves_mean", number, of="convex_solves")

AVERAGES = (
    *(COLLISIONS, MOST_COLLISIONS, CONFLICTS, SAFE, SEPARATION, FUEL, BOUND, FUEL_RATIO),
    *(BOUNDARY, DYNAMICS, SECONDS, SOLVES),
)

NO_FUEL = 1e-9
"""A bound below which fuel / bound says nothing, m/s²."""

ORDER = {"recipe": ["", "paper", "tuned"], "reading": [PLAN, PREDICTED, FLOWN]}
"""Reading order of a planner's rows; what else there is comes last."""


def summarize(trials: pd.DataFrame, by: Sequence[str] = ("n",)) -> pd.DataFrame:
    """Averages over the trials of each planner, recipe and reading, in reading order.

    Args:
        trials: a row each trial.
        by: further columns, each of whose values has rows of its own.

    Returns:
        ``PLANNER``, ``by``, seeds, trials and the columns of ``AVERAGES``; the share of safe
        trials is not a number where predicted.
    """
    return averaged(prepared(trials), [*PLANNER, *by], AVERAGES, ORDER)


def prepared(trials: pd.DataFrame) -> pd.DataFrame:
    """Trials with fuel_ratio, fuel over its bound, and safe as 1 or 0 where it is claimed."""
    bound = trials["fuel_lower_bound"].astype(float)
    return trials.assign(
        recipe=trials["recipe"].fillna(""),
        safe=as_share(trials["safe"]).where(trials["reading"] != PREDICTED),
        fuel_ratio=trials["fuel"].astype(float) / bound.where(bound > NO_FUEL),
    )


def as_share(safe: "pd.Series[bool]") -> "pd.Series[float]":
    """1 where safe, 0 where not or not known."""
    return safe.astype("boolean").fillna(False).astype(float)


def named(rows: pd.DataFrame) -> pd.DataFrame:
    """Rows with the names that the page has for planners."""
    return rows.assign(name=[name_of(planner) for planner in rows["planner"]])


def sizes_of_paper(rows: pd.DataFrame) -> pd.DataFrame:
    """Rows of swarms that are no larger than the paper's largest, n = 30."""
    return rows[rows["n"].astype(int) <= LARGEST_SIZE]


def reference_size(trials: pd.DataFrame) -> int:
    """The paper's n=10, or the size nearest to it that has trials (the smaller of two)."""
    sizes = sorted(int(n) for n in trials["n"].unique())
    return min(sizes, key=lambda n: abs(n - NETWORK_SIZE))


SHOWN = {"collisions": COLLISIONS, "safe": SAFE, "fuel": FUEL_RATIO}
"""Averages that have a table and a figure against a variable, by the table's name."""


def tables_against(
    summary: pd.DataFrame, experiment: str, variable: str, printed: Mapping[str, str]
) -> dict[str, Table]:
    """A table for each average of SHOWN: a row for each planner, a column for each value.

    Args:
        summary: in reading order, which is kept; predictions claim no safety.
        experiment: beginning of the tables' names.
        variable: column with the heading of each row's value in the CSV file.
        printed: what the page shows: by such a heading, its own.
    """
    tables = {}
    for called, one in SHOWN.items():
        rows = summary[summary["reading"] != PREDICTED] if one is SAFE else summary
        frame = wide(rows, PLANNER, variable, one)
        columns = [wide_column(frame, heading, title, one) for heading, title in printed.items()]
        tables[called] = Table(
            f"{experiment}-{called}", named(frame), [*NAMED, *columns], int(rows["seeds"].max())
        )
    return tables


def wide(rows: pd.DataFrame, index: list[str], variable: str, one: Average) -> pd.DataFrame:
    """An average with a column for each value of a variable, in the rows' own order.

    Ends of intervals and spreads between trainings, where there are any, stand in columns
    ``VALUE low``, ``VALUE high`` and ``VALUE ±``.
    """
    frame, headings = rows[index].drop_duplicates(), list(dict.fromkeys(rows[variable]))
    suffixes = {one.source: "", **dict(zip(one.interval or (), (" low", " high"), strict=False))}
    if one.spread and rows[one.spread].notna().any():
        suffixes[one.spread] = " ±"
    for source, suffix in suffixes.items():
        values = rows.pivot(index=index, columns=variable, values=source)[headings]
        frame = frame.merge(values.add_suffix(suffix).reset_index(), on=index, how="left")
    return frame


def wide_column(frame: pd.DataFrame, heading: str, title: str, one: Average) -> Column:
    """The column of one value on the page."""
    spread = f"{heading} ±" if f"{heading} ±" in frame else ""
    interval = (f"{heading} low", f"{heading} high") if one.interval else None
    return Column(title, heading, one.text, spread, interval)


def draw_lines(
    ax: Axes, rows: pd.DataFrame, against: str, one: Average, look: Mapping[str, Style]
) -> None:
    """One line for each planner; a band is the spread over its training seeds, where it has one.

    Args:
        ax: where to draw.
        rows: of the summary, one for each planner and value of ``against``.
        against: column for the horizontal axis.
        one: for the vertical axis.
        look: a style for each planner.
    """
    value, spread = one.source, one.spread
    for k, planner in enumerate(in_order(rows["planner"])):
        line = rows[rows["planner"] == planner].drop_duplicates(against).sort_values(against)
        step = max(1, len(line) // 8)  # some eight markers, at other points on the next line
        ax.plot(line[against], line[value], markevery=(k % step, step), **look[planner].drawn)
        if spread and line[spread].notna().any():
            low, high = line[value] - line[spread], line[value] + line[spread]
            colour = look[planner].colour
            ax.fill_between(line[against], low, high, color=colour, alpha=0.2, linewidth=0)


def scale(ax: Axes, one: Average, values: Iterable[float]) -> None:
    """Scale the vertical axis: all of it for a share, what suits its values for another average."""
    if one.text is share:
        ax.set_ylim(-0.03, 1.03)
        ax.yaxis.set_major_formatter(PercentFormatter(1.0))
    else:
        fit_scale(ax, "y", values)


def planner_handles(planners: Iterable[str], look: Mapping[str, Style]) -> list[Line2D]:
    """A legend's entry for each planner."""
    return [Line2D([], [], label=name_of(p), **look[p].drawn) for p in in_order(planners)]
