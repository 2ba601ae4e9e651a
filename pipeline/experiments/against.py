"""Tables against a variable: a row for each planner, a column for each of its values."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import pandas as pd

from pipeline.exhibits.blocks import Column, Table
from pipeline.exhibits.numbers import number, ratio, share
from pipeline.exhibits.planners import name_of
from pipeline.experiments.averages import SPREAD
from pipeline.experiments.spread import INTERVALS, SAFE, spread_note
from pipeline.experiments.trials import PREDICTED

PLANNER = ["planner", "recipe", "reading"]

ENDS = (" low", " high")
"""What columns of the ends of an interval in the CSV file are called by."""

SPREAD_SUFFIX = " ±"
"""What a column of spreads in the CSV file is called by."""


@dataclass(frozen=True)
class Against:
    """What planners are compared against.

    Attributes:
        name: of the experiment, which the tables' names begin with.
        called: the variable, in captions.
        column: of the summary, with the heading of each row's value in the CSV file.
        printed: what the page shows: by such a heading, its own.
    """

    name: str
    called: str
    column: str
    printed: Mapping[str, str]


def tables_against(summary: pd.DataFrame, variable: Against) -> list[Table]:
    """Collisions, share of safe trials and fuel over its bound."""
    claimed = summary[summary["reading"] != PREDICTED]
    by, note = f"by {variable.called}", spread_note(summary)
    safe = "Share of trials in which no pair comes within the collision radius at any time, "
    return [
        _pivot(
            summary,
            variable,
            *("collisions", "collisions_mean", number),
            f"Average node collisions (Eq. 5) {by}.{note}",
        ),
        _pivot(claimed, variable, "safe", "safe_share", share, f"{safe}{by}.{INTERVALS}{note}"),
        _pivot(
            summary,
            variable,
            *("fuel", "fuel_ratio", ratio),
            f"Average of fuel over its lower bound {by}.{note}",
        ),
    ]


def _pivot(
    rows: pd.DataFrame,
    variable: Against,
    name: str,
    value: str,
    text: Callable[[float], str],
    caption: str,
) -> Table:
    # The summary's order is kept: pivoting would sort planners and values by name.
    frame = rows[PLANNER].drop_duplicates()
    headings = list(dict.fromkeys(rows[variable.column]))
    shown = {value: ""} | (dict(zip(SAFE, ENDS, strict=True)) if value == "safe_share" else {})
    if rows[SPREAD[value]].notna().any():
        shown[SPREAD[value]] = SPREAD_SUFFIX
    for source, suffix in shown.items():
        wide = rows.pivot(index=PLANNER, columns=variable.column, values=source)[headings]
        frame = frame.merge(wide.add_suffix(suffix).reset_index(), on=PLANNER, how="left")
    frame = frame.assign(name=[name_of(p) for p in frame["planner"]])
    columns = [
        Column("Planner", "name"),
        Column("Recipe", "recipe"),
        Column("Reading", "reading"),
        *(
            Column(
                title,
                heading,
                text,
                heading + SPREAD_SUFFIX if SPREAD[value] in shown else "",
                (heading + ENDS[0], heading + ENDS[1]) if SAFE[0] in shown else None,
            )
            for heading, title in variable.printed.items()
        ),
    ]
    return Table(f"{variable.name}-{name}", caption, frame, columns)
