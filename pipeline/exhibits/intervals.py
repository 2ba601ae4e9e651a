"""How sure a share is that was counted in trials, and a difference of two on the same trials."""

import numpy as np
from jaxtyping import Float
from scipy import stats

from pipeline.arrays import Array

CONFIDENCE = 0.95
"""Of every interval."""

NORMAL = float(stats.norm.ppf(0.5 + CONFIDENCE / 2))
"""Standard deviations that a normal variable keeps within with that probability."""

Interval = tuple[float, float]


def wilson(share: float, trials: int | float) -> Interval:
    """Wilson's interval of a share of so many trials, which need not be a whole number.

    E. Wilson, "Probable inference, the law of succession, and statistical inference", Journal of
    the American Statistical Association 22, 1927. Not a number where there are no trials.
    """
    if trials == 0 or np.isnan(share):
        return float("nan"), float("nan")
    more = NORMAL**2 / trials
    middle = (share + more / 2) / (1 + more)
    half = NORMAL / (1 + more) * np.sqrt(share * (1 - share) / trials + more / (4 * trials))
    return max(0.0, middle - float(half)), min(1.0, middle + float(half))


def newcombe(first: Float[Array, "k"], second: Float[Array, "k"]) -> Interval:
    """Newcombe's interval of the difference of two shares on the same trials, within -1 and 1.

    Method 10 of R. Newcombe, "Improved confidence intervals for the difference between binomial
    proportions based on paired data", Statistics in Medicine 17, 1998.

    Args:
        first: of each trial 0 or 1, or a share between, as of several trainings.
        second: the same, of the same trials.
    """
    k = len(first)
    p, q = (float(x.mean()) if k else float("nan") for x in (first, second))
    (low_p, high_p), (low_q, high_q) = wilson(p, k), wilson(q, k)
    like = _correlation(first, second) if k else 0.0
    below = _hypotenuse(p - low_p, high_q - q, like)
    above = _hypotenuse(high_p - p, q - low_q, like)
    return p - q - below, p - q + above


def _hypotenuse(a: float, b: float, cosine: float) -> float:
    return float(np.sqrt(max(a * a - 2 * cosine * a * b + b * b, 0.0)))


def _correlation(first: Float[Array, "k"], second: Float[Array, "k"]) -> float:
    """Of two shares, less where it is positive, by Newcombe's correction for continuity."""
    k, (p, q) = len(first), (float(first.mean()), float(second.mean()))
    together = k * k * float(np.mean(first * second) - p * q)
    together = max(together - k / 2, 0.0) if together > 0 else together
    spread = k * k * float(np.sqrt(p * (1 - p) * q * (1 - q)))
    return together / spread if spread > 0 else 0.0
