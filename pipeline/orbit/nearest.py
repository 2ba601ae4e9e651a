"""The least separation of craft over arcs that are given at Chebyshev points, in many trials.

``orbit.separation`` does the same for linear motion, evaluated at any time by its maps; here
motion is the polynomial through those points, whatever the forces. The branch and bound is the
same (``orbit.closest``).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.arrays import Array, Float, Int, like, namespace, plain
from pipeline.orbit.approaches import TOLERANCE
from pipeline.orbit.arrays import norm
from pipeline.orbit.chebyshev import COEFFICIENTS, CUBICS, basis, derivative_bound
from pipeline.orbit.closest import closest_of_cubics
from pipeline.orbit.partition import SwarmPartition, least_of_each, swarm_partition
from pipeline.orbit.separation import Separation

ENDS = basis(np.linspace(-1.0, 1.0, CUBICS + 1)) @ COEFFICIENTS
"""Map from states at a piece's points to those at the ends of its cubics."""


@dataclass(frozen=True, eq=False)
class Nearest:
    """The least separation of any pair of each trial over some time."""

    distance: Float[Array, "trials"]  # the separation attained, m; infinite without a pair
    bound: Float[Array, "trials"]  # proven lower bound on it, m; about TOLERANCE below
    first: Int[Array, "trials"]  # its first craft, with the lower index; -1 if none
    second: Int[Array, "trials"]  # its second craft
    time: Float[Array, "trials"]  # when, s since the plan's first node

    def separation(self) -> Separation:
        """The first trial's least separation; infinite for a single craft."""
        if self.first[0] < 0:
            return Separation()
        pair = int(self.first[0]), int(self.second[0])
        return Separation(float(self.distance[0]), float(self.bound[0]), pair, float(self.time[0]))


def nearest(
    states: Float[Any, "trials n pieces q 6"],
    start: float,
    duration: float,
    swarms: SwarmPartition | None = None,
    others: Float[Any, "trials m pieces q 6"] | None = None,
) -> Nearest:
    """The least separation at any time of an arc, from states at its pieces' Chebyshev points.

    Of the pairs of one swarm or of the ``swarms`` given, by sizes; with ``others``, of craft adrift
    after a loss of thrust, whose states are given, from the others.

    Each piece is cut into stretches. On one of length h a pair's relative position is its cubic
    Hermite interpolant, up to h⁴/384 max‖p⁗‖; the cubic's least distance is found by branch and
    bound. Nothing is sampled: states only exclude pairs and stretches that cannot be closest.

    The arc begins at ``start``, s since the plan's first node, and takes ``duration``, s; its
    pieces are of one length. States are LVLH, m and m/s. Where they are torch tensors, the few
    stretches that may be closest are found on their device and searched on the CPU.
    """
    trials, n, pieces, _, _ = states.shape
    swarms = swarms or swarm_partition((n,))
    both = swarms.pairs if others is None else swarms.loss_pairs
    if len(both[0]) == 0:
        return no_pairs(trials)
    half = duration / pieces / 2
    h = 2 * half / CUBICS
    motions = (states,) if others is None else (states, others)
    ends = tuple(like(ENDS, each) @ each for each in motions)
    scale, beyond = swarms.separation_scaling(*both)
    i, j, *sizes = (like(one, states) for one in (*both, scale, beyond))
    found = _candidates(motions, ends, (i, j), half, (sizes[0], sizes[1]))
    within, trial, pair, piece, cubic = map(plain, found)
    i, j, off = (one[pair] for one in (*both, beyond))
    apart = plain(states[trial, i, piece] - motions[-1][trial, j, piece])
    begin, end = (
        plain(ends[0][trial, i, piece, cubic + k] - ends[-1][trial, j, piece, cubic + k])
        for k in (0, 1)
    )
    remainder = h**4 / 384 * norm(derivative_bound(apart[..., 3:], 3, half))
    scale = None if scale is None else scale[pair]
    when, distance, low = closest_of_cubics(
        (begin, end), h, scale, remainder, within[trial] + off, TOLERANCE
    )
    distance, low = np.maximum(distance, low) - off, low - off
    bound = within.copy()
    np.minimum.at(bound, trial, low)
    best = least_of_each(distance, trial)[1]
    time = start + h * (piece[best] * CUBICS + cubic[best] + when[best])
    return Nearest(distance[best], bound, i[best], j[best], time)


def no_pairs(trials: int) -> Nearest:
    """The result for trials without a pair."""
    never, none = np.full(trials, np.inf), np.full(trials, -1)
    return Nearest(never, never, none, none, np.full(trials, np.nan))


def smaller_separation(one: Nearest, other: Nearest) -> Nearest:
    """The smaller of two results for each trial, over both their times."""
    first, beside = one.distance <= other.distance, vars(other)
    least = {name: np.where(first, value, beside[name]) for name, value in vars(one).items()}
    return Nearest(**least | {"bound": np.minimum(one.bound, other.bound)})


def _candidates(
    motions: tuple[Float[Any, "trials _ pieces q 6"], ...],
    ends: tuple[Float[Any, "trials _ pieces ends 6"], ...],
    both: tuple[Int[Any, "p"], Int[Any, "p"]],
    half: float,
    sizes: tuple[Float[Any, "p 3"] | None, Float[Any, "p"]],
) -> tuple[Float[Any, "trials"], Int[Any, "k"], Int[Any, "k"], Int[Any, "k"], Int[Any, "k"]]:
    """Least separation at ends of cubics; trial, pair, piece and cubic that may have a smaller one.

    Motions are of craft and others; a single one stands for both.

    The distances of a craft from its positions at both ends of a cubic add up to at most its chord
    and twice its deviation from that. So a pair that is a and b apart at the ends, with such sums
    ℓ₁ and ℓ₂, is never nearer than (a + b - ℓ₁ - ℓ₂) / 2.
    """
    h, craft = 2 * half / CUBICS, []
    for states, end in zip(motions, ends, strict=True):
        deviation = h**2 / 8 * norm(derivative_bound(states[..., 3:], 1, half))
        craft.append((end[..., :3], deviation))
    (position, deviation), (other_position, other_deviation) = craft[0], craft[-1]
    within, trial, pair, piece = _near(*craft[0], *craft[-1], both, sizes)
    (i, j), (scale, off) = (one[pair] for one in both), sizes
    here, there = position[trial, i, piece], other_position[trial, j, piece]
    gap = here - there
    if scale is not None:
        gap *= scale[pair, None]
    apart = norm(gap) - off[pair, None]
    xp = namespace(apart)
    if xp is np:
        np.minimum.at(within, trial, apart.min(axis=1))
    else:
        within.scatter_reduce_(0, trial, apart.amin(axis=1), "amin")
    path = norm(here[:, 1:] - here[:, :-1]) + 2 * deviation[trial, i, piece][:, None]
    path += norm(there[:, 1:] - there[:, :-1]) + 2 * other_deviation[trial, j, piece][:, None]
    least = (apart[:, :-1] + apart[:, 1:] - path) / 2
    which, cubic = xp.where(least <= within[trial, None])
    return within, trial[which], pair[which], piece[which], cubic


def _near(
    position: Float[Any, "trials _ pieces ends 3"],
    deviation: Float[Any, "trials _ pieces"],
    other_position: Float[Any, "trials _ pieces ends 3"],
    other_deviation: Float[Any, "trials _ pieces"],
    both: tuple[Int[Any, "p"], Int[Any, "p"]],
    sizes: tuple[Float[Any, "p 3"] | None, Float[Any, "p"]],
) -> tuple[Float[Any, "trials"], Int[Any, "k"], Int[Any, "k"], Int[Any, "k"]]:
    """Least separation at ends of pieces; trial, pair and piece that may have a smaller one.

    The relative chord of a pair over a piece comes no nearer to the origin than half of the sum of
    both end distances less its length. The pair deviates from it by at most the sum of both
    craft's deviations, which over a piece are CUBICS² times those over a cubic.
    """
    (i, j), (scale, off) = both, sizes
    begin, end = (position[..., k, :][:, i] - other_position[..., k, :][:, j] for k in (0, -1))
    if scale is not None:
        begin, end = begin * scale[:, None], end * scale[:, None]
    first, last = norm(begin), norm(end)
    away = CUBICS**2 * (deviation[:, i] + other_deviation[:, j]) + off[:, None]
    xp = namespace(first)
    within = xp.amin(xp.minimum(first, last) - off[:, None], axis=(1, 2))
    least = (first + last - norm(end - begin)) / 2 - away
    trial, pair, piece = xp.where(least <= within[:, None, None] + TOLERANCE)
    return within, trial, pair, piece
