"""Tables of experiment 3: what a seed does for the expert, and for the plain SCP."""

import pandas as pd

from pipeline.exhibits.blocks import Column, Table
from pipeline.exhibits.numbers import number, ratio, share
from pipeline.exhibits.planners import label_name
from pipeline.experiments.experiment3.averages import summarize_warmstarts
from pipeline.experiments.experiment3.rows import PLAIN
from pipeline.experiments.spread import INTERVALS, SAFE, spread_note


def warmstart_tables(warmstarts: pd.DataFrame, optimizer: str) -> list[Table]:
    """One table for each swarm size, each seed under each stopping rule of an optimizer."""
    summary = summarize_warmstarts(warmstarts[warmstarts["optimizer"] == optimizer])
    make = _plain_table if optimizer == PLAIN else _expert_table
    sizes = sorted(int(n) for n in summary["n"].unique())
    return [make(_named(summary[summary["n"] == n]), n) for n in sizes]


def _named(rows: pd.DataFrame) -> pd.DataFrame:
    return rows.assign(
        name=[label_name(s) for s in rows["seed"]],
        gap_percent=100 * rows["gap_mean"],
        gap_percent_spread=100 * rows["gap_spread"],
    ).reset_index(drop=True)


def _expert_table(frame: pd.DataFrame, n: int) -> Table:
    columns = [
        Column("Stop", "rule"),
        Column("Seed", "name"),
        Column("Convex solves, av.", "solves_mean", number),
        Column("Done in one", "one_solve_share", share),
        Column("Time, median (s)", "seconds_median", number),
        Column("Time / no seed", "time_ratio", ratio, "ratio_spread"),
        Column("Gap, av. (%)", "gap_percent", number, "gap_percent_spread"),
        Column("Safe at all times", "safe_share", share, interval=SAFE),
    ]
    trials = int(frame["trials"].max())
    caption = (
        f"Convex solves and time of the expert from each seed at n = {n} over {trials:,} trials. "
        f"The gap is fuel over its lower bound, less one.{INTERVALS}{spread_note(frame)}"
    )
    return Table(f"experiment3-n{n}", caption, frame, columns)


def _plain_table(frame: pd.DataFrame, n: int) -> Table:
    columns = [
        Column("Seed", "name"),
        Column("Convex solves, av.", "solves_mean", number),
        Column("Done in one", "one_solve_share", share),
        Column("Time, av. (s)", "seconds_mean", number),
        Column("Time, s.d. (s)", "seconds_deviation", number),
        Column("Time, median (s)", "seconds_median", number),
        Column("Time / no seed", "time_ratio", ratio, "ratio_spread"),
        Column("Gap, av. (%)", "gap_percent", number, "gap_percent_spread"),
        Column("Clear at the nodes", "solved_share", share, interval=("solved_low", "solved_high")),
        Column("Safe at all times", "safe_share", share, interval=SAFE),
    ]
    trials = int(frame["trials"].max())
    caption = (
        f"Convex solves and time of the plain SCP from each seed at n = {n} over {trials:,} "
        "trials, until converged. s.d. is the standard deviation over the trials; the gap is fuel "
        f"over its lower bound, less one.{INTERVALS}{spread_note(frame)}"
    )
    return Table(f"experiment3-plain-n{n}", caption, frame, columns)
