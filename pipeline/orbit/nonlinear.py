"""Nonlinear motion about a reference, with gravity, J2 and drag, by collocation.

A craft's state obeys the linear equations with an additional acceleration: what the linearization
of forces about the reference leaves out. It is of second order in the distance: fixed-point
iteration for all craft and times at once converges in a few steps (Bai and
Junkins 2011, "Modified Chebyshev-Picard iteration methods for orbit propagation").
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil

import numpy as np

from pipeline.arrays import Array, Float, Int
from pipeline.errors import ProlearnError
from pipeline.orbit import chebyshev
from pipeline.orbit.arrays import Controls, Formation, PerCraft, States, Values, norm
from pipeline.orbit.chebyshev import ANGLE, COEFFICIENTS, INTEGRAL, NODES, POINTS, basis
from pipeline.orbit.corridors import Faces, least_margin
from pipeline.orbit.drift_search import NO_LENGTH
from pipeline.orbit.linearized import Arcs, LinearizedDynamics
from pipeline.orbit.nearest import Nearest, nearest
from pipeline.orbit.partition import SwarmPartition, swarm_partition
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import R_EARTH
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.orbit.separation import Separation

CONVERGED = 1e-9  # change of positions, m, at which iteration ends; relative where craft are far
WINDOW = 2.0  # angle by which the reference turns in the arc that is iterated at once, rad
AT_ONCE = 64  # intervals of a drift in which craft are compared at once, which bounds memory


def flown_arcs(
    dynamics: LinearizedDynamics,
    initial: Formation,
    controls: Float[Array, "n K 3"],
    ballistics: PerCraft,
    first: int = 0,
) -> Float[Array, "n K M q 6"]:
    """States at the points of all arcs of controls, m/s², from initial states; LVLH, m and m/s.

    Ballistics are C_D A/m, m²/kg. ``first`` is the plan's interval of the first control.
    ProlearnError where craft are too far from the reference for it to converge, or hit the Earth.
    """
    orbit, count = dynamics.orbit, controls.shape[1]
    parts = ceil(orbit.fastest * dynamics.time_step / WINDOW)
    if parts > 1:  # each from its own start: maps over revolutions would enlarge rounding
        step, intervals = dynamics.time_step / parts, dynamics.intervals * parts
        cut = replace(dynamics, time_step=step, intervals=intervals)
        held = np.repeat(controls, parts, axis=1)
        found = flown_arcs(cut, initial, held, ballistics, first * parts)
        return found.reshape(len(initial), count, parts * found.shape[2], POINTS, 6)
    arcs = dynamics.arcs
    pieces = arcs.maps.shape[1]
    together = max(1, int(WINDOW / (orbit.fastest * 2 * arcs.half)) // pieces)  # intervals
    found = np.empty((len(initial), count, pieces, POINTS, 6))
    state = initial
    for k in range(0, count, together):
        flown = slice(k, min(k + together, count))
        window = arcs.window(slice(first + flown.start, first + flown.stop))
        found[:, flown] = _window(window, orbit, state, controls[:, flown], ballistics)
        _refuse_impact(found[:, flown, ..., :3], norm(window.origin[..., :3]))
        state = found[:, flown.stop - 1, -1, -1]
    return found


@dataclass(frozen=True, eq=False)
class NonlinearFlight:
    """The nonlinear flight of controls about a problem's reference orbit."""

    initial: Formation  # LVLH states at the first node, m and m/s
    controls: Controls  # m/s²
    problem: Problem

    @cached_property
    def arcs(self) -> Float[Array, "n K M q 6"]:
        """States of craft at the points of all arcs, LVLH, m and m/s."""
        dynamics = _dynamics(self.problem)
        ballistics = dynamics.orbit.ballistics(len(self.initial))
        return flown_arcs(dynamics, self.initial, self.controls, ballistics)

    @property
    def states(self) -> States:
        """Node states, m and m/s."""
        return np.concatenate([self.initial[:, None], self.arcs[:, :, -1, -1]], axis=1)

    def separation(self, swarms: SwarmPartition | None = None) -> Separation:
        """The least separation at any time: of craft, or of participants, by their sizes."""
        arcs = self.arcs
        if swarms is not None:
            begin = swarms.all_states(self.initial[:, None], slice(0, 1))[:, 0]
            arcs = _arcs_beside(begin, self.controls, _dynamics(self.problem), swarms)
        return nearest(_pieces(arcs), 0.0, self.problem.duration, swarms).separation()

    def margin(self, faces: Faces) -> Nearest:
        """Least margin of craft inside corridors, by ``least_margin``."""
        return least_margin(_pieces(self.arcs), faces, 0.0, self.problem.duration)

    def times(self) -> Float[Array, "K M q"]:
        """The times of the points of all arcs, s since the first node."""
        pieces = self.arcs.shape[2]
        share = (np.arange(pieces)[:, None] + (1 + NODES) / 2) / pieces
        return self.problem.time_step * (np.arange(self.problem.intervals)[:, None, None] + share)

    def from_linear(self, states: States) -> Float[Array, "n K M q 3"]:
        """Positions at the points of arcs less those of linear motion from each node's state, m."""
        each = np.arange(self.problem.intervals)[:, None]
        A, B = self.problem.dynamics.step(self.times()[0].ravel(), each)
        linear = np.matvec(A, states[:, :-1, None]) + np.matvec(B, self.controls[:, :, None])
        positions = self.arcs[..., :3]
        return np.asarray(positions - linear[..., :3].reshape(positions.shape))

    def from_linear_at(self, states: States, time: Values) -> Float[Array, "n t 3"]:
        """Deviation from linear motion as in ``from_linear``, m, at times since the start, s."""
        step = self.problem.time_step
        interval = np.minimum(time // step, self.problem.intervals - 1).astype(int)
        piece, weights = self._interpolation(time - interval * step)
        off = self.from_linear(states)[:, interval, piece]
        return np.asarray(np.einsum("tq,ntqs->nts", weights, off))

    def deviation(self, states: States) -> float:
        """Upper bound on the distance of any craft at any time from linear motion, m.

        Linear motion starts anew at each node's state. The bound is the sum of the absolute
        Chebyshev coefficients of the difference.
        """
        off = COEFFICIENTS @ self.from_linear(states)
        return float(norm(off).sum(axis=-1).max())

    def between(self, time: Float[Array, "K t"]) -> Float[Array, "n K t 6"]:
        """States at times since the start of each interval, s."""
        piece, weights = self._interpolation(time)
        each = np.arange(len(time))[:, None]
        return np.asarray(np.einsum("ktq,nktqs->nkts", weights, self.arcs[:, each, piece]))

    def _interpolation(
        self, since: Float[Array, "*batch"]
    ) -> tuple[Int[Array, "*batch"], Float[Array, "*batch q"]]:
        """Arcs of times since the start of an interval, s, and weights of the arcs' points."""
        pieces = self.arcs.shape[2]
        along = since / self.problem.time_step * pieces
        piece = np.clip(along.astype(int), 0, pieces - 1)
        return piece, basis(2 * (along - piece) - 1) @ COEFFICIENTS


def least_after_loss_nonlinear(
    states: States,
    controls: Controls,
    problem: Problem,
    orbits: float,
    swarms: SwarmPartition | None = None,
) -> Separation:
    """The least distance of a craft that has lost its thrust to another, in nonlinear flight.

    As ``least_after_loss`` in linear motion; the last interval of a drift is rounded up. Of a swarm
    with obstacles, or radii, it is the least separation of participants.
    """
    swarms = swarms or swarm_partition((len(states),))
    least = Separation()
    for node, lost, met, begin, h in _adrift(states, controls, problem, orbits, swarms):
        for k in range(0, lost.shape[1], AT_ONCE):
            parts = lost[:, k : k + AT_ONCE], met[:, k : k + AT_ONCE]
            one, other = map(_pieces, parts)
            length = parts[0].shape[1] * h
            found = nearest(one, begin + k * h, length, swarms, other).separation()
            nearer = replace(found, node=node) if found.distance < least.distance else least
            least = replace(nearer, bound=min(found.bound, least.bound))
    return least


def _adrift(
    states: States, controls: Controls, problem: Problem, orbits: float, swarms: SwarmPartition
) -> Iterator[tuple[int, Array, Array, float, float]]:
    """Arcs of craft after loss of thrust at a node, and beside them of all participants.

    With the node, and begin and length of the arcs' intervals, s: those of the plan to its end and
    then blocks of them, as long as a piece may be. Also before, craft adrift are flown by blocks,
    from the first on that begins no earlier than their node.
    """
    n, last, h = len(states), problem.intervals, problem.time_step
    after = int(np.ceil(orbits * 2 * np.pi / problem.mean_motion / h - NO_LENGTH))
    dynamics = _dynamics(problem)
    orbit, ballistics = dynamics.orbit, dynamics.orbit.ballistics(n)
    many = max(1, int(ANGLE / (orbit.fastest * h) - NO_LENGTH))
    blocks, early = divmod(last, many)  # the last block of a plan ends with it
    beyond, end, idle = ceil(after / many), last * h, np.zeros((n, last + after, 3))
    longer = LinearizedDynamics(orbit.later(early * h), many * h, blocks + beyond)
    # From points of a block, which is one piece, to those of its intervals
    points = -1 + (2 * np.arange(min(many, last))[:, None] + 1 + NODES) / many
    to_intervals = basis(points) @ COEFFICIENTS
    begin = swarms.all_states(states[:, :1], slice(0, 1))[:, 0]
    flown = _arcs_beside(begin, controls, dynamics, swarms)
    drifting = _arcs_beside(flown[:, -1, -1, -1], idle[:, :beyond], longer, swarms, blocks)
    for node in range(last + 1):
        first = max(0, ceil((node - early) / many))
        short = min(after, early + first * many - node)
        lost = flown_arcs(dynamics, states[:, node], idle[:, :short], ballistics, node)
        start, left = lost[:, -1, -1, -1] if short else states[:, node], after - short
        far = flown_arcs(longer, start, idle[:, : ceil(left / many)], ballistics, first)
        near, far = np.split(far, [blocks - first], axis=1)
        near = (to_intervals @ near).reshape(n, -1, *lost.shape[2:])
        lost = np.concatenate([lost, near], axis=1)[:, :after]
        yield node, lost, flown[:, node : node + after], node * h, h
        whole, rest = divmod(after - lost.shape[1], many)
        yield node, far[:, :whole], drifting[:, :whole], end, many * h
        if rest:  # the last block in part
            cut = basis((1 + NODES) * rest / many - 1) @ COEFFICIENTS
            met, begins = cut @ drifting[:, whole : whole + 1], end + whole * many * h
            yield node, cut @ far[:, whole:], met, begins, rest * h


def _dynamics(problem: Problem) -> LinearizedDynamics:
    dynamics = problem.dynamics
    assert isinstance(dynamics, LinearizedDynamics)  # only about a reference orbit
    return dynamics


def _pieces(arcs: Float[Array, "n K M q 6"]) -> Float[Array, "1 n pieces q 6"]:
    """Arcs as the batch of one trial, with the pieces of all intervals along one axis."""
    return arcs.reshape(1, len(arcs), -1, *arcs.shape[3:])


def _arcs_beside(
    start: Float[Array, "participants 6"],
    controls: Controls,
    dynamics: LinearizedDynamics,
    swarms: SwarmPartition,
    first: int = 0,
) -> Float[Array, "participants K M q 6"]:
    """Arcs of craft and of obstacles, which have the mean ballistic coefficient or are held."""
    n = len(controls)
    pushed = np.zeros((len(start), *controls.shape[1:]))
    pushed[:n] = controls
    ballistics = np.full(len(start), dynamics.orbit.ballistic or 0.0)
    ballistics[:n] = dynamics.orbit.ballistics(n)
    begin = np.array(start)
    begin[swarms.held] = 0.0  # where they are held they might drift into the Earth
    arcs = flown_arcs(dynamics, begin, pushed, ballistics, first)
    arcs[swarms.held] = start[swarms.held, None, None, None]
    return arcs


def _window(
    arcs: Arcs,
    orbit: ReferenceOrbit,
    start: Formation,
    controls: Float[Array, "n K 3"],
    ballistics: PerCraft,
) -> Float[Array, "n K M q 6"]:
    """States at all points of some arcs, from states at the start of the first interval."""
    linear = _linear(arcs, start, controls)
    flown = linear
    enough = max(CONVERGED, chebyshev.ROUNDING * float(np.abs(linear[..., :3]).max()))
    for _ in range(chebyshev.ITERATIONS):
        added = _added(arcs, _remainder(arcs, orbit, flown, ballistics))
        before, flown = flown, linear + added
        change = float(np.abs(flown[..., :3] - before[..., :3]).max())
        if change <= enough:
            return flown
        if not np.isfinite(change):
            break
    raise ProlearnError(
        f"the flight about the reference orbit did not converge: its last change was {change:.3g} "
        "m; expected craft that stay near the reference."
    )


def _refuse_impact(position: Float[Array, "n K M q 3"], radius: Float[Array, "K M q"]) -> None:
    """Raise ProlearnError for LVLH positions in the Earth, by the reference's orbital radius, m."""
    least = float(norm(position + radius[..., None] * [1.0, 0.0, 0.0]).min())
    if least < R_EARTH:
        raise ProlearnError(
            f"a craft comes within {least / 1e3:.6g} km of the Earth's centre; expected flights "
            f"that stay above its radius, {R_EARTH / 1e3:.6g} km."
        )


def _linear(
    arcs: Arcs, start: Formation, controls: Float[Array, "n K 3"]
) -> Float[Array, "n K M q 6"]:
    """The linear motion at all points."""
    given, state = np.empty((controls.shape[1], 9, len(start))), start
    for k, step in enumerate(arcs.maps[:, -1, -1]):
        given[k] = np.concatenate([state, controls[:, k]], axis=1).T
        state = (step @ given[k]).T
    return np.moveaxis(arcs.maps @ given[:, None, None], -1, 0)


def _added(arcs: Arcs, acceleration: Float[Array, "n K M q 3"]) -> Float[Array, "n K M q 6"]:
    """State changes at the collocation points due to accelerations, by variation of constants."""
    integral = arcs.half * (INTEGRAL @ np.matvec(arcs.to_start, acceleration))
    ends = np.cumsum(integral[:, :, :, -1], axis=2)  # of pieces, since the interval's start
    integral[:, :, 1:] += ends[:, :, :-1, None]
    state = np.zeros((len(integral), 6))
    for k, step in enumerate(arcs.maps[:, -1, -1, :, :6]):
        integral[:, k] += state[:, None, None]
        state = integral[:, k, -1, -1] @ step.T
    return np.matvec(arcs.maps[..., :6], integral)


def _remainder(
    arcs: Arcs, orbit: ReferenceOrbit, states: Float[Array, "n K M q 6"], ballistics: PerCraft
) -> Float[Array, "n K M q 3"]:
    """Acceleration at LVLH states that the linear equations neglect, along LVLH axes, m/s²."""
    relative = arcs.frame.to_inertial(states)
    held = np.broadcast_to(ballistics[:, None, None, None], states.shape[:-1])
    total = orbit.acceleration(arcs.origin + relative, held)
    left = total - arcs.acceleration - np.matvec(arcs.gradient, relative)
    return np.matvec(arcs.frame.axes.mT, left)
