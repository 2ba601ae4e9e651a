"""Tables of experiment 3: what a seed does for the expert."""

import pandas as pd

from pipeline.report.blocks import Column, Table
from pipeline.report.numbers import number, ratio, share
from pipeline.report.planners import label_name
from pipeline.report.summary.warmstart import summarize_warmstarts
from pipeline.report.tables.spread import spread_note


def warmstart_tables(warmstarts: pd.DataFrame) -> list[Table]:
    """One table for each swarm size, each seed under each stopping rule."""
    summary = summarize_warmstarts(warmstarts)
    return [_table(summary[summary["n"] == n], int(n)) for n in sorted(summary["n"].unique())]


def _table(rows: pd.DataFrame, n: int) -> Table:
    frame = rows.assign(
        name=[label_name(s) for s in rows["seed"]],
        gap_percent=100 * rows["gap_mean"],
        gap_percent_spread=100 * rows["gap_spread"],
    ).reset_index(drop=True)
    columns = [
        Column("Stop", "rule"),
        Column("Seed", "name"),
        Column("Convex solves, av.", "solves_mean", number),
        Column("Done in one", "one_solve_share", share),
        Column("Time, median (s)", "seconds_median", number),
        Column("Time / no seed", "time_ratio", ratio, "ratio_spread"),
        Column("Gap, av. (%)", "gap_percent", number, "gap_percent_spread"),
        Column("Safe at all times", "safe_share", share),
    ]
    trials = int(frame["trials"].max())
    caption = (
        f"Convex solves and time of the expert from each seed at n = {n} over {trials:,} trials. "
        f"The gap is fuel over its lower bound, less one.{spread_note(frame)}"
    )
    return Table(f"experiment3-n{n}", caption, frame, columns)
