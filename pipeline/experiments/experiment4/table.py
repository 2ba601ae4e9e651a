"""Tables of experiment 4: a row for each planner, a column for each of a few transfer times."""

from typing import Any

import pandas as pd

from pipeline.exhibits.blocks import Table
from pipeline.experiments.against import Against, tables_against
from pipeline.experiments.experiment4.averages import WAYS

PRINTED_MINUTES = (10, 14, 20, 30, 40)
"""Transfer times that the page shows where they were tried; the CSV files have all."""


def times_tables(summary: pd.DataFrame) -> list[Table]:
    """Collisions, share of safe trials and fuel against the transfer time.

    Args:
        summary: from ``summarize_times``.
    """
    rows = summary.assign(grid=[_title(row) for _, row in summary.iterrows()])
    printed = {title: title for title in _printed(rows)}
    return tables_against(rows, Against("experiment4", "transfer time", "grid", printed))


def _title(row: "pd.Series[Any]") -> str:
    grid = f"T = {row['nodes']}" if row["varied"] == WAYS[0] else f"Δt = {row['time_step']:g} s"
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
