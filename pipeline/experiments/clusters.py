"""How sure a share is that was counted in clusters, such as the flights of one scenario."""

from jaxtyping import Float
from scipy import stats

from pipeline.arrays import Array
from pipeline.exhibits.intervals import CONFIDENCE, NORMAL, Interval, wilson


def clustered_interval(shares: Float[Array, "k"], each: int) -> Interval:
    """Wilson's interval of a share, for the independent trials that those of k clusters are worth.

    That is p(1 - p) over the variance of p as the clusters show it, corrected for how few they are
    (E. Korn, B. Graubard, "Confidence intervals for proportions with small expected number of
    positive counts estimated from survey data", Survey Methodology 24, 1998): at least one a
    cluster, which is all that is known where p is 0 or 1, and at most all.

    Args:
        shares: of each cluster.
        each: trials of a cluster.
    """
    k = len(shares)
    if k == 0:
        return float("nan"), float("nan")
    p = float(shares.mean())
    variance = float(shares.var(ddof=1)) / k if k > 1 else 0.0
    worth = 0.0
    if variance > 0:
        few = NORMAL / float(stats.t.ppf(0.5 + CONFIDENCE / 2, k - 1))
        worth = p * (1 - p) / variance * few**2
    return wilson(p, float(min(max(worth, k), k * each)))
