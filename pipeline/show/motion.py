"""Where craft are, exactly, at many times: the samples from which a page draws motion."""

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import free_drift, track

SAMPLES = 240
"""Times at which a transfer is shown: every 5 s of the reference problem's 20 minutes."""

CROWD = 100
"""Craft beyond which a page would grow too large: each then has fewer samples."""

ORBIT_STEPS = 4
"""Samples in each of the intervals into which an orbit of free drift is cut."""


def steps_of(n: int, problem: Problem) -> int:
    """Samples in each interval of a transfer of n craft, at least one."""
    return max(1, round(SAMPLES * min(1.0, CROWD / n) / problem.intervals))


def sample_times(n: int, problem: Problem, further: Float[Array, "k"]) -> Float[Array, "S"]:
    """Times at which to show a transfer, s: evenly spaced with the nodes among them, and others."""
    steps = steps_of(n, problem)
    even = problem.time_step / steps * np.arange(problem.intervals * steps + 1)
    return np.union1d(even, further)


def positions_at(
    times: Float[Array, "S"],
    states: Float[Array, "n T 6"],
    controls: Float[Array, "n intervals 3"],
    problem: Problem,
) -> Float[Array, "n S 3"]:
    """Positions in m at any times of a transfer, s: Eq. 2 from the node before each."""
    interval = np.clip(times // problem.time_step, 0, problem.intervals - 1).astype(int)
    A, B = problem.dynamics.step(times - interval * problem.time_step)
    free = np.einsum("sij,nsj->nsi", A[:, :3], states[:, interval])
    return free + np.einsum("sij,nsj->nsi", B[:, :3], controls[:, interval])


def orbits(states: Float[Array, "n 6"], problem: Problem) -> Float[Array, "n P 3"]:
    """Positions in m along an orbit of free drift from each state (m, m/s)."""
    steps = ORBIT_STEPS if len(states) <= CROWD else 1
    return track(*free_drift(states, problem), steps)
