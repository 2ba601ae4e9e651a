"""How sure a share is that was counted in trials."""

import numpy as np
from scipy import stats

CONFIDENCE = 0.95
"""Of every interval."""

Interval = tuple[float, float]


def share_interval(share: float, trials: int) -> Interval:
    """Wilson's interval of a share of so many trials."""
    if trials == 0 or np.isnan(share):
        return float("nan"), float("nan")
    found = stats.binomtest(round(share * trials), trials).proportion_ci(CONFIDENCE, "wilson")
    return float(found.low), float(found.high)
