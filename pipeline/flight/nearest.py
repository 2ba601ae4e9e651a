"""The least separation of craft between the states of flown arcs, in many trials at once.

``orbit.separation`` does the same for the linear model, which it evaluates at any time in closed
form; here motion is known at the ends of short pieces only, and its derivatives are bounded for all
worlds. The branch and bound is the same (``orbit.bezier``).
"""

from dataclasses import dataclass
from math import ceil

import numpy as np
from jaxtyping import Float, Int

from pipeline.arrays import Array
from pipeline.errors import InputError
from pipeline.orbit.approaches import TOLERANCE, least_of_each, pairs
from pipeline.orbit.bezier import branch_and_bound, chord_bound, hermite_bezier, norm, point_on
from pipeline.orbit.separation import Separation

SPACING = 1 / 64
"""Angle in rad by which the reference orbit turns in a piece: cubics are then micrometres off."""

WIDEST = 0.05  # widest such angle for which derivatives are bounded here


@dataclass(frozen=True, eq=False)
class Nearest:
    """The least separation of any pair of each trial over some time."""

    distance: Float[Array, "trials"]  # attained, m; infinite where there is no pair
    bound: Float[Array, "trials"]  # no pair is ever closer, m; about TOLERANCE below
    first: Int[Array, "trials"]  # craft of that pair, with the lower index; -1 if none
    second: Int[Array, "trials"]  # craft of that pair
    time: Float[Array, "trials"]  # when, s since the plan's first node

    def separation(self, trial: int = 0) -> Separation:
        """The least separation of one trial."""
        if self.first[trial] < 0:
            return Separation()
        pair = int(self.first[trial]), int(self.second[trial])
        distance, bound = float(self.distance[trial]), float(self.bound[trial])
        return Separation(distance, bound, pair, float(self.time[trial]))


def pieces_for(duration: float, mean_motion: float) -> int:
    """Pieces of an arc, in s, that are short enough for ``nearest``."""
    return max(1, ceil(mean_motion * duration / SPACING))


def nearest(
    states: Float[Array, "trials n _ 6"], start: float, duration: float, mean_motion: float
) -> Nearest:
    """The least separation at any time of an arc, from states at its pieces' ends.

    Between those a pair's relative position is its cubic Hermite interpolant, up to h⁴/384
    max‖p⁗‖; the cubic's least distance is found by branch and bound. Nothing is sampled: states
    only say which pairs and pieces cannot matter. Memory is some 50 bytes for each trial, pair and
    piece.

    States are at equally spaced times from the arc's start (s since the plan's first node) to its
    end, a duration (s) later, LVLH, m and m/s; the mean motion is the reference orbit's, rad/s.

    Raises:
        InputError: where pieces are too long for the bound on what cubics leave out.
    """
    trials, n, ends, _ = states.shape
    if n < 2:
        never, none = np.full(trials, np.inf), np.full(trials, -1)
        return Nearest(never, never, none, none, np.full(trials, np.nan))
    h = duration / (ends - 1)
    if not mean_motion * h <= WIDEST:
        raise InputError(
            f"an arc of {duration:g} s is cut into {ends - 1} pieces; expected at least "
            f"{pieces_for(duration, mean_motion)}."
        )
    within, trial, pair, piece = _candidates(states, h, mean_motion)
    i, j = (one[pair] for one in pairs(n))
    begin = states[trial, i, piece] - states[trial, j, piece]
    end = states[trial, i, piece + 1] - states[trial, j, piece + 1]
    remainder = h**4 / 384 * _most_derivatives(begin, end, h, mean_motion)[1]
    curve, reach = hermite_bezier(begin, end, h), within[trial]
    near = np.flatnonzero(chord_bound(curve) - remainder <= reach)
    curve, remainder, reach = curve[near], remainder[near], reach[near]
    alone, whole = np.arange(len(near)), (np.zeros(len(near)), np.ones(len(near)))
    when, low = branch_and_bound(curve, remainder, alone, whole, reach, TOLERANCE)
    distance = np.maximum(norm(point_on(curve, when)), low)
    bound = within.copy()
    np.minimum.at(bound, trial[near], low)
    best = least_of_each(distance, trial[near])[1]
    at = near[best]
    time = start + h * (piece[at] + when[best])
    return Nearest(distance[best], bound, i[at], j[at], time)


def nearer(one: Nearest, other: Nearest) -> Nearest:
    """Each trial's least separation over two times."""
    first, beside = one.distance <= other.distance, vars(other)
    least = {name: np.where(first, value, beside[name]) for name, value in vars(one).items()}
    return Nearest(**least | {"bound": np.minimum(one.bound, other.bound)})


def _candidates(
    states: Float[Array, "trials n _ 6"], h: float, mean_motion: float
) -> tuple[Float[Array, "trials"], Int[Array, "k"], Int[Array, "k"], Int[Array, "k"]]:
    """Each trial's least separation at ends of pieces; trials, pairs and pieces that may be closer.

    The distances of a craft from its positions at both ends of a piece add up to at most its chord
    and twice its deviation from that. So a pair that is a and b apart at the ends, with such sums
    ℓ₁ and ℓ₂, is never nearer than (a + b - ℓ₁ - ℓ₂) / 2.
    """
    i, j = pairs(states.shape[1])
    position, begin, end = states[..., :3], states[:, :, :-1], states[:, :, 1:]
    apart = norm(position[:, i] - position[:, j])
    within: Float[Array, trials] = apart.min(axis=(1, 2))
    deviation = h**2 / 8 * _most_derivatives(begin, end, h, mean_motion)[0]
    path = norm(end[..., :3] - begin[..., :3]) + 2 * deviation
    least = (apart[..., :-1] + apart[..., 1:] - path[:, i] - path[:, j]) / 2
    trial, pair, piece = np.nonzero(least <= within[:, None, None])
    return within, trial, pair, piece


def _most_derivatives(
    begin: Float[Array, "*k 6"], end: Float[Array, "*k 6"], h: float, mean_motion: float
) -> tuple[Float[Array, "*k"], Float[Array, "*k"]]:
    """Bounds on ‖p̈‖, m/s², and ‖p⁗‖, m/s⁴, under constant thrust in a piece of h s, e h ≤ 0.05.

    By Eq. 1, p̈ = K p + G ṗ + u with K = e² diag(3, 0, -1) and ‖G‖ = 2e. So the third derivative is
    at most 3e² ‖ṗ‖ + 2e ‖p̈‖, and p̈ is off its mean, Δṗ/h, by no more than that times h/2. The
    fourth, (K + G²) p̈ + G K ṗ, is at most 4e² ‖p̈‖ + 6e³ ‖ṗ‖. Eccentricities up to 0.01, J2 and
    distances up to 1 % of the radius change its coefficients by less than a quarter and add less
    than e⁴ ‖p‖; to p̈ they add the terms of e² p.
    """
    e = mean_motion
    far = np.maximum(norm(begin[..., :3]), norm(end[..., :3]))
    fast = np.maximum(norm(begin[..., 3:]), norm(end[..., 3:]))
    most = 1.1 * norm(end[..., 3:] - begin[..., 3:]) / h + 0.1 * e * fast + 0.01 * e**2 * far
    return most, 5 * e**2 * most + 8 * e**3 * fast + e**4 * far
