"""Cost of controls by thruster model, its conjugates within limits, and violations of limits."""

from functools import lru_cache
from itertools import combinations
from typing import Any

import numpy as np

from pipeline.arrays import Array, Bool, Float
from pipeline.errors import ProlearnError
from pipeline.orbit.arrays import Controls, CraftMask, PerCraft, Scalar, Vector
from pipeline.orbit.problem import LIMIT_ROUNDING, Problem
from pipeline.orbit.thrust import COMPONENTS, NORM, Direction, Limits, Thrust

WITHIN = 1 + 1e-12  # further factor by which prices are shrunk to norm 1, against rounding
TIGHT = 1e-10  # tolerance of the program for thrusts, as a share of the largest control
MOST_FIRING = 4  # thrusters in the sets that are tried; three give a control, four share it
EXCESS = 1e3  # cost of thrust beyond a limit, so high that it is avoided where possible


@lru_cache(maxsize=32)
def _gauge(directions: tuple[Direction, ...]) -> Float[Array, "F 3"]:
    """Normals of the hull's facets, scaled so that the gauge of u is the largest of normal · u."""
    from scipy.spatial import ConvexHull  # slow to import, and few thrusters need it

    planes = ConvexHull(np.array(directions)).equations
    return np.asarray(planes[:, :3] / -planes[:, 3:])


def cost(controls: Vector, thrust: Thrust) -> Scalar:
    """Cost of each control, m/s²: the least sum of thrusts, without limits, that produce it."""
    if thrust.model == COMPONENTS:
        return np.asarray(np.abs(controls).sum(axis=-1))
    if thrust.model == NORM:
        return np.asarray(np.linalg.norm(controls, axis=-1))
    assert not isinstance(thrust.model, str)
    return np.asarray((controls @ _gauge(thrust.model).T).max(axis=-1))


def dearest(directions: tuple[Direction, ...]) -> float:
    """Largest cost of a control of norm 1, by thrusters of given directions."""
    return float(_length(_gauge(directions)).max())


def dual_norm(along: Vector, thrust: Thrust) -> Scalar:
    """Dual norm of the cost: the largest v · u of controls u of cost 1, for vectors v."""
    if thrust.directions is None:
        return np.asarray(np.linalg.norm(along, axis=-1))
    return np.asarray(np.maximum((along @ thrust.directions.T).max(axis=-1), 0.0))


def conjugate_bound(along: Controls, split: Controls, limits: Limits, thrust: Thrust) -> PerCraft:
    """Upper bound on the conjugate of each craft's cost: the largest Σ v · u - cost(u) in limits.

    Infinite without a limit. For any split w, v - w is bounded by the limit on components or
    thrusters and w by that on the norm; the best of several splits is taken.
    """
    rest = along - split
    if thrust.directions is None:
        parts = [one / np.maximum(1.0, WITHIN * _length(one)) for one in (split, along)]
    else:
        over = (
            np.maximum(1.0, WITHIN * dual_norm(one, thrust)[..., None]) for one in (rest, along)
        )
        parts = [along - one / by for one, by in zip((rest, along), over, strict=True)]
    return _conjugate_over_splits(along, [split, along, 0 * along, *parts], limits, thrust, 1.0)


def support_bound(along: Controls, split: Controls, limits: Limits, thrust: Thrust) -> PerCraft:
    """Upper bound on the support function of each craft's controls: the largest Σ v · u in limits.

    The split is as in ``conjugate_bound``.
    """
    return _conjugate_over_splits(along, [split, along, 0 * along], limits, thrust, 0.0)


def _conjugate_over_splits(
    along: Controls, splits: list[Controls], limits: Limits, thrust: Thrust, price: float
) -> PerCraft:
    """Upper bound on v · u - price · cost(u) over the controls of each craft, by the best split."""
    component, norm = limits.component[:, None], limits.norm[:, None]
    least = np.full(along.shape[:2], np.inf)
    for split in splits:
        rest, over = along - split, _length(split)[..., 0]
        if thrust.directions is None:
            each, over = np.abs(rest).sum(axis=-1), np.maximum(over - price, 0.0)
        else:
            each = np.maximum(rest @ thrust.directions.T - price, 0.0).sum(axis=-1)
        least = np.fmin(least, _times(component, each) + _times(norm, over))
    return np.asarray(np.where(limits.burns.any(axis=2), least, 0.0).sum(axis=1))


def _length(vectors: Vector) -> Float[Array, "*batch 1"]:
    return np.asarray(np.linalg.norm(vectors, axis=-1, keepdims=True))


def _times(limit: Array, amount: Array) -> Array:
    """The product, 0 where the amount is 0, even for an infinite limit."""
    return np.where(amount > 0, limit * np.where(amount > 0, amount, 1.0), 0.0)


def thrusts(controls: Controls, limits: Limits, thrust: Thrust) -> Float[Array, "n intervals K"]:
    """Thrust of each thruster, m/s², of least sum, that produces the controls within limits.

    Where that is impossible, some exceed limits. One linear program for all burns.
    """
    # Slow to import, and only some thrusters need them.
    from scipy.optimize import linprog
    from scipy.sparse import csr_array, eye_array, hstack, kron

    directions = thrust.directions
    assert directions is not None
    craft, interval = np.nonzero(np.abs(controls).max(axis=2) > 0)
    found = np.zeros((*controls.shape[:2], len(directions)))
    if len(craft) == 0:
        return found
    burns, K = controls[craft, interval], len(directions)
    scale = float(np.abs(burns).max())
    m, most = len(craft), limits.component[craft] / scale
    given = kron(eye_array(m), csr_array(directions.T))
    balance: Any = hstack([given, csr_array((3 * m, m))], format="csr")
    each = kron(eye_array(m), csr_array(np.ones((K, 1))))
    within: Any = hstack([eye_array(m * K), -each], format="csr")[np.isfinite(most).repeat(K)]
    solved = linprog(
        np.repeat([1.0, EXCESS], [m * K, m]),
        A_eq=balance,
        b_eq=burns.ravel() / scale,
        A_ub=within,
        b_ub=most[np.isfinite(most)].repeat(K),
        method="highs",
        options={"primal_feasibility_tolerance": TIGHT, "dual_feasibility_tolerance": TIGHT},
    )
    if solved.x is None:
        raise ProlearnError(f"the thrusts of a plan were not found: {solved.message}")
    found[craft, interval] = scale * solved.x[: m * K].reshape(m, K)
    return found


def allocated_thrusts(
    controls: Controls, limits: Limits, problem: Problem
) -> Float[Array, "n intervals K"]:
    """As ``thrusts``, with each zero or at least the impulse bit where such thrusts are found.

    Redundant thrusters give a control in several ways of the same sum. Sets of up to MOST_FIRING
    of them are tried, small ones first.
    """
    found, bit = thrusts(controls, limits, problem.thrust), problem.thrust.min_delta_v
    if bit is None:
        return found
    least, directions = bit / problem.time_step, problem.thrust.directions
    assert directions is not None
    small = (found < least) & (found > LIMIT_ROUNDING * found.max(axis=2, keepdims=True))
    for at in zip(*np.nonzero(small.any(axis=2)), strict=True):
        limit = float(limits.component[at[0]])
        found[at] = _of_larger_burns(found[at], directions, least, limit)
    return found


def _of_larger_burns(
    given: Float[Array, "K"], directions: Float[Array, "K 3"], least: float, limit: float
) -> Float[Array, "K"]:
    """Thrusts of the same effect and sum that are zero or at least ``least``, else those given."""
    from scipy.optimize import linprog  # slow to import, and only some thrusters need it

    control, unit = given @ directions, float(given.sum())
    cheapest = linprog(
        np.ones(len(given)), A_eq=directions.T, b_eq=control / unit, bounds=(0, limit / unit)
    )
    if cheapest.x is None:
        return given
    # By complementary slackness: in all thrusts of the least sum those of negative reduced cost are
    # at their limit, and others of positive one do not fire.
    reduced = 1 - directions @ cheapest.eqlin.marginals
    at_limit = np.where(reduced < -LIMIT_ROUNDING, given, 0.0)
    rest, may_fire = control - at_limit @ directions, (abs(reduced) <= LIMIT_ROUNDING).nonzero()[0]
    for size in range(1, min(MOST_FIRING, len(may_fire)) + 1):
        sets = np.array(list(combinations(may_fire, size)))
        thrust, fits = _between(directions[sets].mT, rest, least, limit)
        if fits.any():
            first, found = int(fits.argmax()), at_limit.copy()
            found[sets[first]] = thrust[first]
            return found
    return given


def _between(
    effect: Float[Array, "sets 3 V"], control: Float[Array, "3"], least: float, limit: float
) -> tuple[Float[Array, "sets V"], Bool[Array, "sets"]]:
    """For each set of V thrusters, thrusts that give a control, and whether all are in a range.

    Four can share it in many ways, f + t v: the middle of those in the range is taken.
    """
    thrust, v = np.linalg.pinv(effect) @ control, np.zeros(effect.shape[::2])
    if effect.shape[2] == 4:
        v = np.linalg.svd(effect)[2][:, 3]
    low, high = least * (1 - LIMIT_ROUNDING), limit * (1 + LIMIT_ROUNDING)
    with np.errstate(divide="ignore", invalid="ignore"):
        begin, end = np.sort([(low - thrust) / v, (high - thrust) / v], axis=0)
        middle = (begin.max(axis=1) + end.min(axis=1)) / 2
    thrust += np.where(np.isfinite(middle), middle, 0.0)[:, None] * v
    missed = np.abs(np.matvec(effect, thrust) - control).max(axis=1)
    inside = ((low <= thrust) & (thrust <= high)).all(axis=1)
    return thrust, inside & (missed <= TIGHT * np.abs(control).max())


def cost_within(
    controls: Float[Array, "*batch n intervals 3"], thrust: Thrust, limits: Limits | None
) -> Float[Array, "*batch n intervals"]:
    """Cost of each control, m/s², within the limits of its thrusters."""
    least = cost(controls, thrust)
    if limits is None or isinstance(thrust.model, str) or not np.isfinite(limits.component).any():
        return least
    # One by one, since what the program rounds depends on all burns in it. Limits never lower the
    # cost, but its tolerance might.
    swarms = controls.reshape(-1, *controls.shape[-3:])
    fired = [thrusts(one, limits, thrust).sum(axis=2) for one in swarms]
    return np.asarray(np.maximum(least, np.reshape(fired, least.shape)))


def craft_fuel(controls: Controls, thrust: Thrust, limits: Limits | None = None) -> PerCraft:
    """Fuel of each craft, m/s², within the limits of its thrusters."""
    return np.asarray(cost_within(controls, thrust, limits).sum(axis=1))


def exceeded_limits(controls: Controls, limits: Limits, problem: Problem) -> dict[str, CraftMask]:
    """Mask of the craft that exceed each of their limits, by the limit's name."""
    thrust, time_step = problem.thrust, problem.time_step
    norm, used = np.linalg.norm(controls, axis=2), np.abs(controls).max(axis=(1, 2))
    if not isinstance(thrust.model, str) and np.isfinite(limits.component).any():
        used = thrusts(controls, limits, thrust).max(axis=(1, 2))
    burned = time_step * craft_fuel(controls, thrust, limits)
    return {
        "max_acceleration": ~(used <= limits.component * (1 + LIMIT_ROUNDING)),
        "max_acceleration_norm": ~(norm.max(axis=1) <= limits.norm * (1 + LIMIT_ROUNDING)),
        "delta_v": ~(burned <= limits.delta_v * (1 + LIMIT_ROUNDING)),
        "no_burn": ((controls != 0) & ~limits.burns).any(axis=(1, 2)),
        "min_delta_v": too_small(controls, limits, problem).any(axis=(1, 2)),
    }


def burn_sizes(controls: Controls, limits: Limits, problem: Problem) -> Controls:
    """Size of the smallest burn that each component of a control is part of, m/s².

    A burn is a component, the whole control where a thruster is pointed, or a thruster's thrust.
    """
    if problem.thrust.model == COMPONENTS:
        return np.abs(controls)
    if problem.thrust.model == NORM:
        return np.broadcast_to(_length(controls), controls.shape)
    fired = allocated_thrusts(controls, limits, problem)
    fires = fired > LIMIT_ROUNDING * fired.max(axis=-1, keepdims=True)  # smaller ones are rounding
    size = np.where(fires, fired, np.inf).min(axis=-1, keepdims=True)
    # A control too small for the program of thrusts is a burn, too.
    return np.broadcast_to(np.where(np.isfinite(size), size, _length(controls)), controls.shape)


def too_small(controls: Controls, limits: Limits, problem: Problem) -> Bool[Array, "n intervals 3"]:
    """Mask of components that are part of a burn below the minimum impulse bit."""
    if (least := problem.thrust.min_delta_v) is None:
        return np.zeros(controls.shape, dtype=bool)
    size = burn_sizes(controls, limits, problem)
    return (size > 0) & (problem.time_step * size < least * (1 - LIMIT_ROUNDING))
