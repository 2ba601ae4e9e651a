"""Tables of experiment 4: a row for each planner, a column for each of a few transfer times."""

from collections.abc import Callable
from typing import Any

import pandas as pd

from pipeline.report.blocks import Column, Table
from pipeline.report.numbers import number, ratio, share
from pipeline.report.results import PREDICTED
from pipeline.report.style import name_of
from pipeline.report.summary import SPREAD
from pipeline.report.summary_times import PLANNER, WAYS
from pipeline.report.tables import spread_note

PRINTED_MINUTES = (10, 14, 20, 30, 40)
"""Transfer times that the page shows where they were tried; the CSV files have all."""

SPREAD_SUFFIX = " ±"
"""What a transfer time's column of spreads is called by."""


def times_tables(summary: pd.DataFrame) -> list[Table]:
    """Collisions, share of safe trials and fuel against the transfer time.

    Args:
        summary: from ``summarize_times``.
    """
    claimed = summary[summary["reading"] != PREDICTED]
    note = spread_note(summary)
    return [
        _pivot(
            summary,
            "collisions_mean",
            number,
            "experiment4-collisions",
            f"Average node collisions (Eq. 5) by transfer time.{note}",
        ),
        _pivot(
            claimed,
            "safe_share",
            share,
            "experiment4-safe",
            "Share of trials in which no pair comes within the collision radius at any time, by "
            f"transfer time.{note}",
        ),
        _pivot(
            summary,
            "fuel_ratio",
            ratio,
            "experiment4-fuel",
            f"Average of fuel over its lower bound at the same transfer time.{note}",
        ),
    ]


def _pivot(
    rows: pd.DataFrame, value: str, text: Callable[[float], str], name: str, caption: str
) -> Table:
    rows = rows.assign(column=[_title(row) for _, row in rows.iterrows()])
    frame = rows[PLANNER].drop_duplicates()
    shown = {"": value, SPREAD_SUFFIX: SPREAD[value]}
    if rows[SPREAD[value]].isna().all():
        del shown[SPREAD_SUFFIX]
    for suffix, source in shown.items():
        wide = rows.pivot(index=PLANNER, columns="column", values=source)[_titles(rows)]
        frame = frame.merge(wide.add_suffix(suffix).reset_index(), on=PLANNER, how="left")
    frame = frame.assign(name=[name_of(p) for p in frame["planner"]])
    spread = SPREAD_SUFFIX in shown
    columns = [
        Column("Planner", "name"),
        Column("Recipe", "recipe"),
        Column("Reading", "reading"),
        *(Column(t, t, text, t + SPREAD_SUFFIX if spread else "") for t in _printed(rows)),
    ]
    return Table(name, caption, frame, columns)


def _title(row: "pd.Series[Any]") -> str:
    grid = f"T = {row['nodes']}" if row["varied"] == WAYS[0] else f"Δt = {row['time_step']:g} s"
    return f"{row['minutes']:.3g} min, {grid}"


def _titles(rows: pd.DataFrame) -> list[str]:
    """Headings of all transfer times: other T, then other Δt."""
    ordered = rows.sort_values(["varied", "minutes"], kind="stable")
    return list(dict.fromkeys(ordered["column"]))


def _printed(rows: pd.DataFrame) -> list[str]:
    """Either way, the usual times with the shortest and longest; all where they are few."""
    shown: list[str] = []
    for way in WAYS:
        mine = rows[rows["varied"] == way]
        minutes = sorted(set(mine["minutes"]))
        if len(minutes) > len(PRINTED_MINUTES) + 1:
            usual = {*PRINTED_MINUTES, minutes[0], minutes[-1]}
            mine = mine[mine["minutes"].isin(usual)]
        shown += _titles(mine)
    return shown
