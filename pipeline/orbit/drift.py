"""Free drift: how close craft of a formation come when nobody burns, over a whole orbit."""

import math
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.orbit.approaches import side_by_side
from pipeline.orbit.problem import MOST_NODES, Problem
from pipeline.orbit.separation import least_separations

ORBIT_INTERVALS = 16
"""Intervals into which the free drift of an orbit is cut to check it; any number is sound."""


def free_drift(
    states: Float[Array, "n 6"], problem: Problem, orbits: float = 1.0
) -> tuple[Float[Array, "n T 6"], Float[Array, "n intervals 3"], Problem]:
    """Free drift over so many orbits: node states, controls and the problem that they are of."""
    intervals = min(max(2, math.ceil(orbits * ORBIT_INTERVALS)), MOST_NODES - 1)
    drift = Problem(
        mean_motion=problem.mean_motion,
        time_step=orbits * 2 * np.pi / problem.mean_motion / intervals,
        nodes=intervals + 1,
    )
    idle = np.zeros((len(states), intervals, 3))
    # To the bit what ``fly`` has, without its maps of controls, which take a minute for 999 nodes.
    flown = np.matvec(_powers(drift).reshape(-1, 6), states)
    return flown.reshape(len(states), drift.nodes, 6), idle, drift


@lru_cache(maxsize=32)
def _powers(drift: Problem) -> Float[Array, "T 6 6"]:
    """From the first state of a drift to that at each node."""
    A, _ = drift.dynamics.step(drift.time_step)
    return np.stack([np.linalg.matrix_power(A, t) for t in range(drift.nodes)])


def drift_separations(states: Float[Array, "N n 6"], problem: Problem) -> Float[Array, "N"]:
    """No two craft of each formation come closer than this in an orbit of free drift, m."""
    N, n, _ = states.shape
    drift = free_drift(states.reshape(N * n, 6), problem)
    return np.array([apart.bound for apart in least_separations(*drift, side_by_side((n,) * N))])
