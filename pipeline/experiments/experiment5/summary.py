"""Flights of experiment 5 summed up by planner, world, errors and loop."""

import pandas as pd

from pipeline.exhibits.numbers import error, number, ratio, share
from pipeline.exhibits.planners import in_order
from pipeline.experiments.averages import Average, averaged
from pipeline.experiments.clusters import clustered_interval
from pipeline.experiments.experiment5.rows import ERRORS, LOOPS, WORLDS
from pipeline.experiments.summary import NO_FUEL

CONDITION = ["world", "errors", "loop"]
"""Columns that say how a plan was flown."""

HIGH = 0.95
"""The quantile that is told beside the median."""


def _high(values: "pd.Series[float]") -> float:
    return float(values.quantile(HIGH))


WITHIN_RADIUS = Average(
    *("Within r_col", "within_radius_share", share),
    interval=("within_radius_low", "within_radius_high"),
    of="within_radius",
    label="flights within r_col",
)
WITHIN_SIZE = Average(
    *("Within size", "within_size_share", share),
    interval=("within_size_low", "within_size_high"),
    of="within_size",
)
SEPARATION = Average(
    *("Separation, least (m)", "separation_min", number),
    of="min_separation",
    how="min",
    over="min",
)
GOAL = Average("Off goal, median (m)", "goal_error_median", error, of="goal_error", how="median")
GOAL_HIGH = Average("95 % (m)", "goal_error_high", error, of="goal_error", how=_high)
VELOCITY = Average(
    "Velocity off, median (m/s)",
    *("goal_velocity_median", number),
    of="goal_velocity_error",
    how="median",
)
DELTA_V = Average(
    "Δv / bound, av.", "delta_v_ratio", ratio, of="delta_v_ratio", label="Δv / bound, average"
)
MOST_DELTA_V = Average(
    "Δv / bound, max.", "delta_v_most", ratio, of="delta_v_ratio", how="max", over="max"
)
NO_PLAN = Average("No safe plan", "no_plan_share", share, of="no_plan")
MARGIN = Average("Margin, av. (m)", "margin_mean", number, of="margin")

SHARES = (WITHIN_RADIUS, WITHIN_SIZE)
AVERAGES = (*SHARES, SEPARATION, GOAL, GOAL_HIGH, VELOCITY, DELTA_V, MOST_DELTA_V, NO_PLAN, MARGIN)


def summarize_flights(flights: pd.DataFrame) -> pd.DataFrame:
    """Averages over the flights of each planner and recipe in each condition, in reading order.

    Returns:
        planner, recipe, ``CONDITION``, seeds, trials (scenarios) and the columns of ``AVERAGES``;
        intervals of shares are ``clustered_interval``'s, since flights of one scenario are alike.
    """
    group = ["planner", "recipe", *CONDITION]
    rows = prepared(flights)
    summary = averaged(rows, group, AVERAGES)
    for one in SHARES:
        found = rows.groupby([*group, "trial"])[one.of].agg(["mean", "size"]).reset_index()
        intervals = {
            key: clustered_interval(part["mean"].to_numpy(), int(part["size"].max()))
            for key, part in found.groupby(group)
        }
        keys = summary[group].itertuples(index=False, name=None)
        summary[list(one.interval or ())] = [intervals[key] for key in keys]
    orders = {"planner": in_order(summary["planner"])}
    orders |= dict(zip(CONDITION, map(list, (WORLDS, ERRORS, LOOPS)), strict=True))

    def rank(column: "pd.Series[str]") -> "pd.Series[int] | pd.Series[str]":
        order = orders.get(str(column.name))
        return column if order is None else column.map(order.index).astype(int)

    return summary.sort_values(group, key=rank, ignore_index=True, kind="stable")


def prepared(flights: pd.DataFrame) -> pd.DataFrame:
    """Flights with Δv over its bound, and whether some node had no safe plan."""
    bound, unsafe = (flights[name].astype(float) for name in ("delta_v_bound", "unsafe_replans"))
    return flights.assign(
        recipe=flights["recipe"].fillna(""),
        within_radius=flights["within_radius"].astype(float),
        within_size=flights["within_size"].astype(float),
        delta_v_ratio=flights["delta_v"].astype(float) / bound.where(bound > NO_FUEL),
        no_plan=(unsafe > 0).astype(float).where(unsafe.notna()),
    )
