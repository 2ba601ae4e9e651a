"""The knee of a trade-off: where more time stops to save much."""

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array

FEWEST = 3
"""Points of which one can be between two others."""

BENT = 1e-3
"""Least distance below the chord, of the normalised curve, that counts as a bend."""


def knee(time: Float[Array, "points"], cost: Float[Array, "points"]) -> int | None:
    """The point furthest below the chord of the normalised curve, by its number, or None.

    The criterion of Kneedle (V. Satopää, J. Albrecht, D. Irwin, B. Raghavan, "Finding a 'Kneedle'
    in a Haystack", ICDCS Workshops 2011), without its smoothing: times and costs are scaled to
    0..1, and the knee is where the curve is furthest from the line between its ends. Only points
    that cost less than every faster one count, since the others are no trade-off.

    Args:
        time: ascending.
        cost: of each time.
    """
    before = np.minimum.accumulate(np.concatenate([[np.inf], cost]))[:-1]
    efficient = np.flatnonzero(cost < before)
    if len(efficient) < FEWEST:
        return None
    x, y = time[efficient], cost[efficient]
    below = 1 - (x - x[0]) / (x[-1] - x[0]) - (y - y[-1]) / (y[0] - y[-1])
    return int(efficient[below.argmax()]) if below.max() > BENT else None
