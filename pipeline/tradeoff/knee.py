"""The knee of a trade-off: where more time stops to save much."""

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array

FEWEST = 3
"""Points of which one can be between two others."""

BENT = 0.1
"""Least distance of a knee below the chord of the normalised curve."""

LESS = 0.5
"""Most that a unit of time saves after a knee, of what one saves before it."""


def knee(time: Float[Array, "points"], cost: Float[Array, "points"]) -> int | None:
    """The point furthest below the chord of the normalised curve, by its number, or None.

    The criterion of Kneedle (V. Satopää, J. Albrecht, D. Irwin, B. Raghavan, "Finding a 'Kneedle'
    in a Haystack", ICDCS Workshops 2011), without its smoothing: times and costs are scaled to
    0..1, and the knee is where the curve is furthest from the line between its ends. Only points
    that cost less than every faster one count, since the others are no trade-off.

    Every curve has such a point, so one is called a knee only where it is a tenth below that line,
    and where time saves at most half as much after it as before it, on average. A straight line
    with a steep first step has none, nor has 1/t over a range of less than a factor of 2.

    Args:
        time: ascending.
        cost: of each time.
    """
    faster = np.minimum.accumulate(np.concatenate([[np.inf], cost]))[:-1]
    efficient = np.flatnonzero(cost < faster)
    if len(efficient) < FEWEST:
        return None
    x, y = time[efficient], cost[efficient]
    below = 1 - (x - x[0]) / (x[-1] - x[0]) - (y - y[-1]) / (y[0] - y[-1])
    bend = int(below.argmax())
    if below[bend] < BENT:
        return None
    before = (y[0] - y[bend]) / (x[bend] - x[0])
    after = (y[bend] - y[-1]) / (x[-1] - x[bend])
    return int(efficient[bend]) if after <= LESS * before else None
