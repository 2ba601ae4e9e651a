"""The planes between craft that meet, and how controls move craft along them, compiled.

A plane stands at the closest approach across the gap. Within an interval relative motion is a
cubic, so the gap and all that follows from it are linear in the states of the interval's two
nodes, by Hermite's weights.
"""

from dataclasses import dataclass
from typing import Any, no_type_check

import numpy as np
import torch
from jaxtyping import Float
from numba import njit
from torch import Tensor

from pipeline.networks.refiner.compiled import numbers
from pipeline.networks.refiner.encounters import Encounters
from pipeline.networks.refiner.grid import Grid

TOUCHING = 1e-4
"""Distance in r_col under which two craft give no direction of their own."""

STILL = 1e-9
"""Relative speed in r_col/Δt under which two craft do not move past each other."""


@dataclass(frozen=True, eq=False)
class Planes:
    """The planes of L encounters, in r_col and Δt.

    Attributes:
        distance: from the second craft to the first along the plane's normal, (L,).
        gain: how the first craft's controls move it along the normal, (L, m).
        along: unit vector along the gap, the normal, (L, 3); gradients do not run through it.
        motion: unit vector along the motion past it, (L, 3); nor through this.
        speed: relative, (L,); nor through this.
    """

    distance: Float[Tensor, "L"]
    gain: Float[Tensor, "L m"]
    along: Float[Tensor, "L 3"]
    motion: Float[Tensor, "L 3"]
    speed: Float[Tensor, "L"]


def planes(
    met: Encounters, share: Float[Tensor, "L"], states: Float[Tensor, "N T 6"], grid: Grid
) -> Planes:
    """The planes between pairs at some time in an interval.

    Where two craft touch, the normal is any across their motion, and gradients do not turn it.

    Args:
        met: pairs and intervals.
        share: when, as a share of the interval; gradients do not run through it.
        states: of all craft.
        grid: the problem.
    """
    return Planes(*_Planes.apply(states, met, share, grid))  # type: ignore[no-untyped-call]


class _Planes(torch.autograd.Function):
    """Distances and gains with their gradients, and what has none."""

    @staticmethod
    def forward(
        ctx: Any, states: Tensor, met: Encounters, share: Tensor, grid: Grid
    ) -> tuple[Tensor, ...]:
        L, m = len(share), grid.reach.shape[1]
        shapes = ((L,), (L, m), (L, 3), (L, 3), (L,))
        found = [torch.zeros(shape, dtype=torch.float64) for shape in shapes]
        given = (states, met.first, met.second, met.interval, share, grid.reach)
        _stand(*map(numbers, given), *(part.numpy() for part in found))
        found = [part.to(states.device) for part in found]
        ctx.shape = states.shape
        ctx.save_for_backward(*given[1:], found[0], found[2])
        ctx.mark_non_differentiable(*found[2:])
        return tuple(found)

    @staticmethod
    def backward(ctx: Any, distance: Tensor, gain: Tensor, *_: Tensor) -> tuple[Tensor | None, ...]:
        result = torch.zeros(ctx.shape, dtype=torch.float64)
        _back(*map(numbers, (distance, gain, *ctx.saved_tensors)), result.numpy())
        return result.to(distance.device), None, None, None


# jaxtyping cannot look into compiled functions; their shapes are those of ``_stand``.


@no_type_check
@njit(cache=True)
def _stand(states, first, second, interval, share, reach, distance, gain, along, motion, speed):
    """All planes.

    Args:
        states: of all craft, (N, T, 6).
        first: first craft of each pair, (L,).
        second: second craft, (L,).
        interval: which interval, (L,).
        share: when, as a share of it, (L,).
        reach: what controls change of node states, (6T, m).
        distance: result, (L,).
        gain: result, zeros before, (L, m).
        along: result, (L, 3).
        motion: result, (L, 3).
        speed: result, (L,).
    """
    gap, past, weight = np.empty(3), np.empty(3), np.empty(4)
    for k in range(len(first)):
        one, other, t, s = states[first[k]], states[second[k]], interval[k], share[k]
        hermite(s, weight)
        for x in range(3):
            here, there = one[t, x] - other[t, x], one[t + 1, x] - other[t + 1, x]
            go, arrive = one[t, x + 3] - other[t, x + 3], one[t + 1, x + 3] - other[t + 1, x + 3]
            gap[x] = weight[0] * here + weight[1] * go + weight[2] * there + weight[3] * arrive
            way = 6 * s * (1 - s) * (there - here)
            past[x] = way + (1 - s) * (1 - 3 * s) * go + s * (3 * s - 2) * arrive
        speed[k] = length(past)
        if length(gap) < TOUCHING:
            across(past, along[k])
        else:
            along[k] = gap
        to_unit(along[k])
        distance[k] = dot(gap, along[k])
        forward = dot(past, along[k])
        for x in range(3):
            motion[k, x] = past[x] - forward * along[k, x]
        if length(motion[k]) < STILL:
            across(along[k], motion[k])
        to_unit(motion[k])
        for i in range(4):
            for x in range(3):
                row, part = reach[6 * t + 3 * i + x], weight[i] * along[k, x]
                for c in range(3 * (t + 1)):  # later controls do not matter yet
                    gain[k, c] += part * row[c]


@no_type_check
@njit(cache=True)
def _back(by_distance, by_gain, first, second, interval, share, reach, distance, along, result):
    """What gradients by distances and gains are by states; added to zeros, (N, T, 6)."""
    by_gap, turn, weight = np.empty(3), np.empty(3), np.empty(4)
    for k in range(len(first)):
        t, normal = interval[k], along[k]
        hermite(share[k], weight)
        turn[:] = 0.0
        for i in range(4):
            for x in range(3):
                row = reach[6 * t + 3 * i + x]
                for c in range(3 * (t + 1)):
                    turn[x] += weight[i] * row[c] * by_gain[k, c]
        out = dot(turn, normal)
        for x in range(3):
            by_gap[x] = by_distance[k] * normal[x]
            if distance[k] >= TOUCHING:
                by_gap[x] += (turn[x] - out * normal[x]) / distance[k]
        for x in range(3):
            for i in range(4):
                part = weight[i] * by_gap[x]
                result[first[k], t + i // 2, 3 * (i % 2) + x] += part
                result[second[k], t + i // 2, 3 * (i % 2) + x] -= part


@no_type_check
@njit(cache=True)
def hermite(s, weight):
    """By which position follows from position and velocity at both ends, at a share of the way."""
    r = 1 - s
    weight[0], weight[1] = r * r * (1 + 2 * s), s * r * r
    weight[2], weight[3] = s * s * (1 + 2 * r), -s * s * r


@no_type_check
@njit(cache=True)
def dot(one, other):
    """Of vectors with three parts."""
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


@no_type_check
@njit(cache=True)
def length(vector):
    """Of a vector with three parts."""
    return np.sqrt(dot(vector, vector))


@no_type_check
@njit(cache=True)
def to_unit(vector):
    """Give a vector length 1, in its place."""
    size = max(length(vector), 1e-12)
    for x in range(3):
        vector[x] /= size


@no_type_check
@njit(cache=True)
def across(vector, result):
    """Some vector at right angles to another, also to none."""
    axis = 0
    for x in range(1, 3):
        if abs(vector[x]) < abs(vector[axis]):
            axis = x
    y, z = (axis + 1) % 3, (axis + 2) % 3
    result[axis], result[y], result[z] = 0.0, vector[z], -vector[y]
    if length(result) < STILL:
        result[axis], result[y], result[z] = 1.0, 0.0, 0.0
