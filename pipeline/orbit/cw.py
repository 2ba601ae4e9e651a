"""The Clohessy-Wiltshire equations in closed form (Eq. 1 and 2 of the paper)."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array

SERIES_BELOW = 0.1
"""Angle in rad under which θ - sin θ is taken from its series, not from a difference."""


@dataclass(frozen=True)
class ClohessyWiltshire:
    """Motion relative to a point on a circular orbit, Eq. 1; a case of ``Dynamics``.

    Attributes:
        mean_motion: e of the reference circular orbit, rad/s.
    """

    mean_motion: float

    def step(
        self, time: float | Float[Array, "*batch"]
    ) -> tuple[Float[Array, "*batch 6 6"], Float[Array, "*batch 6 3"]]:
        """A and B, Eq. 2, so long after an interval's start, s."""
        return cw_matrices(self.mean_motion, time)

    def most_acceleration(
        self, start: Float[Array, "*batch 6"], control: Float[Array, "*batch 3"], time: float
    ) -> Float[Array, "*batch"]:
        """A bound on ‖p̈‖ for so long after an interval's start, m/s²; ÿ = u - 2e ẋ."""
        e = self.mean_motion
        in_plane, cross = self._amplitudes(start, control)
        along = np.abs(control[..., 1]) + 2 * e * (np.abs(start[..., 3]) + time * in_plane)
        return np.sqrt(in_plane**2 + cross**2 + along**2)

    def most_fourth_derivative(
        self, start: Float[Array, "*batch 6"], control: Float[Array, "*batch 3"]
    ) -> Float[Array, "*batch"]:
        """A bound on ‖p⁗‖ for all times, m/s⁴.

        x⁗ = -e² ẍ, ‖y⁗‖ ≤ 2e² times the amplitude of ẍ, and z⁗ = -e² z̈.
        """
        in_plane, cross = self._amplitudes(start, control)
        return self.mean_motion**2 * np.hypot(5**0.5 * in_plane, cross)

    def _amplitudes(
        self, start: Float[Array, "*batch 6"], control: Float[Array, "*batch 3"]
    ) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Amplitudes of ẍ and z̈, which under constant control oscillate at e about 0 by Eq. 1."""
        e = self.mean_motion
        x, z = start[..., 0], start[..., 2]
        vx, vy, vz = start[..., 3], start[..., 4], start[..., 5]
        radial = 3 * e**2 * x + 2 * e * vy + control[..., 0]
        in_plane = np.hypot(radial, 2 * control[..., 1] - e * vx)
        return in_plane, np.hypot(control[..., 2] - e**2 * z, e * vz)


def cw_matrices(
    mean_motion: float, time_step: float | Float[Array, "*batch"]
) -> tuple[Float[Array, "*batch 6 6"], Float[Array, "*batch 6 3"]]:
    """The A and B of s[t+1] = A s[t] + B u[t], Eq. 2, with u constant over the step.

    Closed form (Clohessy and Wiltshire 1960; Curtis, "Orbital Mechanics for Engineering
    Students", section 7.4), written so that nothing is divided by the mean motion: it holds
    down to the double integrator at ``mean_motion`` = 0.

    Args:
        mean_motion: e of the reference circular orbit, rad/s.
        time_step: one step or an array of steps, s.

    Returns:
        A and B for states x y z vx vy vz in m and m/s and accelerations in m/s².
    """
    e, t = mean_motion, np.asarray(time_step, dtype=float)
    theta = np.asarray(e * t)
    sin, cos = np.sin(theta), np.cos(theta)
    half = np.sinc(theta / (2 * np.pi))  # sin(θ/2) / (θ/2)
    s = t * np.sinc(theta / np.pi)  # sin θ / e
    c = 0.5 * (t * half) ** 2  # (1 - cos θ) / e²
    d = t**3 * _cubic_remainder(theta)  # (θ - sin θ) / e³

    A = np.zeros((*t.shape, 6, 6))
    A[..., 0, 0] = 1 + 3 * e**2 * c
    A[..., 0, 3] = A[..., 2, 5] = s
    A[..., 0, 4] = 2 * e * c
    A[..., 1, 0] = -6 * e**3 * d
    A[..., 1, 1] = 1
    A[..., 1, 3] = -2 * e * c
    A[..., 1, 4] = 4 * s - 3 * t
    A[..., 2, 2] = A[..., 3, 3] = A[..., 5, 5] = cos
    A[..., 3, 0] = 3 * e**2 * s
    A[..., 3, 4] = 2 * sin
    A[..., 4, 0] = -6 * e**3 * c
    A[..., 4, 3] = -2 * sin
    A[..., 4, 4] = 4 * cos - 3
    A[..., 5, 2] = -(e**2) * s

    B = np.zeros((*t.shape, 6, 3))
    B[..., 0, 0] = B[..., 2, 2] = c
    B[..., 0, 1] = 2 * e * d
    B[..., 1, 0] = -2 * e * d
    B[..., 1, 1] = 4 * c - 1.5 * t**2
    B[..., 3, 0] = B[..., 5, 2] = s
    B[..., 3, 1] = 2 * e * c
    B[..., 4, 0] = -2 * e * c
    B[..., 4, 1] = 4 * s - 3 * t
    return A, B


def _cubic_remainder(theta: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """(θ - sin θ) / θ³, which a difference of nearly equal numbers would spoil near 0."""
    x = theta**2
    series = (1 - x / 20 * (1 - x / 42 * (1 - x / 72 * (1 - x / 110)))) / 6
    small = np.abs(theta) < SERIES_BELOW
    safe = np.where(small, 1.0, theta)
    return np.where(small, series, (safe - np.sin(safe)) / safe**3)
