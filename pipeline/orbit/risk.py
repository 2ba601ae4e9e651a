"""A bound on the probability that any pair of a swarm ever comes within the collision radius.

For a pair with the mean relative position d(t) n(t), n a unit vector, the distance is at least
n·Δp, whatever Δp is. So a pair that comes within r has g(t) = n(t)·Δp(t) - r < 0 at some time: at
the first already, or after a down-crossing of zero,

    P(some ‖Δp(t)‖ < r) ≤ P(g(0) < 0) + E[down-crossings of 0 by g].

g is Gaussian and smooth, with mean d - r, and it and its derivative are linear in finitely many
Gaussian errors. So the expectation is the integral over time of Rice's formula in its form for
processes that are not stationary (Cramér and Leadbetter 1967, "Stationary and Related Stochastic
Processes", chapter 13.2), with z = (d - r)/σ the level in standard deviations of g,

    φ(z)/σ · E[max(-ġ, 0) | g = 0],

and pairs are summed (Boole's inequality). Where z ≥ K, nothing is integrated: by Cauchy-Schwarz
|g - E g| ≤ σ(t)‖ξ‖ at all times at once, with ξ the pair's J independent standard normals, so that
g can be below 0 there with a probability of at most P(χ²_J ≥ K²), once for all times.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.special import gammainccinv, ndtr

from pipeline.arrays import Array
from pipeline.orbit.approaches import Approaches, close_approaches, pairs
from pipeline.orbit.bezier import dot, norm
from pipeline.orbit.covariance import Dispersion, dispersion
from pipeline.orbit.problem import Problem
from pipeline.orbit.uncertainty import Uncertainty

FAR = 1e-12
"""Probability that is granted to all pairs together while they are far apart."""

ORDER = 8
"""Points of the Gauss-Legendre rule on each panel."""

ACCURACY = 1e-4
"""Share of the sum by which halving all panels may still change it; that change is added."""

COARSE = 1.0
"""Width of the bracket in which least separations of pairs that may be near are found, m."""

TINY = 1e-100
"""A length that stands for none, where one is divided by, m."""

MOST_HALVINGS = 40
"""More than any panel takes; what is left then is added in full."""

_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(ORDER)


@dataclass(frozen=True, eq=False)
class CollisionRisk:
    """Bounds on the probability that pairs come within the collision radius.

    Attributes:
        first: first craft of each pair that is ever near, the one with the lower index, (p,).
        second: second craft, (p,).
        of_pair: bound of each, (p,).
        at_ends: of each the part that its first and last node have at least, whichever is more: as
            craft must be there, no other plan changes it but by other errors, (p,).
        total: bound on the probability that any pair of the swarm does, at any time.
    """

    first: Int[Array, "p"]
    second: Int[Array, "p"]
    of_pair: Float[Array, "p"]
    at_ends: Float[Array, "p"]
    total: float


@dataclass(frozen=True, eq=False)
class _Stretches:
    """Pairs and intervals in which they may be near: means at the start, and covariances.

    Attributes:
        pair: number of the pair.
        state: mean difference of states at the interval's start, m and m/s.
        push: mean difference of controls, m/s².
        covariances: of both.
        near: distance from which the pair is far, m.
        scale: by how much a pair may move on a panel before that is halved unseen, m.
        bend: bound on the relative acceleration, m/s².
    """

    pair: Int[Array, "s"]
    state: Float[Array, "s 6"]
    push: Float[Array, "s 3"]
    covariances: tuple[Float[Array, "s 6 6"], Float[Array, "s 3 3"]]
    near: Float[Array, "s"]
    scale: Float[Array, "s"]
    bend: Float[Array, "s"]


@dataclass(frozen=True, eq=False)
class _Panels:
    """Parts of stretches: which stretch, when they begin since its start, how long they are, s."""

    stretch: Int[Array, "q"]
    begin: Float[Array, "q"]
    width: Float[Array, "q"]

    def halves(self) -> "_Panels":
        """Both halves of each, first all former ones."""
        half = self.width / 2
        begin = np.concatenate([self.begin, self.begin + half])
        return _Panels(np.tile(self.stretch, 2), begin, np.tile(half, 2))

    def where(self, keep: Array) -> "_Panels":
        """Some of them."""
        return _Panels(self.stretch[keep], self.begin[keep], self.width[keep])


def collision_risk(
    states: Float[Array, "n T 6"],
    controls: Float[Array, "n intervals 3"],
    problem: Problem,
    uncertainty: Uncertainty,
) -> CollisionRisk:
    """The risk of flying controls in open loop, at any time from the first node to the last.

    Args:
        states: node states as planned, m and m/s.
        controls: as planned, m/s².
        problem: dynamics, time step and collision radius.
        uncertainty: what is not known of the initial states, and not done as planned.
    """
    radius, (i, j) = problem.collision_radius, pairs(len(states))
    if len(i) == 0:
        return CollisionRisk(i, j, np.zeros(0), np.zeros(0), 0.0)
    spread = dispersion(controls, problem, uncertainty)
    stretches, broken = _stretches(states, controls, problem, spread)
    start, end = (ndtr(-levels_at(node, i, j, states, spread, radius)) for node in (0, -1))
    total = start.copy()
    np.add.at(total, *_crossings(stretches, problem))
    total[broken] = 1.0
    shown = np.flatnonzero(total > FAR / len(total))
    each = np.minimum(total[shown], 1.0)
    ends = np.minimum(np.maximum(start, end)[shown], each)
    return CollisionRisk(i[shown], j[shown], each, ends, min(1.0, float(total.sum()) + FAR))


def levels_at(
    node: int,
    first: Int[Array, "k"],
    second: Int[Array, "k"],
    states: Float[Array, "n T 6"],
    spread: Dispersion,
    distance: float,
) -> Float[Array, "k"]:
    """How many standard deviations pairs are further apart than a distance, m, at a node."""
    gap = states[first, node, :3] - states[second, node, :3]
    apart = norm(gap)
    normal = gap / np.maximum(apart, TINY)[:, None]
    covariance = spread.state_covariance[first, node] + spread.state_covariance[second, node]
    sigma = np.sqrt(dot(np.vecmat(normal, covariance[:, :3, :3]), normal))
    return (apart - distance) / np.maximum(sigma, TINY)


def _stretches(
    states: Float[Array, "n T 6"],
    controls: Float[Array, "n intervals 3"],
    problem: Problem,
    spread: Dispersion,
) -> tuple[_Stretches, Int[Array, "b"]]:
    """Where pairs may be near, and the pairs whose planned motion itself comes too close.

    A broken pair's risk is about one half at least, and counts as one.
    """
    n, _, _, normals = spread.state.shape
    deviations = np.sqrt(2 * gammainccinv(normals / 2, FAR / (n * (n - 1) / 2)))  # K
    radius, h = problem.collision_radius, problem.time_step
    deviation = spread.most_deviation(problem)
    within = radius + deviations * np.sqrt(2) * float(deviation.max())
    broken = _numbers(close_approaches(states, controls, problem, radius), n)
    found = close_approaches(states, controls, problem, within, tolerance=COARSE)
    i, j, k = found.first, found.second, found.interval
    number, sigma = _numbers(found, n), np.hypot(deviation[i, k], deviation[j, k])
    keep = (found.bound < radius + deviations * sigma) & ~np.isin(number, broken)
    i, j, k, number, sigma = (one[keep] for one in (i, j, k, number, sigma))
    state, push = states[i, k] - states[j, k], controls[i, k] - controls[j, k]
    return _Stretches(
        pair=number,
        state=state,
        push=push,
        covariances=spread.of_pairs(i, j, k),
        near=radius + deviations * sigma,
        scale=np.sqrt(radius * sigma),
        bend=problem.dynamics.most_acceleration(state, push, h),
    ), broken


def _numbers(found: Approaches, n: int) -> Int[Array, "k"]:
    """Of the pairs, in the order of ``pairs``."""
    i, j = found.first, found.second
    return i * (2 * n - i - 1) // 2 + j - i - 1


def _near(stretches: _Stretches, problem: Problem) -> _Panels:
    """Panels that hold all times at which pairs are near, each short against a pass."""
    many, h = len(stretches.pair), problem.time_step
    panels = _Panels(np.arange(many), np.zeros(many), np.full(many, h))
    done: list[_Panels] = []
    for _ in range(MOST_HALVINGS):
        at, half = panels.stretch, panels.width / 2
        A, B = problem.dynamics.step(panels.begin + half)
        middle = np.matvec(A, stretches.state[at]) + np.matvec(B, stretches.push[at])
        moved = (norm(middle[:, 3:]) + stretches.bend[at] * half) * half  # at most, from there
        near = norm(middle[:, :3]) - moved < stretches.near[at]
        short = 2 * moved <= stretches.scale[at]
        done.append(panels.where(near & short))
        panels = panels.where(near & ~short).halves()
        if len(panels.stretch) == 0:
            break
    done.append(panels)
    parts = ([getattr(one, name) for one in done] for name in ("stretch", "begin", "width"))
    return _Panels(*map(np.concatenate, parts))


def _crossings(
    stretches: _Stretches, problem: Problem
) -> tuple[Int[Array, "q"], Float[Array, "q"]]:
    """Pairs, and expected down-crossings of g on parts of the time; what may be missed included.

    Panels are halved until that changes the sum by no more than its share, and the changes of the
    last halving are added. Those that all together hold no more than FAR stay whole, and count
    twice.
    """
    panels = _near(stretches, problem)
    coarse = _expected(panels, stretches, problem)
    quiet = coarse * max(1, len(coarse)) <= FAR
    pair, value, summed = [stretches.pair[panels.stretch[quiet]]], [2 * coarse[quiet]], 0.0
    panels, coarse = panels.where(~quiet), coarse[~quiet]
    for halving in range(MOST_HALVINGS):
        many = len(coarse)
        if many == 0:
            break
        halves = panels.halves()
        fine = _expected(halves, stretches, problem)
        both = fine[:many] + fine[many:]
        change = np.abs(both - coarse)
        settled = change <= ACCURACY * (summed + both.sum()) / many
        if halving == MOST_HALVINGS - 1:
            settled[:] = True
        pair.append(stretches.pair[panels.stretch[settled]])
        value.append((both + change)[settled])
        summed += float(both[settled].sum())
        rest = np.tile(~settled, 2)
        panels, coarse = halves.where(rest), fine[rest]
    return np.concatenate(pair), np.concatenate(value)


def _expected(panels: _Panels, stretches: _Stretches, problem: Problem) -> Float[Array, "q"]:
    """Expected down-crossings of 0 by g on each panel, by Gauss and Legendre."""
    at, width = panels.stretch, panels.width
    offset = panels.begin[:, None] + width[:, None] * (1 + _POINTS) / 2
    A, B = problem.dynamics.step(offset)
    mean = np.matvec(A, stretches.state[at][:, None]) + np.matvec(B, stretches.push[at][:, None])
    position, velocity = mean[..., :3], mean[..., 3:]
    distance = norm(position)
    n = position / distance[..., None]
    slope = dot(n, velocity)
    turn = (velocity - slope[..., None] * n) / distance[..., None]  # ṅ
    errors = np.zeros((*offset.shape, 2, 6))  # of g: n·δp, and of its derivative: ṅ·δp + n·δv
    errors[..., 0, :3] = errors[..., 1, 3:] = n
    errors[..., 1, :3] = turn
    covariance = np.zeros((*offset.shape, 2, 2))
    for to, given in zip((A, B), stretches.covariances, strict=True):
        row = errors @ to
        covariance += row @ given[at][:, None] @ row.mT
    rate = crossing_rate(distance - problem.collision_radius, slope, covariance)
    return width / 2 * (rate @ _WEIGHTS)


def crossing_rate(
    mean: Float[Array, "*batch"],
    slope: Float[Array, "*batch"],
    covariance: Float[Array, "*batch 2 2"],
) -> Float[Array, "*batch"]:
    """Rice's formula: expected down-crossings of 0 by a smooth Gaussian process, 1/s.

    Args:
        mean: of the process, positive wherever it has no variance.
        slope: mean of its derivative, per s.
        covariance: of the process and its derivative.
    """
    variance, mixed = covariance[..., 0, 0], covariance[..., 0, 1]
    known = np.where(variance > 0, variance, 1.0)
    sigma = np.sqrt(known)
    drift = slope - mixed / known * mean  # of the derivative, where the process is 0
    rest = np.sqrt(np.maximum(covariance[..., 1, 1] - mixed**2 / known, 0.0))
    ratio = np.divide(drift, rest, out=np.full_like(drift, np.inf), where=rest > 0)
    # E[max(-ġ, 0)] of a normal variable with that mean and deviation.
    down = rest * _density(ratio) + np.where(rest > 0, -drift * ndtr(-ratio), -drift.clip(max=0))
    return np.where(variance > 0, _density(mean / sigma) / sigma * down, 0.0)


def _density(z: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """Of the standard normal distribution."""
    return np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi)
