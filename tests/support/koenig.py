"""Secular relative motion under J2 in mean relative orbital elements.

Koenig, Guffanti and D'Amico (2017), "New state transition matrices for spacecraft relative motion
in perturbed orbits", section V, quasi-nonsingular: δa, δλ, δex, δey, δix, δiy.
"""

from typing import Any

import brahe
import numpy as np

RAD: Any = brahe.AngleFormat.RADIANS

APART = np.repeat([30.0, 0.03], 3)
"""Of states whose difference is a derivative, m and m/s."""


def transition(chief: np.ndarray, time: float, oblate: bool = True) -> np.ndarray:
    """The matrix (6, 6) from a chief's mean elements a, e, i, Ω, ω, M over some s."""
    a, e, i, _, perigee, _ = chief
    n, eta = np.sqrt(brahe.GM_EARTH / a**3), np.sqrt(1 - e**2)
    pull = oblate * brahe.J2_EARTH * brahe.R_EARTH**2
    k = 0.75 * pull * np.sqrt(brahe.GM_EARTH) / (a**3.5 * eta**4) * time
    E, F, G = 1 + eta, 4 + 3 * eta, 1 / eta**2
    P, Q = 3 * np.cos(i) ** 2 - 1, 5 * np.cos(i) ** 2 - 1
    S, T = np.sin(2 * i), np.sin(i) ** 2
    cos, sin = np.cos(k * Q), np.sin(k * Q)
    x, y = e * np.cos(perigee), e * np.sin(perigee)
    later_x, later_y = e * np.cos(perigee + k * Q), e * np.sin(perigee + k * Q)
    drift = -1.5 * n * time - 3.5 * k * E * P
    g, q = 4 * k * G * Q, 3.5 * k * Q
    return np.array(
        [
            [1, 0, 0, 0, 0, 0],
            [drift, 1, k * x * F * G * P, k * y * F * G * P, -k * F * S, 0],
            [later_y * q, 0, cos - g * x * later_y, -sin - g * y * later_y, 5 * k * later_y * S, 0],
            [
                -later_x * q,
                0,
                sin + g * x * later_x,
                cos + g * y * later_x,
                -5 * k * later_x * S,
                0,
            ],
            [0, 0, 0, 0, 1, 0],
            [3.5 * k * S, 0, -4 * k * x * G * S, -4 * k * y * G * S, 2 * k * T, 1],
        ]
    )


def mean_elements(state: np.ndarray) -> np.ndarray:
    """Of an osculating inertial state, by Brouwer's theory to first order in J2 (brahe)."""
    method: Any = brahe.MeanElementMethod.BROUWER_LYDDANE
    return brahe.state_koe_osc_to_mean(brahe.state_eci_to_koe(state, RAD), method, RAD)


def relative_elements(chief: np.ndarray) -> np.ndarray:
    """Derivative (6, 6) of mean relative orbital elements by the deputy's inertial state."""
    steps = APART * np.eye(6)
    columns = [_between(chief - one, chief + one) / (2 * one.max()) for one in steps]
    return np.stack(columns, axis=1)


def _between(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Relative orbital elements of two inertial states."""
    (a, e, i, node, w, m), (a2, e2, i2, node2, w2, m2) = map(mean_elements, (one, other))
    turn = (node2 - node + np.pi) % (2 * np.pi) - np.pi
    along = (w2 + m2 - w - m + np.pi) % (2 * np.pi) - np.pi
    middle = (i + i2) / 2
    return np.array(
        [
            2 * (a2 - a) / (a2 + a),
            along + turn * np.cos(middle),
            e2 * np.cos(w2) - e * np.cos(w),
            e2 * np.sin(w2) - e * np.sin(w),
            i2 - i,
            turn * np.sin(middle),
        ]
    )
