"""Which craft come close within an interval, and when they are closest, compiled."""

from typing import no_type_check

import numpy as np
from numba import njit

STRETCHES = 6
"""Parts of an interval on which the search for its closest approach goes straight first."""

NEWTON_STEPS = 3
"""Steps from there; the last moves what is found by less than a millimetre."""

THIRD = 1.0 / 3.0

AT_FIRST = 1024
"""Encounters for which there is room before it is doubled."""

# jaxtyping cannot look into compiled functions; their shapes are those given here.


@no_type_check
@njit(cache=True)
def nearest(states, first, second, interval, within, share, distance):
    """The closest approach of pairs of craft in intervals; lengths in r_col, times in Δt.

    Args:
        states: node states of all craft, (N, T, 6).
        first: first craft of each pair, (k,).
        second: second craft, (k,).
        interval: which interval, (k,).
        within: distance beyond which a pair need not be looked at closely, (k,).
        share: result: when, as a share of the interval, (k,); 0 where it was not looked at.
        distance: result, (k,); infinite where it was not looked at.
    """
    motion = np.empty((4, 3))
    for k in range(len(first)):
        one, other, t = states[first[k]], states[second[k]], interval[k]
        if stays_beyond(one, other, t, within[k]):
            share[k], distance[k] = 0.0, np.inf
        else:
            fill(motion, one, other, t)
            share[k], distance[k] = closest(motion)


@no_type_check
@njit(cache=True)
def close_pairs(states, n, within):
    """All pairs of the same swarm, and intervals in which they come within a distance.

    Args:
        states: node states of all craft, one swarm's after the other's, (N, T, 6).
        n: craft of each swarm.
        within: the distance in each swarm, (N / n,).

    Returns:
        First craft, second craft and interval of each, (3, k), in that order.
    """
    found, count = np.empty((3, AT_FIRST), np.int64), 0
    motion = np.empty((4, 3))
    for i in range(len(states)):
        swarm = i // n
        for j in range(i + 1, (swarm + 1) * n):
            for t in range(states.shape[1] - 1):
                if stays_beyond(states[i], states[j], t, within[swarm]):
                    continue
                fill(motion, states[i], states[j], t)
                if closest(motion)[1] > within[swarm]:
                    continue
                if count == found.shape[1]:
                    wider = np.empty((3, 2 * count), np.int64)
                    wider[:, :count] = found
                    found = wider
                found[0, count], found[1, count], found[2, count] = i, j, t
                count += 1
    return found[:, :count].copy()


@no_type_check
@njit(cache=True)
def stays_beyond(one, other, t, within):
    """Whether two craft are sure to stay beyond a distance in an interval.

    Relative motion is a cubic, and lies among the four points that control it as a Bézier curve;
    where all of these are beyond a plane at that distance, so is the cubic. The plane is across the
    middle of both its ends.
    """
    begin, leave, come, end, length = 0.0, 0.0, 0.0, 0.0, 0.0
    for x in range(3):
        here, there = one[t, x] - other[t, x], one[t + 1, x] - other[t + 1, x]
        go, arrive = one[t, x + 3] - other[t, x + 3], one[t + 1, x + 3] - other[t + 1, x + 3]
        middle = here + there
        begin += here * middle
        leave += (here + THIRD * go) * middle
        come += (there - THIRD * arrive) * middle
        end += there * middle
        length += middle * middle
    least = min(min(begin, leave), min(come, end))
    return least > 0 and least * least > within * within * length


@no_type_check
@njit(cache=True)
def fill(motion, one, other, t):
    """Relative motion in an interval as the coefficients of its cubic: p0, v0, a2, a3."""
    for x in range(3):
        here, there = one[t, x] - other[t, x], one[t + 1, x] - other[t + 1, x]
        go, arrive = one[t, x + 3] - other[t, x + 3], one[t + 1, x + 3] - other[t + 1, x + 3]
        motion[0, x], motion[1, x] = here, go
        motion[2, x] = 3 * (there - here) - 2 * go - arrive
        motion[3, x] = 2 * (here - there) + go + arrive


@no_type_check
@njit(cache=True)
def closest(motion):
    """When the cubic is closest to 0, and how close."""
    when, least = 0.0, at(motion, 0.0)[0]
    for stretch in range(STRETCHES):
        # Where craft pass each other fast, the closest sample may be far from there.
        begin, end = stretch / STRETCHES, (stretch + 1) / STRETCHES
        s = begin + straight(motion, begin, end) * (end - begin)
        for time in (s, end):
            square = at(motion, time)[0]
            if square < least:
                when, least = time, square
    # The least of a smooth curve is near the least of these, so no step goes further, and
    # none that leads away is followed.
    low, high = max(when - 1 / STRETCHES, 0.0), min(when + 1 / STRETCHES, 1.0)
    s = when
    for _ in range(NEWTON_STEPS):
        _, slope, curvature = at(motion, s)
        step = slope / curvature if curvature > 0 else np.sign(slope) * (high - low) / 4
        s = min(max(s - step, low), high)
        square = at(motion, s)[0]
        if square < least:
            when, least = s, square
    return when, np.sqrt(least)


@no_type_check
@njit(cache=True)
def at(motion, s):
    """|p|² of the cubic, and half its first two derivatives."""
    square, slope, curvature = 0.0, 0.0, 0.0
    for x in range(3):
        p0, v0, a2, a3 = motion[0, x], motion[1, x], motion[2, x], motion[3, x]
        p = p0 + s * (v0 + s * (a2 + s * a3))
        v = v0 + s * (2 * a2 + 3 * s * a3)
        square += p * p
        slope += p * v
        curvature += v * v + p * (2 * a2 + 6 * s * a3)
    return square, slope, curvature


@no_type_check
@njit(cache=True)
def straight(motion, begin, end):
    """Where on the straight way between two of the cubic's points 0 is closest, as a share."""
    toward, length = 0.0, 0.0
    for x in range(3):
        p0, v0, a2, a3 = motion[0, x], motion[1, x], motion[2, x], motion[3, x]
        here = p0 + begin * (v0 + begin * (a2 + begin * a3))
        way = p0 + end * (v0 + end * (a2 + end * a3)) - here
        toward -= here * way
        length += way * way
    return min(max(toward / length, 0.0), 1.0) if length > 0 else 0.0
