"""The pairs of craft that come closest, found soundly, and the nearest two at each time."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from pipeline.arrays import Array
from pipeline.orbit.approaches import TOLERANCE, close_approaches
from pipeline.orbit.problem import Problem
from pipeline.orbit.separation import node_distances

MOST = 6
"""Pairs whose separation is shown, each in a colour that can be told from the others."""


@dataclass(frozen=True)
class Pair:
    """Two craft at their closest.

    Attributes:
        first: the craft of lower index.
        second: the other.
        distance: their least separation at any time, m.
        time: when, s since the start.
    """

    first: int
    second: int
    distance: float
    time: float


def closest_pairs(
    states: Float[Array, "n T 6"],
    controls: Float[Array, "n intervals 3"],
    problem: Problem,
    most: int = MOST,
) -> list[Pair]:
    """The pairs of least separation at any time, the closest first; all where there are few."""
    n = len(states)
    if n < 2:
        return []
    # As many pairs come within the last of the closest at nodes, and so the closest ones do; a
    # little more, so that none of those is lost to rounding.
    at_nodes = node_distances(states).min(axis=1)
    last = min(most, len(at_nodes)) - 1
    within = float(np.partition(at_nodes, last)[last]) + TOLERANCE
    found = close_approaches(states, controls, problem, within)
    order = np.argsort(found.distance, kind="stable")
    _, first = np.unique((found.first * n + found.second)[order], return_index=True)
    closest = order[np.sort(first)][:most]
    times = found.interval * problem.time_step + found.offset
    columns = (found.first, found.second, found.distance, times)
    return [Pair(*row) for row in zip(*(c[closest].tolist() for c in columns), strict=True)]


def nearest(
    positions: Float[Array, "n S 3"],
) -> tuple[Int[Array, "S 2"], Float[Array, "S"]]:
    """The two craft that are closest at each time, and how far apart they are, m."""
    found = [cKDTree(at).query(at, k=2) for at in positions.swapaxes(0, 1)]
    distance = np.array([apart for apart, _ in found])[..., 1]
    craft = distance.argmin(axis=1)
    both = np.array([near for _, near in found])[np.arange(len(craft)), craft]
    # Where two craft are in one place, either may be named first beside itself.
    other = np.where(both[:, 0] == craft, both[:, 1], both[:, 0])
    return np.sort(np.stack([craft, other], axis=1), axis=1), distance.min(axis=1)
