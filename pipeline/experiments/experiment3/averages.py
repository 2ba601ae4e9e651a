"""Warm starts averaged over scenarios and over training seeds."""

import numpy as np
import pandas as pd

from pipeline.exhibits.planners import in_order, planner_of
from pipeline.experiments.averages import as_share, with_interval
from pipeline.plan import SOLVED

GROUP = ["optimizer", "n", "rule", "seed"]
"""What a row of the summary stands for."""

SPREAD = {"time_ratio": "ratio_spread", "gap_mean": "gap_spread"}
"""By column of the summary, the one that holds its spread over the training seeds."""


def summarize_warmstarts(warmstarts: pd.DataFrame) -> pd.DataFrame:
    """Averages over the trials of each optimizer, n, rule and seed.

    The seeds of a network that was trained with several training seeds share one row, the average
    of its trainings; the spread is the standard deviation between them.

    Returns:
        ``GROUP`` and seeds (trainings averaged), trials, solves_mean, one_solve_share (at most one
        convex solve), seconds_median, seconds_mean, seconds_deviation (standard deviation over the
        trials), gap_mean (of the finite gaps), fuel_mean, solved_share, safe_share, time_ratio (to
        the median of seed "none" of the same optimizer, n and rule; NaN without one), the columns
        of ``SPREAD`` (NaN where there is one training), and Wilson's intervals safe_low,
        safe_high, solved_low and solved_high.
    """
    gap = warmstarts["optimality_gap"].astype(float)
    rows = warmstarts.assign(
        one=(warmstarts["convex_solves"] <= 1).astype(float),
        solved=(warmstarts["status"] == SOLVED).astype(float),
        safe=as_share(warmstarts["safe"]),
        gap=gap.where(np.isfinite(gap)),
    )
    each = rows.groupby([*GROUP, "training_seed"], as_index=False, sort=False).agg(
        trials=("trial", "nunique"),
        solves_mean=("convex_solves", "mean"),
        one_solve_share=("one", "mean"),
        seconds_median=("seconds", "median"),
        seconds_mean=("seconds", "mean"),
        seconds_deviation=("seconds", "std"),
        gap_mean=("gap", "mean"),
        fuel_mean=("fuel", "mean"),
        solved_share=("solved", "mean"),
        safe_share=("safe", "mean"),
    )
    among = GROUP[:-1]
    none = each[each["seed"] == "none"].set_index(among)["seconds_median"]
    base = none.reindex(pd.MultiIndex.from_frame(each[among])).to_numpy(dtype=float)
    groups = each.assign(time_ratio=each["seconds_median"] / base).groupby(
        GROUP, as_index=False, sort=False
    )
    summary = groups.mean().drop(columns="training_seed")
    summary.insert(len(GROUP), "seeds", groups["training_seed"].nunique()["training_seed"])
    spread = groups[list(SPREAD)].std().rename(columns=SPREAD)
    summary = summary.assign(**{column: spread[column] for column in SPREAD.values()})
    summary = with_interval(with_interval(summary, "safe_share", "safe"), "solved_share", "solved")
    order = {seed: k for k, seed in enumerate(seeds_in_order(summary["seed"]))}
    return summary.sort_values(
        GROUP, key=lambda c: c.map(order) if c.name == "seed" else c, ignore_index=True
    )


def seeds_in_order(seeds: "pd.Series[str]") -> list[str]:
    """Distinct seeds: none first, then by planner and recipe."""
    planners = in_order(planner_of(s) for s in seeds)
    return sorted(
        {str(s) for s in seeds}, key=lambda s: (s != "none", planners.index(planner_of(s)), s)
    )
