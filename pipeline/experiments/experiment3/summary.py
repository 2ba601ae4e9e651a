"""Warm starts summed up by seed: the averages of experiment 3."""

from collections.abc import Iterable

import numpy as np
import pandas as pd

from pipeline.exhibits.blocks import Column
from pipeline.exhibits.numbers import number, ratio, ratios, share
from pipeline.exhibits.planners import in_order, planner_of
from pipeline.experiments.averages import Average, averaged
from pipeline.experiments.compare import mean_interval
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
TIME_RATIO = Column(
    *("Time / no seed", "time_ratio", ratio),
    interval=("time_ratio_low", "time_ratio_high"),
    bounds=ratios,
)

AVERAGES = (SOLVES, ONE_SOLVE, MEDIAN, MEAN, DEVIATION, GAP, FUEL, CLEAR, SAFE)


def summarize_warmstarts(warmstarts: pd.DataFrame) -> pd.DataFrame:
    """Averages over the trials of each optimizer, n, rule and seed.

    Args:
        warmstarts: a row each run of an optimizer.

    Returns:
        ``GROUP``, seeds, trials, the columns of ``AVERAGES`` and those of ``time_ratios``; gaps
        are of those that are finite.
    """
    gap = warmstarts["optimality_gap"].astype(float)
    rows = warmstarts.assign(
        one=(warmstarts["convex_solves"] <= 1).astype(float),
        solved=(warmstarts["status"] == SOLVED).astype(float),
        safe=as_share(warmstarts["safe"]),
        gap=gap.where(np.isfinite(gap)),
    )
    summary = averaged(rows, GROUP, AVERAGES).merge(time_ratios(warmstarts), "left", GROUP)
    order = seeds_in_order(summary["seed"])
    return summary.sort_values(
        GROUP, key=lambda c: c.map(order.index) if c.name == "seed" else c, ignore_index=True
    )


def time_ratios(warmstarts: pd.DataFrame) -> pd.DataFrame:
    """Time from each seed over that without one, on the same trials.

    Args:
        warmstarts: a row each run of an optimizer.

    Returns:
        ``GROUP``, and the geometric mean over the trials as time_ratio, with Student's interval of
        it, over the logarithms, as time_ratio_low and time_ratio_high; several trainings count as
        their mean. No row where an optimizer did not run without a seed, whose ratio to itself has
        no interval.
    """
    among, columns = GROUP[:-1], ["time_ratio", *(TIME_RATIO.interval or ())]
    logs = warmstarts.assign(log=np.log(warmstarts["seconds"].astype(float)))
    each = logs.groupby([*GROUP, "trial"], as_index=False)["log"].mean()
    unseeded = each[each["seed"] == NO_SEED].drop(columns="seed")
    pairs = each.merge(unseeded, on=[*among, "trial"], suffixes=("", "_unseeded"))
    longer = (pairs["log"] - pairs["log_unseeded"]).groupby([pairs[name] for name in GROUP])
    found = {
        group: np.exp([values.mean(), *mean_interval(values.dropna().to_numpy(dtype=float))])
        for group, values in longer
    }
    index = pd.MultiIndex.from_tuples(found, names=GROUP)
    ratios = pd.DataFrame(list(found.values()), index, columns).reset_index()
    ratios.loc[ratios["seed"] == NO_SEED, columns[1:]] = np.nan
    return ratios


def seeds_in_order(seeds: Iterable[str]) -> list[str]:
    """Distinct seeds: none first, then by planner and recipe."""
    known = set(seeds)
    planners = in_order(map(planner_of, known))
    return sorted(known, key=lambda s: (s != NO_SEED, planners.index(planner_of(s)), s))
