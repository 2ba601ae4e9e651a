"""Linear feedback about a plan: at each node the estimated deviation is corrected.

The least-energy change of controls that nulls the deviation within the next 0.15 orbits, or at an
earlier goal, is computed, and its first interval flown. In the last interval the three components
of the control minimize ‖Δp‖² + ‖Δv/e‖² at the goal.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pipeline.arrays import Array, Float
from pipeline.orbit.problem import Problem, once_per_motion
from pipeline.orbit.transfer import state_weight, step_maps, transfer_maps

# Horizon, in orbits, within which a deviation is nulled. A shorter one takes more fuel (0.1: 3.5 %
# of a plan's instead of 3.2 % in rings of ten, errors of 0.2 m and 1 %), a longer one no less.
HORIZON = 0.15


@once_per_motion
def feedback_gains(problem: Problem) -> Float[Array, "intervals 3 6"]:
    """K of δu = K δs at each node: the change of a control, m/s², for a deviation, m and m/s."""
    intervals = problem.intervals
    period = 2 * np.pi / problem.mean_motion
    horizon = max(2, math.ceil(HORIZON * period / problem.time_step))
    reach, weight = transfer_maps(problem).reach, state_weight(problem)
    gains = np.zeros((intervals, 3, 6))
    for node in range(intervals - 1):
        end = min(node + horizon, intervals)
        pushed = weight[:, None] * reach[end, :, 3 * node : 3 * end]
        drifted = weight[:, None] * problem.dynamics.drift(node, end)
        gains[node] = -(np.linalg.pinv(pushed) @ drifted)[:3]
    A, _ = problem.dynamics.step(problem.time_step, intervals - 1)
    gains[-1] = -last_control_map(problem) @ A
    return gains


def last_control_map(problem: Problem) -> Float[Array, "3 6"]:
    """Map from a change of the final state to the last control that best achieves it, m/s²."""
    _, B = problem.dynamics.step(problem.time_step, problem.intervals - 1)
    weight = state_weight(problem)
    return np.asarray(np.linalg.pinv(weight[:, None] * B) * weight)


@dataclass(frozen=True, eq=False)
class ErrorMaps:
    """Linear state-space model of a craft's errors about its plan, with state x.

    x is the deviation as estimated at a node, m and m/s, on which feedback acts or, where it is
    known late, with the one on which it acts.
    """

    move: Float[Array, "K d d"]  # of x over an interval
    enter: Float[Array, "d 6"]  # to x from a new deviation at its node
    joint: Float[Array, "T 9 d"]  # to the deviation and the commanded control, none at the last


@lru_cache(maxsize=32)
def error_maps(problem: Problem, closed_loop: bool, late: bool) -> ErrorMaps:
    """State-space model of a craft's errors, in closed or open loop.

    A ``late`` estimate is that of the node before, propagated with the control commanded since.
    """
    (A, B), acted_on = step_maps(problem), slice(6, 12) if late else slice(0, 6)
    joint = np.zeros((problem.nodes, 9, acted_on.stop))
    joint[:, :6, :6] = np.eye(6)
    if closed_loop:
        joint[:-1, 6:, acted_on] = feedback_gains(problem)
    ahead = B @ joint[:-1, 6:]
    ahead[..., :6] += A
    if late:
        return ErrorMaps(np.concatenate([ahead, ahead], axis=1), np.eye(12, 6), joint)
    return ErrorMaps(ahead, np.eye(6), joint)
