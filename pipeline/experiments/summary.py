"""Trials summed up by planner: the averages of experiments 1, 2 and 4."""

from collections.abc import Sequence

import pandas as pd

from pipeline.exhibits.blocks import Column
from pipeline.exhibits.numbers import count, error, number, ratio, share
from pipeline.exhibits.planners import in_order, name_of
from pipeline.experiments.averages import Average, averaged
from pipeline.experiments.paper import LARGEST_SIZE, NETWORK_SIZE
from pipeline.experiments.trials import FLOWN, PLAN, PREDICTED

PLANNER = ["planner", "recipe", "reading"]
"""What a planner's row of a summary stands for, beside the swarm size or the transfer time."""

NAMED = [Column("Planner", "name"), Column("Recipe", "recipe"), Column("Reading", "reading")]
"""The same on the page, for rows from ``named``."""

COLLISIONS = Average(
    *("Collisions, av.", "collisions_mean", number, "collisions_spread"),
    of="node_collisions",
    label="node collisions, average",
)
MOST_COLLISIONS = Average(
    *("Collisions, max.", "collisions_max", count), of="node_collisions", how="max", over="max"
)
CONFLICTS = Average("Pairs too close, av.", "conflicts_mean", number, of="pair_conflicts")
SAFE = Average(
    *("Safe at all times", "safe_share", share, "safe_spread", ("safe_low", "safe_high")),
    of="safe",
    label="share of safe trials",
)
SEPARATION = Average(
    *("Separation, least (m)", "separation_min", number),
    of="min_separation",
    how="min",
    over="min",
)
FUEL = Average(
    *("Fuel, av. (m/s²)", "fuel_mean", number, "fuel_spread"),
    of="fuel",
    label="fuel, average (m/s²)",
)
BOUND = Average("Bound, av. (m/s²)", "bound_mean", number, of="fuel_lower_bound")
FUEL_RATIO = Average(
    *("Fuel / bound, av.", "fuel_ratio", ratio, "fuel_ratio_spread"),
    of="fuel_ratio",
    label="fuel / bound, average",
)
BOUNDARY = Average("Boundary error (m)", "boundary_error", error, of="boundary_error")
DYNAMICS = Average("Dynamics error (m)", "dynamics_error", error, of="dynamics_error")
SECONDS = Average(
    "Time, av. (s)", "seconds_mean", number, of="seconds", label="time per instance (s)"
)
SOLVES = Average("Convex solves, av.", "convex_solves_mean", number, of="convex_solves")

AVERAGES = (
    *(COLLISIONS, MOST_COLLISIONS, CONFLICTS, SAFE, SEPARATION, FUEL, BOUND, FUEL_RATIO),
    *(BOUNDARY, DYNAMICS, SECONDS, SOLVES),
)

NO_FUEL = 1e-9
"""A bound in m/s² below which fuel / bound says nothing."""

RANKS = {"recipe": ["", "paper", "tuned"], "reading": [PLAN, PREDICTED, FLOWN]}
"""Reading order of a planner's rows; what else there is comes last."""


def summarize(trials: pd.DataFrame, by: Sequence[str] = ("n",)) -> pd.DataFrame:
    """Averages over the trials of each planner, recipe and reading, in reading order.

    Args:
        trials: a row each trial.
        by: further columns, each of whose values has rows of its own.

    Returns:
        ``PLANNER``, ``by``, seeds, trials and the columns of ``AVERAGES``; the share of safe
        trials is not a number where predicted.
    """
    group = [*PLANNER, *by]
    summary = averaged(prepared(trials), group, AVERAGES)
    ranks = {"planner": in_order(summary["planner"])} | RANKS

    def rank(column: "pd.Series[str]") -> "pd.Series[int] | pd.Series[str]":
        order = ranks.get(str(column.name))
        if order is None:
            return column
        return column.map(lambda v: order.index(v) if v in order else len(order)).astype(int)

    return summary.sort_values(group, key=rank, ignore_index=True, kind="stable")


def prepared(trials: pd.DataFrame) -> pd.DataFrame:
    """Trials with fuel_ratio, fuel over its bound, and safe as 1 or 0 where it is claimed."""
    bound = trials["fuel_lower_bound"].astype(float)
    return trials.assign(
        recipe=trials["recipe"].fillna(""),
        safe=as_share(trials["safe"]).where(trials["reading"] != PREDICTED),
        fuel_ratio=trials["fuel"].astype(float) / bound.where(bound > NO_FUEL),
    )


def as_share(safe: "pd.Series[bool]") -> "pd.Series[float]":
    """1 where safe, 0 where not or not known."""
    return safe.astype("boolean").fillna(False).astype(float)


def named(rows: pd.DataFrame) -> pd.DataFrame:
    """Rows with the names that the page has for planners."""
    return rows.assign(name=[name_of(planner) for planner in rows["planner"]])


def sizes_of_paper(rows: pd.DataFrame) -> pd.DataFrame:
    """Rows of swarms that are no larger than the paper's largest, n = 30."""
    return rows[rows["n"].astype(int) <= LARGEST_SIZE]


def reference_size(trials: pd.DataFrame) -> int:
    """The paper's n=10, or the size nearest to it that has trials (the smaller of two)."""
    sizes = sorted(int(n) for n in trials["n"].unique())
    return min(sizes, key=lambda n: abs(n - NETWORK_SIZE))
