"""A bound on the probability that any pair of a swarm ever comes within the collision radius r.

Derived in ``docs/risk.md``: at some times a pair has a check X = n·Δp - r - η along the direction n
in which a collision is likeliest, with a margin η for the rotation of n and the curvature of the
motion until the next check. A pair that collides fails the first check, or one after a check that
it passes,

    P(some ‖Δp‖ < r) ≤ P(X₀ < 0) + Σ P(Xₖ ≥ 0 > Xₖ₊₁),

and pairs are summed (Boole's inequality). Where errors are larger than r in one direction there are
checks on both sides along it, X and Y = -n·Δp - r - η, and the smaller of both bounds is taken.
The margins η, and the choice of times without checks, are valid at all times except with the
probability P(χ²_J ≥ K²), of J standard normal variables, which is added.
"""

from dataclasses import dataclass, replace

import numpy as np

from pipeline.arrays import Array, Bool, Float, Int
from pipeline.orbit.approaches import Approaches, close_approaches
from pipeline.orbit.arrays import Controls, Indices, Rows, States, Values, Vectors, norm
from pipeline.orbit.covariance import Dispersion, standard_deviation
from pipeline.orbit.partition import pairs
from pipeline.orbit.problem import Problem

FAR = 1e-12  # probability, over all pairs, of deviations beyond K, which are not examined
ACCURACY = 0.02  # share of the sum that margins may contribute, by an upper estimate
COARSE = 1.0  # tolerance of least separations in the search for pairs that may be near, m
SHORTEST = 1e-9  # share of an interval below which panels are not halved
MOST_PANELS = 200_000  # which bounds memory
ROUNDING = 1e-15  # rounding error of the probability of a panel
TINY = 1e-100  # divisor in place of 0
APART = 1e-30  # least distance, m, between points with a direction
NEWTON_STEPS = 8  # more than enough near the likeliest point; any direction gives a bound


@dataclass(frozen=True, eq=False)
class CollisionRisk:
    """Bounds on the probability that pairs come within the collision radius."""

    first: Int[Array, "p"]  # first craft, of lower index, of each pair with a risk
    second: Int[Array, "p"]  # second craft
    of_pair: Float[Array, "p"]  # bound of each
    # bound at the first or the last node, the larger, on which the plan has little influence
    at_ends: Float[Array, "p"]
    total: float  # bound for any pair of the swarm at any time, with the risk of saturation
    saturation: float = 0.0  # bound on the probability that feedback exceeds a thrust limit
    corrections: float = 0.0  # mean fuel that feedback adds to the plan's, of all craft, m/s²


Functionals = Float[Array, "k 9"]  # linear in the errors of state and control


@dataclass(frozen=True, eq=False)
class _Stretches:
    """Intervals in which pairs may be near, by pair and interval."""

    problem: Problem  # dynamics, time step and collision radius
    pair: Int[Array, "s"]  # index of the pair, in the order of ``pairs``
    interval: Int[Array, "s"]  # index of the interval
    state: Float[Array, "s 6"]  # mean difference of states at the interval's start, m and m/s
    control: Float[Array, "s 3"]  # mean difference of controls, m/s²
    errors: Float[Array, "s 9 9"]  # covariance of the errors of state and control
    near: Float[Array, "s"]  # distance beyond which the pair needs no check, m
    bend: Float[Array, "s"]  # bound on the mean relative acceleration, m/s²
    stray: Float[Array, "s"]  # bound on the relative acceleration along any direction, m/s²
    max_sigma: float  # K, standard deviations that margins allow for
    two_sided: bool = False  # whether checks are on both sides, along the largest error

    def maps(self, which: Indices, share: Values) -> Float[Array, "k 6 9"]:
        """Maps from state and control to relative states at shares of the interval."""
        time = share * self.problem.time_step
        return np.concatenate(self.problem.dynamics.step(time, self.interval[which]), axis=-1)

    def mean(self, which: Indices, maps: Float[Array, "k d 9"]) -> Float[Array, "k d"]:
        """Mean relative state, or position, m and m/s."""
        free, pushed = maps[..., :6], maps[..., 6:]
        return np.matvec(free, self.state[which]) + np.matvec(pushed, self.control[which])

    def directions(self, which: Indices, share: Values) -> Vectors:
        """Directions of checks at shares of the interval: where collisions are likeliest."""
        maps = self.maps(which, share)[:, :3]
        spread = maps @ self.errors[which] @ maps.mT
        if self.two_sided:
            along = np.linalg.eigh(spread)[1][..., -1]
            return along * np.where(along.sum(axis=-1) < 0, -1.0, 1.0)[:, None]
        mean = self.mean(which, maps)
        return likeliest_direction(mean, spread, self.problem.collision_radius)

    def may_be_near(self, panels: "_Panels") -> Bool[Array, "q"]:
        """Whether pairs may be near at some time of each panel."""
        at, half = panels.stretch, panels.width * self.problem.time_step / 2
        maps = self.maps(at, panels.begin + panels.width / 2)
        mean = self.mean(at, maps)
        moved = (norm(mean[:, 3:]) + self.bend[at] * half) * half  # bound on the motion from there
        near = norm(mean[:, :3]) - moved < self.near[at]
        if not self.two_sided:
            return near
        # Where errors are large in one direction, others may keep the pair apart all the same.
        radius = self.problem.collision_radius
        spread = maps @ self.errors[at] @ maps.mT
        normal = likeliest_direction(mean[:, :3], spread[:, :3, :3], radius)
        place = np.vecdot(normal, mean[:, :3])
        place -= self.max_sigma * standard_deviation(normal, spread[:, :3, :3])
        speed = np.abs(np.vecdot(normal, mean[:, 3:]))
        speed += self.max_sigma * standard_deviation(normal, spread[:, 3:, 3:])
        least = place - (speed + self.stray[at] * half / 2) * half
        return near & (least < radius)


@dataclass(frozen=True, eq=False)
class _Panels(Rows):
    """Times between two successive checks, sorted by stretch and time."""

    stretch: Int[Array, "q"]  # index of the stretch
    begin: Float[Array, "q"]  # begin, as a share of the interval
    width: Float[Array, "q"]  # length, as a share of the interval
    first: Float[Array, "q 3"]  # direction of the check at its begin
    last: Float[Array, "q 3"]  # direction of the check at its end
    chance: Float[Array, "q"]  # probability of failing its check
    excess: Float[Array, "q"]  # the part of it that margins add
    new: Bool[Array, "q"]  # whether neither is known yet

    def joined(self, stretches: _Stretches) -> Bool[Array, "q"]:
        """Whether each panel begins with the check at the end of the panel before."""
        at, before, begin = self.stretch[1:], self.stretch[:-1], self.begin[1:]
        end = self.begin[:-1] + self.width[:-1]
        across = stretches.pair[at] == stretches.pair[before]
        across &= stretches.interval[at] == stretches.interval[before] + 1
        across &= (begin == 0) & (end == 1)
        return np.append(False, (at == before) & (begin == end) | across)[: len(self)]

    def halved(self, split: Bool[Array, "q"], stretches: _Stretches) -> "_Panels":
        """The panels, with some split in two halves and a check between them."""
        parts = np.repeat(np.arange(len(self)), 1 + split)
        second = np.append(False, parts[1:] == parts[:-1])
        first = np.append(second[1:], False)
        found = self[parts]
        found.new[:] = whole = split[parts]
        found.width[whole] /= 2
        found.begin[second] += found.width[second]
        between = stretches.directions(found.stretch[second], found.begin[second])
        found.first[second] = found.last[first] = between
        return found


def collision_risk(
    states: States, controls: Controls, problem: Problem, spread: Dispersion
) -> CollisionRisk:
    """The risk of flying planned states (m, m/s) and controls (m/s²) with a dispersion."""
    i, j = pairs(len(states))
    beyond, added = _feedback(controls, spread, problem.most_control)
    if len(i) == 0:
        return CollisionRisk(i, j, np.zeros(0), np.zeros(0), beyond, beyond, added)
    stretches, broken = _stretches(states, controls, problem, spread)
    total, terms = _sums(stretches, np.isin(stretches.pair, broken, invert=True), len(i))
    total[broken] = 1.0
    error = np.sqrt(np.trace(stretches.errors[:, :3, :3], axis1=1, axis2=2))  # of positions, m
    wide = np.isin(stretches.pair, stretches.pair[error > problem.collision_radius])
    if wide.any():
        both, more = _sums(replace(stretches, two_sided=True), wide, len(i))
        within = np.isin(np.arange(len(i)), stretches.pair[wide])
        total, terms = np.where(within, np.minimum(total, both), total), terms + more
    shown, radius = np.flatnonzero(total > FAR / len(total)), problem.collision_radius
    i, j, each = i[shown], j[shown], np.minimum(total[shown], 1.0)
    ends = [_within(*_at_node(node, i, j, states, spread), radius) for node in (0, -1)]
    most = min(1.0, float(total.sum()) + beyond + (FAR + ROUNDING * terms))
    return CollisionRisk(i, j, each, np.minimum(np.maximum(*ends), each), most, beyond, added)


def _feedback(controls: Controls, spread: Dispersion, most: float) -> tuple[float, float]:
    """Bound on the probability that feedback commands a component above ``most``, m/s².

    And the mean fuel that it adds, E|u + σξ| - |u| summed, m/s².
    """
    from scipy.special import ndtr  # slow to import, and only a risk needs it

    sigma = spread.correction_sigma
    some = sigma > TINY
    size, sigma = np.abs(controls[some]), sigma[some]
    beyond = float(ndtr((np.stack([size, -size]) - most) / sigma).sum())
    ratio = size / sigma
    density = np.exp(-(ratio**2) / 2) / np.sqrt(2 * np.pi)
    return min(1.0, beyond), float(2 * (sigma * density - size * ndtr(-ratio)).sum())


def _at_node(
    node: int, first: Indices, second: Indices, states: States, spread: Dispersion
) -> tuple[Vectors, Float[Array, "k 3 3"]]:
    """Mean and covariance of pairs' relative positions at a node, m and m²."""
    covariance = spread.of_pairs(first, second, node)[:, :3, :3]
    return states[first, node, :3] - states[second, node, :3], covariance


def _within(gap: Vectors, covariance: Float[Array, "k 3 3"], radius: float) -> Values:
    """Bound on the probability that Gaussian relative positions are within a distance, m."""
    from scipy.special import ndtr  # slow to import, and only a risk needs it

    found = np.ones(len(gap))
    largest = np.linalg.eigh(covariance)[1][..., -1]
    for normal in (likeliest_direction(gap, covariance, radius), largest):
        sigma = np.maximum(standard_deviation(normal, covariance), TINY)
        along = np.vecdot(normal, gap)
        found = np.minimum(found, ndtr((radius - along) / sigma) - ndtr((-radius - along) / sigma))
    return found


def sigma_levels(
    node: int, first: Indices, second: Indices, states: States, spread: Dispersion, distance: float
) -> Values:
    """Standard deviations by which separations of pairs at a node exceed a distance, m."""
    gap, covariance = _at_node(node, first, second, states, spread)
    separation = norm(gap)
    sigma = standard_deviation(gap / np.maximum(separation, TINY)[:, None], covariance)
    return (separation - distance) / np.maximum(sigma, TINY)


def _stretches(
    states: States, controls: Controls, problem: Problem, spread: Dispersion
) -> tuple[_Stretches, Int[Array, "b"]]:
    """Stretches in which pairs may be near, and the pairs whose plan itself comes too close."""
    # Checks on one side bound nothing for such pairs, whose risk is 1 unless errors are large.
    from scipy.special import gammainccinv  # slow to import, and only a risk needs it

    n, normals = len(spread.covariance), spread.pair_normals
    most = float(np.sqrt(2 * gammainccinv(normals / 2, FAR / (n * (n - 1) / 2))))  # K
    radius, deviation = problem.collision_radius, spread.deviation_bound(problem)
    within = radius + most * np.sqrt(2) * float(deviation.max())
    broken = _numbers(close_approaches(states, controls, problem, radius), n)
    found = close_approaches(states, controls, problem, within, tolerance=COARSE)
    i, j, k, number = found.first, found.second, found.interval, _numbers(found, n)
    near = radius + most * np.hypot(deviation[i, k], deviation[j, k])
    keep = np.flatnonzero(found.bound < near)
    keep = keep[np.lexsort((k[keep], number[keep]))]
    i, j, k, number, near = (one[keep] for one in (i, j, k, number, near))
    state, push = states[i, k] - states[j, k], controls[i, k] - controls[j, k]
    bend = problem.dynamics.acceleration_bound(state, push, problem.time_step, k)
    erring = spread.acceleration_bound(problem)
    stretches = _Stretches(
        problem=problem,
        pair=number,
        interval=k,
        state=state,
        control=push,
        errors=spread.of_pairs(i, j, k),
        near=near,
        bend=bend,
        stray=bend + most * np.hypot(erring[i, k], erring[j, k]),
        max_sigma=most,
    )
    return stretches, broken


def _numbers(found: Approaches, n: int) -> Indices:
    """Index of each approach's pair, in the order of ``pairs``."""
    i, j = found.first, found.second
    return i * (2 * n - i - 1) // 2 + j - i - 1


def _sums(stretches: _Stretches, some: Bool[Array, "s"], count: int) -> tuple[Values, int]:
    """Bound of each of ``count`` pairs, by some of the stretches, and the number of terms."""
    # Panels are halved whose margins may contribute more to the sum than their share of ACCURACY.
    which = np.flatnonzero(some)
    begin, width, chance, excess = np.repeat([[0.0], [1.0], [0.0], [0.0]], len(which), axis=1)
    last = stretches.directions(which, width)
    first, new = np.roll(last, 1, axis=0), np.ones(len(which), dtype=bool)
    panels = _Panels(which, begin, width, first, last, chance, excess, new)
    alone = ~panels.joined(stretches)
    first[alone] = stretches.directions(which[alone], begin[alone])
    while True:
        kept, changed = ~panels.new, _neighbourhood(panels.new)
        kept[panels.new] = stretches.may_be_near(panels[panels.new])
        panels, changed = panels[kept], changed[kept]
        looked_at = np.flatnonzero(_neighbourhood(changed))
        again = changed[looked_at]
        chance, excess = _failure_probability(panels[looked_at], stretches)
        panels.chance[changed], panels.excess[changed] = chance[again], excess[again]
        split = panels.excess * len(panels) > ACCURACY * max(float(panels.chance.sum()), FAR)
        split &= (panels.width > SHORTEST) & (len(panels) < MOST_PANELS)
        if not split.any():
            pair = stretches.pair[panels.stretch]
            return np.bincount(pair, panels.chance, count).astype(float), len(panels)
        panels = panels.halved(split, stretches)


def _neighbourhood(of: Bool[Array, "q"]) -> Bool[Array, "q"]:
    """Mask of some panels and two on each side, as far as what ``_failure_probability`` reaches."""
    found = of.copy()
    for steps in (1, 2):
        found[steps:] |= of[:-steps]
        found[:-steps] |= of[steps:]
    return found


def _failure_probability(
    panels: _Panels, stretches: _Stretches
) -> tuple[Float[Array, "q"], Float[Array, "q"]]:
    """Probability of failing each panel's check, and the part that margins add."""
    from scipy.special import ndtr  # slow to import, and only a risk needs it

    at, radius = panels.stretch, stretches.problem.collision_radius
    width = panels.width * stretches.problem.time_step
    ends = panels.begin, panels.begin + panels.width
    here, there = (stretches.maps(at, share)[:, :3] for share in ends)
    start, end = stretches.mean(at, here), stretches.mean(at, there)

    errors = stretches.errors[at]

    def covariance(one: Functionals, other: Functionals) -> Values:
        return np.vecdot(np.vecmat(one, errors), other)

    turn = panels.last - panels.first
    swing = np.vecmat(turn, there - here)
    erring = stretches.max_sigma * np.sqrt(np.maximum(covariance(swing, swing), 0.0))
    turned = np.vecdot(turn, end - start)
    turning = np.maximum(np.abs(turned) if stretches.two_sided else turned, 0.0) + erring
    margin = stretches.stray[at] * width**2 / 8 + turning / 4
    joined = panels.joined(stretches)
    goes_on = np.append(joined[1:], False)[: len(joined)]
    # A check has the larger margin of the two panels beside it.
    margin_first = np.where(joined, np.maximum(margin, np.roll(margin, 1)), margin)
    margin_last = np.where(goes_on, np.maximum(margin, np.roll(margin, -1)), margin)
    first, last = np.vecmat(panels.first, here), np.vecmat(panels.last, there)
    step = last - first
    variances = [np.maximum(covariance(one, one), 0.0) for one in (first, last, step)]
    apart = np.vecdot(panels.first, start) - radius
    apart_last = np.vecdot(panels.last, end) - radius
    # Rounding lets the motion jump between two intervals; the check is half-way, with more margin.
    jump = np.where(joined, apart - np.roll(apart_last, 1), 0.0) / 2
    jump_last = -np.where(goes_on, np.roll(jump, -1), 0.0)
    apart, apart_last = apart - jump, apart_last - jump_last
    margin_first, margin_last = margin_first + np.abs(jump), margin_last + np.abs(jump_last)
    mean, mean_last = apart - margin_first, apart_last - margin_last
    mixed = covariance(first, step)
    chance = crossing_probability(mean, variances[0], mean_last - mean, mixed, variances[2])
    sigma, sigma_last = (np.maximum(np.sqrt(one), TINY) for one in variances[:2])
    begins = ndtr(-mean / sigma)
    if stretches.two_sided:
        beyond = -2 * (radius + margin_first) - mean, -2 * (radius + margin_last) - mean_last
        chance += crossing_probability(
            beyond[0], variances[0], beyond[1] - beyond[0], mixed, variances[2]
        )
        begins -= ndtr(beyond[0] / sigma)
    chance += np.where(joined, 0.0, begins)
    least = 1 / radius if stretches.two_sided else 0.0
    # As z falls, the normal tail at z grows, relatively, by about z times the change of z.
    share = [
        np.maximum(np.maximum(gap / s, 1.0) / s, least)
        for gap, s in ((apart, sigma), (apart_last, sigma_last))
    ]
    beside = np.where(joined, np.roll(chance, 1), 0.0) + np.where(goes_on, np.roll(chance, -1), 0.0)
    return chance, (chance + beside) * np.minimum(margin * np.maximum(*share), 1.0)


def crossing_probability(
    mean: Values, variance: Values, step: Values, mixed: Values, step_variance: Values
) -> Values:
    """P(X ≥ 0, X + D < 0) for jointly Gaussian X and D, by Owen's T function.

    Owen 1956, "Tables for computing bivariate normal probabilities". Means and variances are those
    of X and of the step D, since X + D may be nearly X itself; ``mixed`` is their covariance.
    """
    from scipy.special import ndtr, owens_t  # slow to import, and only a risk needs it

    after, variance_after = mean + step, np.maximum(variance + 2 * mixed + step_variance, 0.0)
    rest = step_variance - mixed**2 / np.maximum(variance, TINY)  # of D, given X
    rest = np.maximum(np.sqrt(np.maximum(rest, 0.0)), TINY)
    before, after = (np.where(one == 0, TINY, one) for one in (mean, after))
    sigma, sigma_after = (np.maximum(np.sqrt(v), TINY) for v in (variance, variance_after))
    with np.errstate(over="ignore"):
        slope = (step - mixed / sigma**2 * before) * sigma / (before * rest)
        back = (mixed + step_variance) / sigma_after**2 * after - step
        slope_after = back * sigma_after**2 / (sigma * after * rest)
    u, v = before / sigma, after / sigma_after
    chance = (ndtr(-v) - ndtr(-u)) / 2 + owens_t(u, slope) + owens_t(v, slope_after)
    return np.maximum(chance + np.where((u > 0) == (v > 0), 0.0, 0.5), 0.0)


def likeliest_direction(mean: Vectors, covariance: Float[Array, "k 3 3"], radius: float) -> Vectors:
    """Unit vectors to the likeliest points, on a sphere, of Gaussians with means outside it.

    The tangent plane at the likeliest point q of the sphere is the one that is the most standard
    deviations away (first-order reliability method). Lagrange's rule gives
    (1 + μ Σ) q = mean, with μ from ‖q‖ = radius by Newton's method on 1/‖q‖. Means and the radius
    in m, covariances in m².
    """
    spread, axes = np.linalg.eigh(covariance)
    spread = np.maximum(spread / np.maximum(spread[:, -1:], TINY), 0.0)
    along, multiplier = np.vecmat(mean, axes), np.zeros((len(mean), 1))
    for _ in range(NEWTON_STEPS):
        point = along / (1 + multiplier * spread)
        far = np.maximum(norm(point), APART)[:, None]
        slope = (point**2 * spread / (1 + multiplier * spread)).sum(axis=1, keepdims=True) / far**3
        step = (1 / radius - 1 / far) / np.where(slope > 0, slope, np.inf)
        multiplier = np.clip(multiplier + step, 0.0, 1 / TINY**0.1)
    point = along / (1 + multiplier * spread)
    return np.matvec(axes, point / np.maximum(norm(point), APART)[:, None])
