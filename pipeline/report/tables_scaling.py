"""Tables of experiment 2: a row for each planner, a column for each of a few swarm sizes."""

from collections.abc import Callable

import pandas as pd

from pipeline.report.blocks import Column, Table
from pipeline.report.numbers import number, ratio, share
from pipeline.report.results import PREDICTED
from pipeline.report.style import name_of
from pipeline.report.summary import SPREAD
from pipeline.report.tables import spread_note

PRINTED_SIZES = (2, 5, 10, 20, 30)
"""Swarm sizes that the page shows where they were evaluated; the CSV files have all."""

KEYS = ["planner", "recipe", "reading"]

SPREAD_SUFFIX = " ±"
"""What a swarm size's column of spreads is called by."""


def scaling_tables(summary: pd.DataFrame) -> list[Table]:
    """Collisions, share of safe trials and fuel against n."""
    claimed = summary[summary["reading"] != PREDICTED]
    note = spread_note(summary)
    return [
        _pivot(
            summary,
            "collisions_mean",
            number,
            "experiment2-collisions",
            f"Average node collisions (Eq. 5) by swarm size.{note}",
        ),
        _pivot(
            claimed,
            "safe_share",
            share,
            "experiment2-safe",
            "Share of trials in which no pair comes within the collision radius at any time."
            f"{note}",
        ),
        _pivot(
            summary,
            "fuel_ratio",
            ratio,
            "experiment2-fuel",
            f"Average of fuel over its lower bound by swarm size.{note}",
        ),
    ]


def _pivot(
    rows: pd.DataFrame, value: str, text: Callable[[float], str], name: str, caption: str
) -> Table:
    # The summary's order is kept: pivoting would sort the planners by name.
    order = rows[KEYS].drop_duplicates()
    frame = order
    for column, suffix in ((value, ""), (SPREAD[value], SPREAD_SUFFIX)):
        if suffix and rows[column].isna().all():
            continue
        wide = rows.pivot(index=KEYS, columns="n", values=column)
        wide.columns = pd.Index([f"{n}{suffix}" for n in wide.columns])
        frame = frame.merge(wide.reset_index(), on=KEYS, how="left")
    sizes = [str(n) for n in _printed(sorted(int(n) for n in rows["n"].unique()))]
    frame = frame.assign(name=[name_of(p) for p in frame["planner"]])
    columns = [
        Column("Planner", "name"),
        Column("Recipe", "recipe"),
        Column("Reading", "reading"),
        *(Column(f"n = {n}", n, text, _spread_of(n, frame)) for n in sizes),
    ]
    return Table(name, caption, frame, columns)


def _spread_of(n: str, frame: pd.DataFrame) -> str:
    column = n + SPREAD_SUFFIX
    return column if column in frame.columns else ""


def _printed(sizes: list[int]) -> list[int]:
    """The usual sizes with the smallest and largest; all of them where they are few."""
    if len(sizes) <= len(PRINTED_SIZES) + 1:
        return sizes
    return [n for n in sizes if n in PRINTED_SIZES or n in (sizes[0], sizes[-1])]
