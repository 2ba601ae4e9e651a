"""Trials of experiment 4 averaged at each transfer time."""

from dataclasses import dataclass

import pandas as pd

from pipeline.experiments.averages import summarize

WAYS = ("nodes", "time_step")
"""The two ways to another transfer time: other T, other Δt."""

TIME = ["varied", "nodes", "time_step"]
"""What a transfer time is known by."""

PLANNER = ["planner", "recipe", "reading"]


@dataclass(frozen=True)
class Training:
    """The time grid that the networks were trained on.

    Attributes:
        nodes: T.
        time_step: Δt, s.
    """

    nodes: int
    time_step: float

    @property
    def minutes(self) -> float:
        """The transfer time."""
        return (self.nodes - 1) * self.time_step / 60


def summarize_times(times: pd.DataFrame) -> pd.DataFrame:
    """Averages over the trials of each planner, recipe and reading at each transfer time.

    Returns:
        ``TIME``, minutes (transfer time) and the columns of ``summarize``; planners in reading
        order, each by what is varied and by minutes.
    """
    parts = [
        summarize(rows).merge(rows[TIME].head(1), how="cross") for _, rows in times.groupby(TIME)
    ]
    summary = pd.concat(parts, ignore_index=True)
    minutes = ((summary["nodes"] - 1) * summary["time_step"] / 60).round(6)
    ordered = summary.assign(minutes=minutes).sort_values(["varied", "minutes"], kind="stable")
    # Networks do not take part everywhere, so only all trials together have every planner.
    return summarize(times)[PLANNER].drop_duplicates().merge(ordered, on=PLANNER)


def trained_on(times: pd.DataFrame) -> Training:
    """The training's time grid: the Δt that goes with other T, and the T with other Δt."""
    other_nodes, other_steps = (times[times["varied"] == way] for way in WAYS)
    return Training(int(other_steps["nodes"].iloc[0]), float(other_nodes["time_step"].iloc[0]))


def of_way(summary: pd.DataFrame, way: str) -> pd.DataFrame:
    """The rows of one way, with those at the training's own time even if the other way has them.

    Args:
        summary: from ``summarize_times``.
        way: of ``WAYS``.
    """
    trained, mine = trained_on(summary), summary[summary["varied"] == way]
    home = (summary["nodes"] == trained.nodes) & (summary["time_step"] == trained.time_step)
    if (home & (summary["varied"] == way)).any():
        return mine
    return pd.concat([mine, summary[home]])
