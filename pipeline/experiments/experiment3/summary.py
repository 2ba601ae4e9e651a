"""Warm starts summed up by seed: the averages of experiment 3."""

from collections.abc import Iterable

import numpy as np
import pandas as pd

from pipeline.exhibits.numbers import number, ratio, share
from pipeline.exhibits.planners import in_order, planner_of
from pipeline.experiments.averages import Average, averaged
from pipeline.experiments.experiment3.rows import NO_SEED
from pipeline.experiments.summary import as_share
from pipeline.plan import SOLVED

GROUP = ["optimizer", "n", "rule", "seed"]
"""What a row of the summary stands for."""


def percent(gap: float) -> str:
    """A gap in percent."""
    return number(100 * gap)


SOLVES = Average("Convex solves, av.", "solves_mean", number, of="convex_solves")
ONE_SOLVE = Average("Done in one", "one_solve_share", share, of="one")
MEDIAN = Average("Time, median (s)", "seconds_median", number, of="seconds", how="median")
MEAN = Average("Time, av. (s)", "seconds_mean", number, of="seconds")
DEVIATION = Average("Time, s.d. (s)", "seconds_deviation", number, of="seconds", how="std")
GAP = Average("Gap, av. (%)", "gap_mean", percent, "gap_spread", of="gap")
FUEL = Average("Fuel, av. (m/s²)", "fuel_mean", number, of="fuel")
CLEAR = Average(
    *("Clear at the nodes", "solved_share", share),
    interval=("solved_low", "solved_high"),
    of="solved",
)
SAFE = Average(
    "Safe at all times", "safe_share", share, interval=("safe_low", "safe_high"), of="safe"
)
TIME_RATIO = Average(
    "Time / no seed", "time_ratio", ratio, "ratio_spread", of="ratio", how="median"
)

AVERAGES = (SOLVES, ONE_SOLVE, MEDIAN, MEAN, DEVIATION, GAP, FUEL, CLEAR, SAFE, TIME_RATIO)


def summarize_warmstarts(warmstarts: pd.DataFrame) -> pd.DataFrame:
    """Averages over the trials of each optimizer, n, rule and seed.

    Args:
        warmstarts: a row each run of an optimizer.

    Returns:
        ``GROUP``, seeds, trials and the columns of ``AVERAGES``: gaps are of those that are
        finite, the ratio of times is to the median without a seed of the same optimizer, n and
        rule, and not a number where there is none.
    """
    among = GROUP[:-1]
    unseeded = warmstarts[warmstarts["seed"] == NO_SEED].groupby(among)["seconds"].median()
    base = unseeded.reindex(pd.MultiIndex.from_frame(warmstarts[among])).to_numpy(dtype=float)
    gap = warmstarts["optimality_gap"].astype(float)
    rows = warmstarts.assign(
        one=(warmstarts["convex_solves"] <= 1).astype(float),
        solved=(warmstarts["status"] == SOLVED).astype(float),
        safe=as_share(warmstarts["safe"]),
        gap=gap.where(np.isfinite(gap)),
        ratio=warmstarts["seconds"] / base,
    )
    summary = averaged(rows, GROUP, AVERAGES)
    order = seeds_in_order(summary["seed"])
    return summary.sort_values(
        GROUP, key=lambda c: c.map(order.index) if c.name == "seed" else c, ignore_index=True
    )


def seeds_in_order(seeds: Iterable[str]) -> list[str]:
    """Distinct seeds: none first, then by planner and recipe."""
    known = set(seeds)
    planners = in_order(map(planner_of, known))
    return sorted(known, key=lambda s: (s != NO_SEED, planners.index(planner_of(s)), s))
