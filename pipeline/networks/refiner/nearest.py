"""When craft are closest within an interval, compiled."""

from typing import no_type_check

import numpy as np
from numba import njit

STRETCHES = 6
"""Parts of an interval on which the search for its closest approach goes straight first."""

NEWTON_STEPS = 3
"""Steps from there; the last moves what is found by less than a millimetre."""

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
        when, least = 0.0, motion(p0, v0, a2, a3, 0.0)[0]
        for stretch in range(STRETCHES):
            # Where craft pass each other fast, the closest sample may be far from there.
            begin, end = stretch / STRETCHES, (stretch + 1) / STRETCHES
            s = begin + straight(p0, v0, a2, a3, begin, end) * (end - begin)
            for time in (s, end):
                square, _, _ = motion(p0, v0, a2, a3, time)
                if square < least:
                    when, least = time, square
        # The least of a smooth curve is near the least of these, so no step goes further, and
        # none that leads away is followed.
        low, high = max(when - 1 / STRETCHES, 0.0), min(when + 1 / STRETCHES, 1.0)
        s = when
        for _ in range(NEWTON_STEPS):
            _, slope, curvature = motion(p0, v0, a2, a3, s)
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


@no_type_check
@njit(cache=True)
def straight(p0, v0, a2, a3, begin, end):
    """Where on the straight way between two of the cubic's points 0 is closest, as a share."""
    toward, length = 0.0, 0.0
    for x in range(3):
        here = p0[x] + begin * (v0[x] + begin * (a2[x] + begin * a3[x]))
        way = p0[x] + end * (v0[x] + end * (a2[x] + end * a3[x])) - here
        toward -= here * way
        length += way * way
    return min(max(toward / length, 0.0), 1.0) if length > 0 else 0.0
