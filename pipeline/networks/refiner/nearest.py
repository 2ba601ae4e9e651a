"""Which craft come close within an interval, and when they are closest, compiled."""

from typing import no_type_check

import numpy as np
from numba import njit

STRETCHES = 6
"""Parts of an interval on which the search for its closest approach goes straight first."""

NEWTON_STEPS = 3  # steps from there; the last moves what is found by less than a millimetre

THIRD = 1.0 / 3.0

LEVEL = 1e-6
"""Cosine between gap and relative velocity under which a pair neither comes closer nor parts."""

AT_FIRST = 1024  # encounters for which there is room before it is doubled

# jaxtyping cannot look into compiled functions; their shapes are those given here.


@no_type_check
@njit(cache=True)
def nearest(states, first, second, interval, within, moved, share, distance, turns):
    """The closest approach of pairs of craft in intervals, (k,) each; lengths in r_col.

    Node states are (N, T, 6), ``moved`` says of each craft whether it has, (N,), and results of
    pairs of which none has stay. Results are when, as a share of the interval, and the distance,
    which are 0 and infinite where it is sure to be beyond ``within``; and whether the pair comes
    closer before and parts after it.
    """
    motion = np.empty((4, 3))
    for k in range(len(first)):
        if not (moved[first[k]] or moved[second[k]]):
            continue
        one, other, t = states[first[k]], states[second[k]], interval[k]
        if stays_beyond(one, other, t, within[k]):
            share[k], distance[k], turns[k] = 0.0, np.inf, False
        else:
            fill(motion, one, other, t)
            share[k], distance[k] = closest(motion)
            turns[k] = 0.0 < share[k] < 1.0 or level(motion, share[k])


@no_type_check
@njit(cache=True)
def close_pairs(states, n, within):
    """All pairs of the same swarm of n craft, and intervals in which they come within a distance.

    Node states are (N, T, 6), one swarm's after the other's; the distance is that of each swarm,
    (N / n,). The result, (3, k), has first craft, second craft and interval of each, in that order.
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
                if not comes_within(motion, within[swarm]):
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
def comes_within(motion, within):
    """Whether the cubic comes within a distance of 0; most that do are at one of their ends."""
    begin, end = 0.0, 0.0
    for x in range(3):
        begin += motion[0, x] ** 2
        end += (motion[0, x] + motion[1, x] + motion[2, x] + motion[3, x]) ** 2
    return min(begin, end) <= within * within or closest(motion)[1] <= within


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
    when, least = 0.0, np.inf
    x, y, z = place(motion, 0.0)
    for stretch in range(STRETCHES):
        # Where craft pass each other fast, the closest sample may be far from there.
        here = x * x + y * y + z * z
        if here < least:
            when, least = stretch / STRETCHES, here
        to_x, to_y, to_z = place(motion, (stretch + 1) / STRETCHES)
        along = x * (x - to_x) + y * (y - to_y) + z * (z - to_z)
        length = (to_x - x) ** 2 + (to_y - y) ** 2 + (to_z - z) ** 2
        if 0 < along < length:  # the straight way between both is closest to 0 on its way
            s = (stretch + along / length) / STRETCHES
            square = at(motion, s)[0]
            if square < least:
                when, least = s, square
        x, y, z = to_x, to_y, to_z
    if x * x + y * y + z * z < least:
        when, least = 1.0, x * x + y * y + z * z
    # The least of a smooth curve is near the least of these, so no step goes further, and
    # none that leads away is followed.
    low, high = max(when - 1 / STRETCHES, 0.0), min(when + 1 / STRETCHES, 1.0)
    s = when
    for _ in range(NEWTON_STEPS):
        _, slope, curvature, _ = at(motion, s)
        step = slope / curvature if curvature > 0 else np.sign(slope) * (high - low) / 4
        s = min(max(s - step, low), high)
        square = at(motion, s)[0]
        if square < least:
            when, least = s, square
    return when, np.sqrt(least)


@no_type_check
@njit(cache=True)
def level(motion, s):
    """Whether the cubic neither comes closer to 0 nor parts from it, but for rounding."""
    square, slope, _, speed = at(motion, s)
    return slope * slope <= LEVEL * LEVEL * square * speed


@no_type_check
@njit(cache=True)
def at(motion, s):
    """|p|² of the cubic, half its first two derivatives, and |v|²."""
    square, slope, curvature, speed = 0.0, 0.0, 0.0, 0.0
    for x in range(3):
        p0, v0, a2, a3 = motion[0, x], motion[1, x], motion[2, x], motion[3, x]
        p = p0 + s * (v0 + s * (a2 + s * a3))
        v = v0 + s * (2 * a2 + 3 * s * a3)
        square += p * p
        slope += p * v
        curvature += v * v + p * (2 * a2 + 6 * s * a3)
        speed += v * v
    return square, slope, curvature, speed


@no_type_check
@njit(cache=True)
def place(motion, s):
    """Where the cubic is."""
    x = motion[0, 0] + s * (motion[1, 0] + s * (motion[2, 0] + s * motion[3, 0]))
    y = motion[0, 1] + s * (motion[1, 1] + s * (motion[2, 1] + s * motion[3, 1]))
    z = motion[0, 2] + s * (motion[1, 2] + s * (motion[2, 2] + s * motion[3, 2]))
    return x, y, z
