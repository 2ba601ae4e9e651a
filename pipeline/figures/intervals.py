"""Confidence intervals of shares and means, and what they prove about a threshold.

A claim about a threshold holds where the whole interval meets it, fails where the whole interval
misses it, and is open (None) where the threshold lies within.
"""

from statistics import NormalDist

import numpy as np

from pipeline.arrays import Array, Float

CONFIDENCE = 0.95  # of every interval

NORMAL_QUANTILE = NormalDist().inv_cdf(0.5 + CONFIDENCE / 2)
"""Two-sided quantile of the standard normal distribution at that confidence."""

ConfidenceInterval = tuple[float, float]


def at_least(interval: ConfidenceInterval, threshold: float) -> bool | None:
    """Whether a number is at least a threshold, by its interval; open if the interval is NaN."""
    low, high = interval
    return True if low >= threshold else False if high < threshold else None


def at_most(interval: ConfidenceInterval, threshold: float) -> bool | None:
    """Whether a number is at most a threshold, by its interval; open if the interval is NaN."""
    low, high = interval
    return True if high <= threshold else False if low > threshold else None


def wilson(share: float, trials: int | float) -> ConfidenceInterval:
    """Wilson's interval of a share of so many trials, which need not be a whole number.

    E. Wilson, "Probable inference, the law of succession, and statistical inference", Journal of
    the American Statistical Association 22, 1927. Not a number where there are no trials.
    """
    if trials == 0 or np.isnan(share):
        return float("nan"), float("nan")
    more = NORMAL_QUANTILE**2 / trials
    middle = (share + more / 2) / (1 + more)
    deviation = np.sqrt(share * (1 - share) / trials + more / (4 * trials))
    half = float(NORMAL_QUANTILE / (1 + more) * deviation)
    # At the ends the sums are 0 and 1 but for rounding.
    low, high = max(0.0, middle - half), min(1.0, middle + half)
    return low if share > 0 else 0.0, high if share < 1 else 1.0


def clustered_interval(shares: Float[Array, "k"], each: int) -> ConfidenceInterval:
    """Wilson's interval of a share, from its values in clusters of ``each`` correlated trials.

    The effective number of independent trials is p(1 - p) over the variance of p between the k
    clusters, corrected for how few they are (E. Korn, B. Graubard, "Confidence intervals
    for proportions with small expected number of positive counts estimated from survey data",
    Survey Methodology 24, 1998): at least one a cluster, which is all that is known where p is 0
    or 1, and at most all.
    """
    k = len(shares)
    if k == 0:
        return float("nan"), float("nan")
    p = float(shares.mean())
    variance = float(shares.var(ddof=1)) / k if k > 1 else 0.0
    effective = 0.0
    if variance > 0:
        few = NORMAL_QUANTILE / _t_quantile(k - 1)
        effective = p * (1 - p) / variance * few**2
    return wilson(p, float(min(max(effective, k), k * each)))


def mean_interval(values: Float[Array, "k"]) -> ConfidenceInterval:
    """Student's interval of a mean: just the mean where all values are equal.

    Not a number for fewer than two values.
    """
    k = len(values)
    if k < 2:
        return float("nan"), float("nan")
    mean = float(values.mean())
    if np.allclose(values, values[0], rtol=1e-12, atol=1e-15):
        return mean, mean
    half = _t_quantile(k - 1) * float(values.std(ddof=1)) / float(np.sqrt(k))
    return mean - half, mean + half


def _t_quantile(freedom: int) -> float:
    """Two-sided quantile of Student's t distribution with so many degrees of freedom."""
    from scipy.special import stdtrit  # slow to import

    return float(stdtrit(freedom, 0.5 + CONFIDENCE / 2))


def newcombe(first: Float[Array, "k"], second: Float[Array, "k"]) -> ConfidenceInterval:
    """Newcombe's interval of the difference of two shares on the same trials, within -1 and 1.

    Trials are 0 or 1, or a share between, as of several trainings. Method 10 of R. Newcombe,
    "Improved confidence intervals for the difference between binomial proportions based on paired
    data", Statistics in Medicine 17, 1998.
    """
    k = len(first)
    p, q = (float(x.mean()) if k else float("nan") for x in (first, second))
    (low_p, high_p), (low_q, high_q) = wilson(p, k), wilson(q, k)
    correlation = _correlation(first, second) if k else 0.0

    def away(a: float, b: float) -> float:
        return float(np.sqrt(max(a * a - 2 * correlation * a * b + b * b, 0.0)))

    return p - q - away(p - low_p, high_q - q), p - q + away(high_p - p, q - low_q)


def _correlation(first: Float[Array, "k"], second: Float[Array, "k"]) -> float:
    """Correlation of two shares, reduced if positive by Newcombe's correction for continuity."""
    k, (p, q) = len(first), (float(first.mean()), float(second.mean()))
    together = k * k * float(np.mean(first * second) - p * q)
    together = max(together - k / 2, 0.0) if together > 0 else together
    spread = k * k * float(np.sqrt(p * (1 - p) * q * (1 - q)))
    return together / spread if spread > 0 else 0.0
