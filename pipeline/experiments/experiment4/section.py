"""The section on experiment 4: figures and tables against the transfer time."""

from collections.abc import Mapping
from typing import Any

import pandas as pd

from pipeline.exhibits.blocks import Picture, Table
from pipeline.exhibits.planners import BARGAINING
from pipeline.exhibits.sections import Section
from pipeline.exhibits.style import Style
from pipeline.experiments.against import tables_against
from pipeline.experiments.experiment4.figure import recipes_of, times_figure
from pipeline.experiments.experiment4.run import NODES, WAYS
from pipeline.experiments.experiment4.summary import summarize_times

TEMPLATE = "pipeline/experiments/experiment4/section.md.jinja"

PRINTED_MINUTES = (10, 14, 20, 30, 40)
"""Transfer times that the page shows where they were tried; the CSV files have all."""


def section(times: pd.DataFrame, look: Mapping[str, Style]) -> Section:
    """A figure for each recipe, and tables against the transfer time."""
    if times.empty:
        return Section(TEMPLATE, {"tables": {}})
    averages = summarize_times(times)
    pictures = {
        recipe: Picture(f"experiment4-{recipe}".strip("-"), times_figure(averages, recipe, look))
        for recipe in recipes_of(averages)
    }
    values = {
        "refiner": times["planner"].isin(BARGAINING).any(),
        "n": times["n"].iloc[0],
        "trials": averages["trials"].max(),
        "trainings": averages["seeds"].max(),
        "pictures": pictures,
        "tables": times_tables(averages),
    }
    return Section(TEMPLATE, values)


def times_tables(averages: pd.DataFrame) -> dict[str, Table]:
    """Collisions, share of safe trials and fuel: a column for each of a few transfer times."""
    rows = averages.assign(grid=[_title(row) for _, row in averages.iterrows()])
    return tables_against(rows, "experiment4", "grid", {t: t for t in _printed(rows)})


def _title(row: "pd.Series[Any]") -> str:
    grid = f"T = {row['nodes']}" if row["varied"] == NODES else f"Δt = {row['time_step']:g} s"
    return f"{row['minutes']:.3g} min, {grid}"


def _printed(rows: pd.DataFrame) -> list[str]:
    """Either way, the usual times with the shortest and longest; all where they are few."""
    shown: list[str] = []
    for way in WAYS:
        mine = rows[rows["varied"] == way].sort_values("minutes", kind="stable")
        minutes = sorted(set(mine["minutes"]))
        if len(minutes) > len(PRINTED_MINUTES) + 1:
            usual = {*PRINTED_MINUTES, minutes[0], minutes[-1]}
            mine = mine[mine["minutes"].isin(usual)]
        shown += dict.fromkeys(mine["grid"])
    return shown
