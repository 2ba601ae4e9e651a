"""Trials and warm starts averaged over their repetitions."""

import numpy as np
import pandas as pd

from pipeline.report.paper_values import NETWORK_SIZE
from pipeline.report.results import FLOWN, PLAN, PREDICTED
from pipeline.report.style import in_order, planner_of

GROUP = ["planner", "recipe", "reading", "n"]
"""What a row of the summary stands for."""

NO_FUEL = 1e-9
"""A bound in m/s² below which fuel / bound says nothing."""

RECIPES = ["", "paper", "tuned"]
READINGS = [PLAN, PREDICTED, FLOWN]


def summarize(trials: pd.DataFrame) -> pd.DataFrame:
    """Averages over the trials of each planner, recipe, reading and n, in reading order.

    Returns:
        ``GROUP`` and trials, collisions_mean, collisions_max, conflicts_mean, safe_share (NaN
        where predicted), separation_min (m), fuel_mean (m/s²), bound_mean, fuel_ratio (mean over
        the trials of fuel / bound), boundary_error and dynamics_error (mean, m), seconds_mean,
        convex_solves_mean.
    """
    bound = trials["fuel_lower_bound"].astype(float)
    rows = trials.assign(
        recipe=trials["recipe"].fillna(""),
        safe=as_share(trials["safe"]).where(trials["reading"] != PREDICTED),
        fuel_ratio=trials["fuel"].astype(float) / bound.where(bound > NO_FUEL),
    )
    summary = rows.groupby(GROUP, as_index=False, sort=False).agg(
        trials=("trial", "nunique"),
        collisions_mean=("node_collisions", "mean"),
        collisions_max=("node_collisions", "max"),
        conflicts_mean=("pair_conflicts", "mean"),
        safe_share=("safe", "mean"),
        separation_min=("min_separation", "min"),
        fuel_mean=("fuel", "mean"),
        bound_mean=("fuel_lower_bound", "mean"),
        fuel_ratio=("fuel_ratio", "mean"),
        boundary_error=("boundary_error", "mean"),
        dynamics_error=("dynamics_error", "mean"),
        seconds_mean=("seconds", "mean"),
        convex_solves_mean=("convex_solves", "mean"),
    )
    return _ordered(summary)


def summarize_warmstarts(warmstarts: pd.DataFrame) -> pd.DataFrame:
    """Averages over the trials of each n, rule and seed.

    Returns:
        n, rule, seed, trials, solves_mean, one_solve_share (at most one convex solve),
        seconds_median, time_ratio (to the median of seed "none" at the same n and rule; NaN
        without one), gap_mean (of the finite gaps), fuel_mean, safe_share.
    """
    gap = warmstarts["optimality_gap"].astype(float)
    rows = warmstarts.assign(
        one=(warmstarts["convex_solves"] <= 1).astype(float),
        safe=as_share(warmstarts["safe"]),
        gap=gap.where(np.isfinite(gap)),
    )
    summary = rows.groupby(["n", "rule", "seed"], as_index=False, sort=False).agg(
        trials=("trial", "nunique"),
        solves_mean=("convex_solves", "mean"),
        one_solve_share=("one", "mean"),
        seconds_median=("seconds", "median"),
        gap_mean=("gap", "mean"),
        fuel_mean=("fuel", "mean"),
        safe_share=("safe", "mean"),
    )
    none = summary[summary["seed"] == "none"].set_index(["n", "rule"])["seconds_median"]
    base = none.reindex(pd.MultiIndex.from_frame(summary[["n", "rule"]])).to_numpy(dtype=float)
    summary.insert(7, "time_ratio", summary["seconds_median"].to_numpy(dtype=float) / base)
    order = {seed: k for k, seed in enumerate(seeds_in_order(summary["seed"]))}
    return summary.sort_values(
        ["n", "rule", "seed"],
        key=lambda c: c.map(order) if c.name == "seed" else c,
        ignore_index=True,
    )


def reference_size(trials: pd.DataFrame) -> int:
    """The paper's n=10, or the size nearest to it that has trials (the smaller of two)."""
    sizes = sorted(int(n) for n in trials["n"].unique())
    return min(sizes, key=lambda n: abs(n - NETWORK_SIZE))


def seeds_in_order(seeds: "pd.Series[str]") -> list[str]:
    """Distinct seeds: none first, then by planner and recipe."""
    planners = in_order(planner_of(s) for s in seeds)
    return sorted(
        {str(s) for s in seeds}, key=lambda s: (s != "none", planners.index(planner_of(s)), s)
    )


def as_share(safe: "pd.Series[bool]") -> "pd.Series[float]":
    """1 where safe, 0 where not or not claimed."""
    return safe.astype("boolean").fillna(False).astype(float)


def _ordered(summary: pd.DataFrame) -> pd.DataFrame:
    planners = in_order(summary["planner"])
    ranks = {"planner": planners, "recipe": RECIPES, "reading": READINGS}

    def rank(column: "pd.Series[str]") -> "pd.Series[int]":
        order = ranks.get(str(column.name))
        if order is None:
            return column.astype(int)
        return column.map(lambda v: order.index(v) if v in order else len(order)).astype(int)

    return summary.sort_values(GROUP, key=rank, ignore_index=True, kind="stable")
