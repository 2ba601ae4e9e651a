"""When craft are closest within an interval, compiled."""

from typing import no_type_check

import numpy as np
from numba import njit

SAMPLES = 9
"""Times of an interval at which the search for its closest approach looks first."""

NEWTON_STEPS = 3
"""Steps from the closest of them, each within the samples beside it."""

# jaxtyping cannot look into compiled functions; their shapes are those of ``nearest``.


@no_type_check
@njit(cache=True)
def nearest(states, first, second, interval, share, distance):
    """The closest approach of pairs of craft in intervals; lengths in r_col, times in Δt.

    Args:
        states: node states of all craft, (N, T, 6).
        first: first craft of each pair, (k,).
        second: second craft, (k,).
        interval: which interval, (k,).
        share: result: when, as a share of the interval, (k,).
        distance: result, (k,).
    """
    p0, v0, a2, a3 = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for k in range(len(first)):
        i, j, t = first[k], second[k], interval[k]
        for x in range(3):
            here, there = (
                states[i, t, x] - states[j, t, x],
                states[i, t + 1, x] - states[j, t + 1, x],
            )
            go = states[i, t, x + 3] - states[j, t, x + 3]
            arrive = states[i, t + 1, x + 3] - states[j, t + 1, x + 3]
            p0[x], v0[x] = here, go
            a2[x], a3[x] = 3 * (there - here) - 2 * go - arrive, 2 * (here - there) + go + arrive
        when, least = 0.0, np.inf
        for sample in range(SAMPLES):
            s = sample / (SAMPLES - 1)
            square, _, _ = motion(p0, v0, a2, a3, s)
            if square < least:
                when, least = s, square
        # The least of a smooth curve is next to the least of its samples, so no step goes further,
        # and none that leads away is followed.
        low, high = max(when - 1 / (SAMPLES - 1), 0.0), min(when + 1 / (SAMPLES - 1), 1.0)
        s = when
        for _ in range(NEWTON_STEPS):
            square, slope, curvature = motion(p0, v0, a2, a3, s)
            step = slope / curvature if curvature > 0 else np.sign(slope) * (high - low) / 4
            s = min(max(s - step, low), high)
            square, _, _ = motion(p0, v0, a2, a3, s)
            if square < least:
                when, least = s, square
        share[k] = when
        distance[k] = np.sqrt(least)


@no_type_check
@njit(cache=True)
def motion(p0, v0, a2, a3, s):
    """|p|² of the cubic p0 + v0 s + a2 s² + a3 s³, and half its first two derivatives."""
    square, slope, curvature = 0.0, 0.0, 0.0
    for x in range(3):
        p = p0[x] + s * (v0[x] + s * (a2[x] + s * a3[x]))
        v = v0[x] + s * (2 * a2[x] + 3 * s * a3[x])
        square += p * p
        slope += p * v
        curvature += v * v + p * (2 * a2[x] + 6 * s * a3[x])
    return square, slope, curvature
