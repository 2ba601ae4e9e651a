"""Trials of experiment 4 summed up at each transfer time."""

from dataclasses import dataclass

import pandas as pd

from pipeline.experiments.experiment4.run import WAYS
from pipeline.experiments.summary import summarize


@dataclass(frozen=True)
class TimeGrid:
    """Nodes and step of a transfer.

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
        The columns of ``summarize`` by ``TIME`` and minutes (transfer time).
    """
    return summarize(with_minutes(times), ["varied", "minutes", "nodes", "time_step"])


def with_minutes(times: pd.DataFrame) -> pd.DataFrame:
    """Trials with their transfer times in minutes."""
    return times.assign(minutes=((times["nodes"] - 1) * times["time_step"] / 60).round(6))


def trained_on(times: pd.DataFrame) -> TimeGrid:
    """The training's time grid: the Δt that goes with other T, and the T with other Δt."""
    other_nodes, other_steps = (times[times["varied"] == way] for way in WAYS)
    return TimeGrid(int(other_steps["nodes"].iloc[0]), float(other_nodes["time_step"].iloc[0]))


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
