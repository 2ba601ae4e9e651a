"""Linear relative motion by intervals: the Clohessy-Wiltshire equations, or about any orbit."""

from dataclasses import dataclass
from functools import lru_cache
from math import factorial

import numpy as np

from pipeline.arrays import Array, Float
from pipeline.orbit.arrays import AnyState, Interval, Node, Scalar, Since, StepMaps, Vector, norm
from pipeline.orbit.chebyshev import COEFFICIENTS, NODES, POINTS, pieces_of
from pipeline.orbit.closest import LinearMotion
from pipeline.orbit.linearized import LinearizedDynamics
from pipeline.orbit.reference import J2, R_EARTH, radius_at

TINY = 1e-20  # angle, rad, in place of 0 where an angle divides its sine
SERIES_BELOW = 0.5  # angle in rad under which θ - sin θ is taken from its series
SERIES = [(-1) ** k / factorial(2 * k + 3) for k in range(7)]  # of (θ - sin θ) / θ³ in θ²


@dataclass(frozen=True)
class ClohessyWiltshire:
    """Motion relative to a point on a circular orbit (Eq. 1), the same in all intervals.

    States x y z vx vy vz in m and m/s, controls in m/s², of a craft or differences of two.
    """

    mean_motion: float  # e, rad/s
    time_step: float  # length of an interval, s

    @property
    def fastest(self) -> float:
        """Largest angular rate of the reference, rad/s."""
        return self.mean_motion

    def step(self, time: float | Scalar, interval: Interval = 0, since: Since = 0.0) -> StepMaps:
        """A and B of s(t) = A s(0) + B u, Eq. 2, for times, s, from an interval's start.

        Or from ``since`` s after its start. Here the time may be longer than the interval.
        """
        return cw_matrices(self.mean_motion, time)

    def drift(self, first: Interval, last: Node) -> Float[Array, "*all 6 6"]:
        """A from one node to another, without control; intervals may lie beyond the plan's."""
        return self.step(self.time_step * (np.asarray(last) - first))[0]

    def acceleration_bound(
        self, start: AnyState, control: Vector, time: float, interval: Interval = 0
    ) -> Scalar:
        """Upper bound on ‖p̈‖ up to a time since an interval's start, m/s², by ÿ = u - 2e ẋ."""
        e = self.mean_motion
        in_plane, cross = self._amplitudes(start, control)
        along = np.abs(control[..., 1]) + 2 * e * (np.abs(start[..., 3]) + time * in_plane)
        return np.sqrt(in_plane**2 + cross**2 + along**2)

    def linear_motion(self, interval: Interval) -> LinearMotion:
        """Maps within intervals, up to the last of those given."""
        return cw_motion(self.mean_motion, self.time_step)

    def _amplitudes(self, start: AnyState, control: Vector) -> tuple[Scalar, Scalar]:
        """Amplitudes of ẍ and z̈, which under constant control oscillate at e about 0 by Eq. 1."""
        e = self.mean_motion
        radial = 3 * e**2 * start[..., 0] + 2 * e * start[..., 4] + control[..., 0]
        in_plane = np.hypot(radial, 2 * control[..., 1] - e * start[..., 3])
        return in_plane, np.hypot(control[..., 2] - e**2 * start[..., 2], e * start[..., 5])


Dynamics = ClohessyWiltshire | LinearizedDynamics  # with the same methods


@lru_cache(maxsize=16)
def cw_motion(mean_motion: float, time_step: float) -> LinearMotion:
    """Maps within an interval as Chebyshev series, from Eq. 2 at the points of its pieces."""
    e, pieces = mean_motion, pieces_of(mean_motion * time_step)
    half = time_step / pieces / 2
    times = half * (2 * np.arange(pieces)[:, None] + 1 + NODES)
    maps = np.concatenate(cw_matrices(e, times), axis=-1).reshape(pieces, POINTS, 54)
    # At all times x⁗ = -e² ẍ and z⁗ = -e² z̈, which oscillate at e, and ‖y⁗‖ ≤ 2e² times ẍ's
    # amplitude. Rows are the parts of the amplitudes of ẍ, times √5, and of z̈.
    fourth = np.zeros((1, 4, 9))
    fourth[0, 0, [0, 4, 6]] = np.array([3 * e**2, 2 * e, 1.0]) * 5**0.5
    fourth[0, 1, [3, 7]] = np.array([-e, 2.0]) * 5**0.5
    fourth[0, 2, [2, 8]] = -(e**2), 1.0
    fourth[0, 3, 5] = e
    series = (COEFFICIENTS @ maps).reshape(1, pieces, POINTS, 6, 9)
    return LinearMotion(half, series, e**2 * fourth, absolute=False)


def cw_matrices(
    mean_motion: float, time_step: float | Scalar
) -> tuple[Float[Array, "*batch 6 6"], Float[Array, "*batch 6 3"]]:
    """A and B of s[t+1] = A s[t] + B u[t] with u constant over the step (Eq. 2).

    Closed form (Clohessy and Wiltshire 1960; Curtis, "Orbital Mechanics for Engineering
    Students", section 7.4), written without divisions by the mean motion e (rad/s): it holds down
    to the double integrator at e = 0. Steps in s, states in m and m/s, accelerations in m/s².
    """
    e, t = mean_motion, np.asarray(time_step, dtype=float)
    theta = np.asarray(e * t)
    safe = np.where(theta == 0, TINY, theta)
    half, sin, cos = 0.5 * safe, np.sin(theta), np.cos(theta)
    s = t * (np.sin(safe) / safe)  # sin θ / e
    root = t * (np.sin(half) / half)
    c = 0.5 * root * root  # (1 - cos θ) / e²
    d = t * t * t * _cubic_remainder(theta)  # (θ - sin θ) / e³
    turn, along = 2 * e * c, 4 * s - 3 * t
    A, B = np.zeros((*t.shape, 6, 6)), np.zeros((*t.shape, 6, 3))
    A[..., 0, 0], A[..., 0, 3], A[..., 0, 4] = 1 + 3 * e**2 * c, s, turn
    A[..., 1, 0], A[..., 1, 1], A[..., 1, 3], A[..., 1, 4] = -6 * e**3 * d, 1.0, -turn, along
    A[..., 2, 2], A[..., 2, 5] = cos, s
    A[..., 3, 0], A[..., 3, 3], A[..., 3, 4] = 3 * e**2 * s, cos, 2 * sin
    A[..., 4, 0], A[..., 4, 3], A[..., 4, 4] = -6 * e**3 * c, -2 * sin, 4 * cos - 3
    A[..., 5, 2], A[..., 5, 5] = -(e**2) * s, cos
    B[..., 0, 0], B[..., 0, 1] = c, 2 * e * d
    B[..., 1, 0], B[..., 1, 1] = -2 * e * d, 4 * c - 1.5 * t * t
    B[..., 2, 2], B[..., 5, 2] = c, s
    B[..., 3, 0], B[..., 3, 1] = s, turn
    B[..., 4, 0], B[..., 4, 1] = -turn, along
    return A, B


def _cubic_remainder(theta: Scalar) -> Scalar:
    """(θ - sin θ) / θ³, without cancellation near 0."""
    x, small = theta * theta, np.abs(theta) < SERIES_BELOW
    series = SERIES[-1]
    for coefficient in SERIES[-2::-1]:
        series = coefficient + x * series
    if small.all():
        return np.asarray(series)
    safe = np.where(small, 1.0, theta)
    return np.where(small, series, (safe - np.sin(safe)) / (safe * safe * safe))


@dataclass(frozen=True)
class ModelError:
    """Estimated error at the goal that the linear model makes."""

    reach: float  # largest distance of a craft from the origin, m
    curvature: float  # error by the neglected terms of a point mass's gravity, m
    oblateness: float  # error by the Earth's J2, m

    @property
    def total(self) -> float:
        """Both together, m."""
        return self.curvature + self.oblateness


def model_error(states: AnyState, dynamics: Dynamics, duration: float) -> ModelError:
    """Order of magnitude of the linear model's error over a transfer of so many seconds.

    At a distance ρ the first neglected term of gravity is some (3/2) e² ρ²/r₀, and the pull of J2
    differs by some 4 J2 (R/r₀)² e² ρ from that at the origin. A constant acceleration a
    moves a craft by a t²/2 in a time t; on relative orbits, from about half a revolution on, by
    2 a t/e along-track. About a reference orbit, J2 is in the linear model, where there is any.
    `prolearn fly` integrates instead.
    """
    radius, angle = radius_at(dynamics.fastest), dynamics.fastest * duration
    growth = min(angle**2 / 2, 2 * angle)
    reach = float(norm(states[..., :3]).max())
    j2 = J2 if isinstance(dynamics, ClohessyWiltshire) else 0.0
    curvature = 1.5 * reach**2 / radius * growth
    return ModelError(reach, curvature, 4 * j2 * (R_EARTH / radius) ** 2 * reach * growth)
