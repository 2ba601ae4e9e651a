"""Exact relative motion by another road than the product's: the exponential of Eq. 1's matrix."""

import numpy as np
from judge.motion import after


def position(
    initial: np.ndarray, controls: np.ndarray, mean_motion: float, time_step: float, time: float
) -> np.ndarray:
    """Where one craft is, m, so long after the start, s; controls are held over each interval."""
    state, left = np.array(initial), time
    for control in controls:
        step = min(time_step, left)
        state = after(mean_motion, step, state, control)
        left -= step
    return after(mean_motion, left, state, np.zeros(3))[:3]
