"""Averages of trials by planner: each defined once, for summaries, tables and figures."""

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

How = str | Callable[["pd.Series[Any]"], object]
"""How numbers become one, in pandas' terms."""


@dataclass(frozen=True)
class Average(Column):
    """A column of a summary, ``source``: the trials of each training first, then the trainings."""

    of: str = ""  # column of the trials
    how: How = "mean"  # how the trials of one training become one number
    over: How = "mean"  # how the trainings that differ in their seed alone do


def average(
    title: str,
    source: str,
    text: Callable[[float], str] | None,
    of: str = "",
    how: How = "mean",
    over: How = "mean",
    *,
    spread: bool = False,
    wilson: bool = False,
) -> Average:
    """An average, perhaps with its spread between trainings, or with Wilson's interval."""
    stem = source.removesuffix("_mean").removesuffix("_share")
    between = f"{stem}_spread" if spread else ""
    ends = (f"{stem}_low", f"{stem}_high") if wilson else None
    return Average(title, source, text, between, ends, of=of, how=how, over=over)


TRIALS = average("Trials", "trials", count, "trial", "nunique", "max")


def averaged(
    rows: pd.DataFrame,
    group: Sequence[str],
    averages: Sequence[Average],
    order: Mapping[str, Sequence[str]],
) -> pd.DataFrame:
    """Averages over the trials of each group of planners, with seeds (trainings) and trials.

    Rows are trials, with their training_seed. Averages are sorted by the group's columns, in the
    ``order`` of values that is given or in their own; planners have their reading order.
    """
    averages = (TRIALS, *averages)
    each = rows.groupby([*group, "training_seed"], as_index=False, sort=False).agg(
        **{one.source: (one.of, one.how) for one in averages}
    )
    summary = over_trainings(each, group, averages, order)
    for one in averages:
        if one.interval:
            # Trainings with other seeds flew the same trials, so they add none.
            pairs = zip(summary[one.source].astype(float), summary["trials"], strict=True)
            summary[list(one.interval)] = [wilson(share, int(trials)) for share, trials in pairs]
    return summary


def over_trainings(
    each: pd.DataFrame,
    group: Sequence[str],
    averages: Sequence[Average],
    order: Mapping[str, Sequence[str]],
) -> pd.DataFrame:
    """Averages over trainings that differ in their seed alone; spreads come last.

    Rows are trainings, with their training_seed and the averages' ``source``.
    """
    groups = each.groupby(list(group), as_index=False, sort=False)
    found = groups.agg({one.source: one.over for one in averages})
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


PLANNER = ["planner", "recipe", "reading"]
"""Columns by which a row of a summary stands for a planner."""

NAMED = [Column("Planner", "name"), Column("Recipe", "recipe"), Column("Reading", "reading")]
"""The same on the page, for rows from ``named``."""

COLLISIONS = average("Collisions, av.", "collisions_mean", number, "node_collisions", spread=True)
MOST_COLLISIONS = average("Collisions, max.", "collisions_max", count, COLLISIONS.of, "max", "max")
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
SOLVES = average("Convex solves, av.", "convex_solves_mean", number, "convex_solves")

AVERAGES = (
    *(COLLISIONS, MOST_COLLISIONS, CONFLICTS, SAFE, SEPARATION, FUEL, BOUND, FUEL_RATIO),
    *(BOUNDARY, DYNAMICS, SECONDS, SOLVES),
)

NO_FUEL = 1e-9  # a bound below which fuel / bound says nothing, m/s²

ORDER = {"recipe": ["", "paper", "tuned"], "reading": [PLAN, PREDICTED, FLOWN]}
"""Reading order of a planner's rows; what else there is comes last."""


def summarize(trials: pd.DataFrame, by: Sequence[str] = ("n",)) -> pd.DataFrame:
    """Averages over the trials of each planner, recipe and reading, in reading order.

    Rows have columns ``PLANNER``, ``by``, seeds, trials and those of ``AVERAGES``; the share of
    safe trials is not a number where predicted.
    """
    return averaged(prepared(trials), [*PLANNER, *by], AVERAGES, ORDER)


def prepared(trials: pd.DataFrame) -> pd.DataFrame:
    """Trials with fuel_ratio (fuel over bound), and safe as 1 or 0, or NaN where predicted."""
    bound = trials["fuel_lower_bound"].astype(float)
    return trials.assign(
        recipe=trials["recipe"].fillna(""),
        safe=as_share(trials["safe"]).where(trials["reading"] != PREDICTED),
        fuel_ratio=trials["fuel"].astype(float) / bound.where(bound > NO_FUEL),
    )


def as_share(safe: "pd.Series[bool]") -> "pd.Series[float]":
    """1 where safe, else 0."""
    return safe.astype("boolean").fillna(False).astype(float)


def named(rows: pd.DataFrame) -> pd.DataFrame:
    """Rows with the names that the page has for planners."""
    return rows.assign(name=[name_of(planner) for planner in rows["planner"]])


def sizes_of_paper(rows: pd.DataFrame) -> pd.DataFrame:
    """Rows of swarms that are no larger than the paper's largest, n = 30."""
    return rows[rows["n"].astype(int) <= LARGEST_SIZE]


def reference_size(trials: pd.DataFrame) -> int:
    """The paper's n=10, or the size nearest to it that has trials (the smaller of two)."""
    return min(sorted(map(int, trials["n"].unique())), key=lambda n: abs(n - NETWORK_SIZE))


SHOWN = {"collisions": COLLISIONS, "safe": SAFE, "fuel": FUEL_RATIO}
"""Averages that have a table and a figure against a variable, by the table's name."""


def tables_against(
    summary: pd.DataFrame, experiment: str, variable: str, printed: Mapping[str, str]
) -> dict[str, Table]:
    """A table for each average of SHOWN: a row for each planner, a column for each value.

    The CSV file has a column for each value of the variable; the page has those that are
    ``printed``, by headings of its own. Predictions have no share of safe trials.
    """
    tables = {}
    for name, one in SHOWN.items():
        rows = summary[summary["reading"] != PREDICTED] if one is SAFE else summary
        frame, columns = wide(rows, PLANNER, variable, one, printed)
        tables[name] = Table(f"{experiment}-{name}", named(frame), [*NAMED, *columns])
    return tables


def printed_of(values: Iterable[Any], usual: Iterable[Any]) -> list[Any]:
    """Values with a column on the page: all if they are few, else the usual and both ends."""
    found, usual = sorted(set(values)), set(usual)
    few = len(found) <= len(usual) + 1
    return found if few else [v for v in found if v in usual | {found[0], found[-1]}]


def wide(
    rows: pd.DataFrame, index: list[str], variable: str, one: Average, printed: Mapping[str, str]
) -> tuple[pd.DataFrame, list[Average]]:
    """An average with a column for each value of a variable, in the rows' own order.

    Ends of intervals and spreads between trainings, where there are any, stand in columns
    ``VALUE low``, ``VALUE high`` and ``VALUE ±``. Columns of the page are those ``printed``.
    """
    frame, headings = rows[index].drop_duplicates(), list(dict.fromkeys(rows[variable]))
    suffixes = {one.source: "", **dict(zip(one.interval or (), (" low", " high"), strict=False))}
    spread = bool(one.spread) and rows[one.spread].notna().any()
    if spread:
        suffixes[one.spread] = " ±"
    for source, suffix in suffixes.items():
        values = rows.pivot(index=index, columns=variable, values=source)[headings]
        frame = frame.merge(values.add_suffix(suffix).reset_index(), on=index, how="left")
    columns = [
        replace(
            one,
            title=title,
            source=value,
            spread=f"{value} ±" if spread else "",
            interval=(f"{value} low", f"{value} high") if one.interval else None,
        )
        for value, title in printed.items()
    ]
    return frame, columns


class Panel(NamedTuple):
    """One panel of ``lines_figure``: rows of a summary, one for each planner and abscissa."""

    rows: pd.DataFrame
    average: Average
    title: str = ""


def lines_figure(
    grid: Sequence[Sequence[Panel]],
    against: tuple[str, str],
    look: Mapping[str, Style],
    size: tuple[float, float],
    quoted: Sequence[float] = (),
    handles: Sequence[Line2D] = (),
    **shared: Any,
) -> tuple[Figure, Any]:
    """Averages against a variable: a line for each planner, a band for its spread.

    All panels of an average have one scale, on which ``quoted`` values are, too. ``against`` is the
    column on the horizontal axis and its label; ``handles`` are further entries of the legend; size
    is in inches; ``shared`` goes to ``Figure.subplots``.
    """
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(len(grid), len(grid[0]), sharex=True, squeeze=False, **shared)
    panels = [panel for line in grid for panel in line]
    for ax, (rows, one, title) in zip(axes.flat, panels, strict=True):
        _draw_lines(ax, rows, against[0], one, look)
        ax.set_title(title)
        if one.text is share:
            ax.set_ylim(-0.03, 1.03)
            ax.yaxis.set_major_formatter(PercentFormatter(1.0))
        else:
            alike = [panel.rows[one.source] for panel in panels if panel.average is one]
            fit_scale(ax, "y", [*pd.concat(alike), *quoted])
    for line, shown in zip(axes, grid, strict=True):
        for k, (ax, panel) in enumerate(zip(line, shown, strict=True)):
            if not k or shown[k - 1].average is not panel.average:
                ax.set_ylabel(panel.average.title)
    for ax in axes[-1]:
        ax.set_xlabel(against[1])
    planners = planner_handles(pd.concat([panel.rows["planner"] for panel in panels]), look)
    handles, columns = [*planners, *handles], 3 if size[0] < PAGE_WIDTH else 4
    figure.legend(handles=handles, loc="outside lower center", ncols=columns, handlelength=3)
    return figure, axes


def _draw_lines(
    ax: Axes, rows: pd.DataFrame, against: str, one: Average, look: Mapping[str, Style]
) -> None:
    for k, planner in enumerate(in_order(rows["planner"])):
        line = rows[rows["planner"] == planner].drop_duplicates(against).sort_values(against)
        x, y, style = line[against], line[one.source], look[planner]
        step = max(1, len(line) // 8)  # some eight markers, at other points on the next line
        ax.plot(x, y, markevery=(k % step, step), **style.drawn)
        if one.spread and line[one.spread].notna().any():
            band = line[one.spread]
            ax.fill_between(x, y - band, y + band, color=style.colour, alpha=0.2, linewidth=0)


def planner_handles(planners: Iterable[str], look: Mapping[str, Style]) -> list[Line2D]:
    """A legend's entry for each planner."""
    return [Line2D([], [], label=name_of(p), **look[p].drawn) for p in in_order(planners)]
