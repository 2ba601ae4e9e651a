"""Linear feedback about a plan: at each node the estimated deviation is corrected.

The least-energy change of controls that nulls the deviation within the next 0.15 orbits, or at an
earlier goal, is computed, and its first interval flown. In the last interval the three components
of the control minimize ‖Δp‖² + ‖Δv/e‖² at the goal.
"""

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from pipeline.arrays import Array, Float
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import state_weight, step_maps, transfer_maps

# Horizon, in orbits, within which a deviation is nulled. A shorter one takes more fuel (0.1: 3.5 %
# of a plan's instead of 3.2 % in rings of ten, errors of 0.2 m and 1 %), a longer one no less.
HORIZON = 0.15
CORRECTED = 1e-100  # responses to errors below this are set to 0, SI


@lru_cache(maxsize=32)
def feedback_gains(problem: Problem) -> Float[Array, "intervals 3 6"]:
    """K of δu = K δs at each node: the change of a control, m/s², for a deviation, m and m/s."""
    intervals = problem.intervals
    period = 2 * np.pi / problem.mean_motion
    horizon = max(2, math.ceil(HORIZON * period / problem.time_step))
    gains = np.zeros((intervals, 3, 6))
    for node in range(intervals - 1):
        left = min(horizon, intervals - node)
        maps = transfer_maps(replace(problem.starting_at(node), nodes=left + 1))
        gains[node] = -(maps.to_goal @ maps.drift[-1])[:3]
    A, _ = problem.dynamics.step(problem.time_step, intervals - 1)
    gains[-1] = -last_control_map(problem) @ A
    return gains


def last_control_map(problem: Problem) -> Float[Array, "3 6"]:
    """Map from a change of the final state to the last control that best achieves it, m/s²."""
    _, B = problem.dynamics.step(problem.time_step, problem.intervals - 1)
    weight = state_weight(problem)
    return np.asarray(np.linalg.pinv(weight[:, None] * B) * weight)


@dataclass(frozen=True, eq=False)
class Responses:
    """Responses of a craft's states and commanded controls to errors of navigation and burns.

    The J_s components of navigation errors are in open loop those of the initial state; with
    feedback six of the bias, and then six at each node but the last.
    """

    state_to_navigation: Float[Array, "T 6 J_s"]
    state_to_burns: Float[Array, "T 6 m"]  # errors of controls, flattened by time, m = 3(T-1)
    control_to_navigation: Float[Array, "intervals 3 J_s"]
    control_to_burns: Float[Array, "intervals 3 m"]


@lru_cache(maxsize=32)
def open_loop_responses(problem: Problem) -> Responses:
    """Responses without feedback: errors of the initial state and of burns drift on."""
    maps, m = transfer_maps(problem), 3 * problem.intervals
    still = np.zeros((problem.intervals, 3, 6)), np.zeros((problem.intervals, 3, m))
    return Responses(maps.drift, maps.reach, *still)


@lru_cache(maxsize=32)
@np.errstate(under="ignore")
def closed_loop_responses(problem: Problem, late: bool = False) -> Responses:
    """Responses to errors in closed loop: feedback acts on the estimated state at each node.

    At the first node the estimate is the planned state. A ``late`` estimate is that of the node
    before, propagated with the control commanded since.
    """
    intervals, gains = problem.intervals, feedback_gains(problem)
    known, count = 6 * (1 + intervals), 9 * intervals + 6
    A, B = step_maps(problem)
    states, controls = np.zeros((intervals + 1, 6, count)), np.zeros((intervals, 3, count))
    each = np.arange(6)
    states[0, each, each] = states[0, each, 6 + each] = -1.0  # truth less the estimate
    before = np.zeros((6, count))
    for k in range(intervals):
        estimate = states[k].copy()
        estimate[each, each] += 1.0
        estimate[each, 6 * (1 + k) + each] += 1.0
        controls[k] = gains[k] @ (before if late else estimate)
        before = A[k] @ estimate + B[k] @ controls[k]
        pushed = controls[k].copy()
        pushed[each[:3], known + 3 * k + each[:3]] += 1.0
        states[k + 1] = A[k] @ states[k] + B[k] @ pushed
    for some in (states, controls):
        some[np.abs(some) < CORRECTED] = 0.0  # their squares would underflow
    return Responses(
        states[..., :known], states[..., known:], controls[..., :known], controls[..., known:]
    )
