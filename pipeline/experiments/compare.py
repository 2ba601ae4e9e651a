"""Two planners on the same trials, compared pair by pair."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from jaxtyping import Float
from scipy import stats

from pipeline.arrays import Array
from pipeline.exhibits.intervals import CONFIDENCE, Interval, newcombe

CHANCE = 1 - CONFIDENCE
"""Probability under which a difference is no longer put down to chance."""


@dataclass(frozen=True)
class Compared:
    """What the first of two planners does otherwise than the second, on the trials of both.

    Attributes:
        trials: how many.
        safe: difference in the share of safe trials.
        safe_interval: Newcombe's of that difference.
        safe_by_chance: probability of so uneven a split of the trials in which just one is safe,
            where either were as likely (exact sign test).
        fuel: mean difference in fuel over its bound, or in m/s² where that is compared.
        fuel_interval: of that mean.
    """

    trials: int
    safe: float
    safe_interval: Interval
    safe_by_chance: float
    fuel: float
    fuel_interval: Interval

    @property
    def better(self) -> bool:
        """Whether the first is better: safer, or, where that may be chance, cheaper."""
        if self.safe_by_chance <= CHANCE:
            return self.safe > 0
        return self.fuel < 0


def compare(first: pd.DataFrame, second: pd.DataFrame, fuel: str = "fuel_ratio") -> Compared:
    """Compare two planners on the trials that both have flown.

    Args:
        first: rows of trials with columns trial, safe and the one of ``fuel``; several rows of a
            trial, as of several trainings, count as their mean.
        second: the same of the other planner.
        fuel: column to compare fuel by.
    """
    columns = ["safe", fuel]
    both = [
        rows.assign(safe=rows["safe"].astype(float)).groupby("trial")[columns].mean()
        for rows in (first, second)
    ]
    difference = (both[0] - both[1]).dropna()
    first_safe, second_safe = (
        rows.loc[difference.index, "safe"].to_numpy(dtype=float) for rows in both
    )
    safe, cost = (difference[column].to_numpy(dtype=float) for column in columns)
    uneven = safe[safe != 0]
    chance = stats.binomtest(int((uneven > 0).sum()), len(uneven)).pvalue if len(uneven) else 1.0
    return Compared(
        trials=len(difference),
        safe=_mean(safe),
        safe_interval=newcombe(first_safe, second_safe),
        safe_by_chance=float(chance),
        fuel=_mean(cost),
        fuel_interval=mean_interval(cost),
    )


def mean_interval(values: Float[Array, "k"]) -> Interval:
    """Student's interval of a mean; no more than the mean where values do not vary."""
    if len(values) < 2 or np.allclose(values, values[0], rtol=1e-12, atol=1e-15):
        return _mean(values), _mean(values)
    found = stats.ttest_1samp(values, 0.0).confidence_interval(CONFIDENCE)
    return float(found.low), float(found.high)


def _mean(values: Float[Array, "k"]) -> float:
    return float(values.mean()) if len(values) else float("nan")
