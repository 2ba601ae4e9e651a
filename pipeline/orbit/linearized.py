"""Linear time-varying motion relative to any bound orbit, by its variational equations.

A craft's inertial difference obeys ẍ = G x + D ẋ + C u, with the gradient (G, D) of all forces at
the reference, the LVLH axes C as columns, and u constant along them over an interval. In pieces of
intervals it is solved by collocation at Chebyshev points (Boyd, "Chebyshev and Fourier Spectral
Methods", ch. 6) and transformed to the rotating frame: polynomials in time, exact to rounding.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import ceil

import numpy as np

from pipeline.arrays import Array, Float
from pipeline.orbit import chebyshev
from pipeline.orbit.arrays import AnyState, Interval, Node, Scalar, Since, StepMaps, Vector, norm
from pipeline.orbit.chebyshev import COEFFICIENTS, INTEGRAL, NODES, POINTS, basis
from pipeline.orbit.closest import LinearMotion
from pipeline.orbit.inertial import Frame, lvlh_frame
from pipeline.orbit.reference_orbit import ReferenceOrbit

AT_ONCE = 256  # pieces that are solved at once, which bounds memory
AHEAD = 64  # intervals beyond a plan's that are computed at once


@dataclass(frozen=True, eq=False)
class Arcs:
    """The reference and maps of motion about it, at q points of each of M pieces of K intervals."""

    half: float  # half of a piece's length, s
    origin: Float[Array, "K M q 6"]  # inertial states of the reference, m and m/s
    frame: Frame  # LVLH frames there
    acceleration: Float[Array, "K M q 3"]  # of the reference, inertial, m/s²
    gradient: Float[Array, "K M q 3 6"]  # of the acceleration with respect to the inertial state
    # A and B, side by side, from the state at an interval's start and the control in it
    maps: Float[Array, "K M q 6 9"]
    series: Float[Array, "K M q 6 9"]  # their Chebyshev coefficients, over each piece
    # from accelerations at a point to equivalent changes of the state at the interval's start
    to_start: Float[Array, "K M q 6 3"]
    acceleration_bound: Float[Array, "K 3 9"]  # bounds on the maps, over an interval
    fourth_derivative_bound: Float[Array, "K 3 9"]  # likewise, of the fourth derivatives

    def window(self, intervals: slice) -> "Arcs":
        """The arcs of a range of intervals alone."""
        half, *others = vars(self).values()
        return Arcs(half, *(one[intervals] for one in others))


@dataclass(frozen=True)
class LinearizedDynamics:
    """Linear time-varying motion about any orbit, as ``ClohessyWiltshire`` about a circle."""

    orbit: ReferenceOrbit
    time_step: float  # length of an interval, s
    intervals: int  # number of intervals that are computed at once

    @property
    def fastest(self) -> float:
        """Largest angular rate of the reference, rad/s."""
        return self.orbit.fastest

    @property
    def arcs(self) -> Arcs:
        """The reference and the maps in the intervals of a plan."""
        return arcs_of(self.orbit, self.time_step, self.intervals)

    def step(self, time: float | Scalar, interval: Interval = 0, since: Since = 0.0) -> StepMaps:
        """As ``ClohessyWiltshire.step``, within the interval alone."""
        A, B = self._from_start(np.asarray(time) + since, interval)
        if np.any(since):
            before, pushed = self._from_start(since, interval)
            A = A @ np.linalg.inv(before)
            B = B - A @ pushed
        return A, B

    def _from_start(self, time: float | Scalar, interval: Interval) -> StepMaps:
        arcs = self._covering(interval)
        pieces = arcs.maps.shape[1]
        along = np.asarray(time) / (2 * arcs.half)
        piece = np.clip(along.astype(int), 0, pieces - 1)
        polynomials = basis(np.asarray(2 * (along - piece) - 1))
        series = arcs.series.reshape(-1, pieces, POINTS, 54)[interval, piece]
        maps = (polynomials[..., None, :] @ series).reshape(*series.shape[:-2], 6, 9)
        return maps[..., :6], maps[..., 6:]

    def drift(self, first: Interval, last: Node) -> Float[Array, "*all 6 6"]:
        """As ``ClohessyWiltshire.drift``."""
        furthest = max(int(np.max(one, initial=0)) for one in (first, last))
        nodes = _nodes(self.orbit, self.time_step, self._count(furthest - 1))
        return nodes[last] @ np.linalg.inv(nodes[first])

    def _count(self, interval: Interval) -> int:
        """Number of intervals to compute so that one is covered; it takes few different values."""
        beyond = int(np.max(interval, initial=0)) + 1 - self.intervals
        return self.intervals + max(0, ceil(beyond / AHEAD)) * AHEAD

    def _covering(self, interval: Interval) -> Arcs:
        return arcs_of(self.orbit, self.time_step, self._count(interval))

    def acceleration_bound(
        self, start: AnyState, control: Vector, time: float, interval: Interval
    ) -> Scalar:
        """Upper bound on ‖p̈‖ over the whole interval, m/s²."""
        return _norm_bound(self._covering(interval).acceleration_bound[interval], start, control)

    def linear_motion(self, interval: Interval) -> LinearMotion:
        """As ``ClohessyWiltshire.linear_motion``."""
        return _motion(self.orbit, self.time_step, self._count(interval))


def _norm_bound(bounds: Float[Array, "*some 3 9"], start: AnyState, control: Vector) -> Scalar:
    given = np.abs(np.concatenate([start, control], axis=-1))
    return np.asarray(norm(np.matvec(bounds, given)))


@lru_cache(maxsize=16)
def _nodes(orbit: ReferenceOrbit, time_step: float, intervals: int) -> Float[Array, "nodes 6 6"]:
    """State transition matrices A from the first node to each."""
    steps = arcs_of(orbit, time_step, intervals).maps[:, -1, -1, :, :6]
    nodes = [np.eye(6)]
    for step in steps:
        nodes.append(step @ nodes[-1])
    return np.stack(nodes)


@lru_cache(maxsize=16)
def _motion(orbit: ReferenceOrbit, time_step: float, intervals: int) -> LinearMotion:
    arcs = arcs_of(orbit, time_step, intervals)
    return LinearMotion(arcs.half, arcs.series, arcs.fourth_derivative_bound, absolute=True)


@lru_cache(maxsize=16)
def arcs_of(orbit: ReferenceOrbit, time_step: float, intervals: int) -> Arcs:
    """The reference and the maps in some intervals, computed once."""
    pieces = chebyshev.pieces_of(orbit.fastest * time_step)
    half = time_step / pieces / 2
    begins = 2 * half * np.arange(intervals * pieces)
    ends = begins[:, None] + half * (1 + NODES[1:])
    origin = orbit.states(np.concatenate([[0.0], ends.ravel()]))
    later = origin[1:].reshape(-1, POINTS - 1, 6)
    first = np.concatenate([origin[:1], later[:-1, -1]])
    origin = np.concatenate([first[:, None], later], axis=1)  # (pieces in all, q, 6)
    acceleration = orbit.acceleration(origin, orbit.ballistic or 0.0)
    frame, gradient = lvlh_frame(origin, acceleration), orbit.gradient(origin)
    local = np.concatenate(
        [
            _to_lvlh(frame[some], _inertial_maps(gradient[some], frame.axes[some], half))
            for some in np.array_split(np.arange(len(origin)), 1 + len(origin) // AT_ONCE)
        ]
    )
    shape = intervals, pieces, POINTS
    maps = local.reshape(*shape, 6, 9)
    for m in range(1, pieces):
        before = maps[:, m - 1, -1]
        passed = maps[:, m, ..., :6] @ before[:, None]
        passed[..., 6:] += maps[:, m, ..., 6:]
        maps[:, m] = passed
    rates = maps[..., 3:, :].reshape(*shape, 27)
    most = [chebyshev.derivative_bound(rates, order, half).max(axis=1) for order in (1, 3)]
    return Arcs(
        half,
        origin.reshape(*shape, 6),
        Frame(frame.axes.reshape(*shape, 3, 3), frame.rate.reshape(*shape, 3)),
        acceleration.reshape(*shape, 3),
        gradient.reshape(*shape, 3, 6),
        maps,
        (COEFFICIENTS @ maps.reshape(*shape, 54)).reshape(maps.shape),
        np.linalg.inv(maps[..., :6])[..., 3:],
        *(one.reshape(intervals, 3, 9) for one in most),
    )


def _inertial_maps(
    gradient: Float[Array, "P q 3 6"], axes: Float[Array, "P q 3 3"], half: float
) -> Float[Array, "P q 6 9"]:
    """Inertial state at each point from that at the piece's start and the LVLH control."""
    # Time is in units of ``half``, s, and so are velocities, so that all numbers are of one size.
    P, q, _, _ = gradient.shape
    motion = np.zeros((P, q, 6, 6))
    motion[..., :3, 3:] = np.eye(3)
    motion[..., 3:, :3] = half**2 * gradient[..., :3]
    motion[..., 3:, 3:] = half * gradient[..., 3:]
    collocated = -INTEGRAL[:, None, :, None] * motion.transpose(0, 2, 1, 3)[:, None]
    matrix = collocated.reshape(P, 6 * q, 6 * q) + np.eye(6 * q)
    given = np.zeros((P, q, 6, 9))
    given[..., :6] = np.eye(6)
    given[..., 3:, 6:] = half**2 * np.einsum("ij,pjab->piab", INTEGRAL, axes)
    maps = np.linalg.solve(matrix, given.reshape(P, 6 * q, 9)).reshape(P, q, 6, 9)
    maps[..., 3:, :] /= half
    maps[..., 3:6] *= half
    return maps


def _to_lvlh(frame: Frame, maps: Float[Array, "P q 6 9"]) -> Float[Array, "P q 6 9"]:
    """Convert inertial maps to maps from LVLH state and control to LVLH state."""
    # Columns are the inertial states of LVLH unit states.
    begin = frame[:, None, 0].to_inertial(np.eye(6)).mT
    inertial = np.concatenate([maps[..., :6] @ begin[:, None], maps[..., 6:]], axis=-1)
    return frame[:, :, None].from_inertial(inertial.mT).mT
