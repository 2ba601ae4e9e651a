"""Exact relative motion by another road than the product's: the exponential of Eq. 1's matrix."""

import numpy as np
from scipy.linalg import expm


def position(initial, controls, mean_motion, time_step, time):
    """Where one craft is, m, so long after the start, s; controls are held over each interval."""
    e = mean_motion
    rates = np.zeros((9, 9))
    rates[:3, 3:6] = np.eye(3)
    rates[3, 0], rates[3, 4] = 3 * e**2, 2 * e
    rates[4, 3] = -2 * e
    rates[5, 2] = -(e**2)
    rates[3:6, 6:] = np.eye(3)
    state, left = np.array(initial), time
    for control in controls:
        step = min(time_step, left)
        state = (expm(rates * step) @ np.concatenate([state, control]))[:6]
        left -= step
    return (expm(rates * left) @ np.concatenate([state, np.zeros(3)]))[:3]
