"""Trials beyond n = 30 summed up: the averages of experiment 2, with what is not safe."""

import pandas as pd

from pipeline.exhibits.numbers import number, share
from pipeline.experiments.averages import Average
from pipeline.experiments.summary import COLLISIONS, FUEL_RATIO, SAFE, SECONDS, summarize

ROUNDING = 9
"""Decimals of a percent; what the own optima need more than the bound is less."""

UNSAFE = Average(
    *("Unsafe at any time", "unsafe_share", share, "unsafe_spread", ("unsafe_low", "unsafe_high")),
    label="share of unsafe trials",
)

EXCESS = Average(
    *("Fuel above the bound, av. (%)", "excess", number, "excess_spread"),
    label="fuel above the bound, average (%)",
)

DRAWN = (COLLISIONS, UNSAFE, EXCESS, SECONDS)
"""What is drawn against n; of fuel over the bound hundredths count, which a ratio hides."""


def summarize_beyond(trials: pd.DataFrame) -> pd.DataFrame:
    """The columns of ``summarize`` and those of UNSAFE and EXCESS, size by size.

    Args:
        trials: from ``shown_beyond``.
    """
    summary = summarize(trials)
    low, high = (1 - summary[end] for end in reversed(SAFE.interval or ()))
    unsafe = {"unsafe_share": 1 - summary[SAFE.source], "unsafe_spread": summary[SAFE.spread]}
    ratio, spread = summary[FUEL_RATIO.source], summary[FUEL_RATIO.spread]
    excess = {"excess": (100 * (ratio - 1)).round(ROUNDING), "excess_spread": 100 * spread}
    found = summary.assign(**unsafe, unsafe_low=low, unsafe_high=high, **excess)
    return found.sort_values("n", kind="stable", ignore_index=True)
