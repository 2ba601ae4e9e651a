"""Optima of single craft: minimum fuel by a table of facets, minimum thrust limit by an LP.

The least fuel for a change b of the final state, min ‖u‖₁ subject to R u = b, is the gauge of the
convex hull of R's columns and their negatives. The facet that the ray to b meets has the optimal
basis at its corners: which thrusters burn, when and in which direction. The weights that combine
them to b are the burns; and its normal y, with yᵀp = 1 at the corners and so |Rᵀy| ≤ 1, is the dual
solution. R is the same for all craft of a problem: Qhull finds its facets once. Decoupled motions,
such as in-plane and cross-track, have hulls of their own, of few dimensions.
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np

from pipeline.arrays import Array, Bool, Float, Int
from pipeline.errors import ProlearnError
from pipeline.orbit.arrays import Formation
from pipeline.orbit.hulls import corners
from pipeline.orbit.problem import Problem, once_per_motion
from pipeline.orbit.transfer import transfer_maps

NEGLIGIBLE = 1e-12  # share of R's largest entry that counts as 0; velocities times the duration
FLAT = 1e10  # condition number from which a facet is degenerate; its neighbours cover its place
ROUNDING = 1e-8  # share of the fuel by which a weight may be negative, or a primal exceed its dual
# Points of a hull of more than four dimensions, such as about an oblate Earth, where all motion is
# coupled: facets grow with their cube. These many have 70,000, found in 0.7 s
MOST_POINTS = 240
AT_ONCE = 250_000  # products with normals of facets at once, which bounds memory
DEPENDENT = 1e-15  # share of the largest singular value of R up to which one counts as 0
SHORT = 1e-6  # share of a change of state that a transfer may miss it by, for rounding
MISSED = np.repeat([1e-6, 1e-9], 3)  # error at the goal that is allowed in any case, m and m/s


@dataclass(frozen=True, eq=False)
class Facets:
    """The hull of some decoupled components of the final state, F facets in d dimensions."""

    component: Int[Array, "d"]  # components of the state
    column: Int[Array, "F d"]  # control, flattened by time, at each corner of each facet
    sign: Float[Array, "F d"]  # sign of the control there
    weights: Float[Array, "F d d"]  # from a change of the components to the corners' weights
    dual: Float[Array, "F d"]  # y of each facet, scaled so that |Rᵀy| ≤ 1 holds beyond rounding


@dataclass(frozen=True, eq=False)
class MinimumFuelTransfers:
    """Minimum-fuel transfers of N craft, each on its own and without a thrust limit."""

    controls: Float[Array, "N intervals 3"]  # m/s²
    bound: Float[Array, "N"]  # proven lower bound on the fuel of each craft, by the dual y, m/s²
    basis: Int[Array, "N 6"]  # controls of the basis, flattened by time; + 3(T-1) if negative
    exact: Bool[Array, "N"]  # whether the controls attain the bound within rounding
    tabled: bool  # whether they are from the table


def minimum_fuel_by_table(
    miss: Float[Array, "N 6"], problem: Problem
) -> MinimumFuelTransfers | None:
    """Minimum-fuel controls for changes of state, m and m/s, without thrust limit, or None.

    None where ``facets_of`` is None.
    """
    table = facets_of(problem)
    if table is None:
        return None
    flat = np.zeros((len(miss), 3 * problem.intervals))
    bound, basis = np.zeros(len(miss)), np.zeros(miss.shape, dtype=int)
    craft = np.arange(len(miss))[:, None]
    for facets in table:
        # By ``take``, contiguous for any N, as products of BLAS may round others differently.
        change = miss.take(facets.component, axis=1)
        some = max(AT_ONCE // len(facets.dual), 1)
        begins = range(0, max(len(change), 1), some)
        found = [_on_facets(facets, change[begin : begin + some]) for begin in begins]
        met, weight, least = map(np.concatenate, zip(*found, strict=True))
        column, sign = facets.column.take(met, 0), facets.sign.take(met, 0)
        flat[craft, column] = weight * sign
        basis[:, facets.component] = column + (sign < 0) * flat.shape[1]
        bound += least
    return _transfers(flat, bound, basis, tabled=True)


def _on_facets(
    facets: Facets, change: Float[Array, "N d"]
) -> tuple[Int[Array, "N"], Float[Array, "N d"], Float[Array, "N"]]:
    """The facet that each change of state's ray meets, weights of its corners, and minimum fuel."""
    value = np.matvec(facets.dual, change)
    met = value.argmax(axis=1)
    weight = np.matvec(facets.weights.take(met, 0), change)
    outside = weight.min(axis=1) < -ROUNDING * np.abs(weight).sum(axis=1)
    for k in outside.nonzero()[0].tolist():
        # Of several coplanar facets the ray meets the one whose weights are not negative.
        near = np.flatnonzero(value[k] >= value[k].max() - ROUNDING * np.abs(value[k].max()))
        weights = np.matvec(facets.weights[near], change[k])
        best = weights.min(axis=1).argmax()
        met[k], weight[k] = near[best], weights[best]
    return met, weight, value[np.arange(len(met)), met]


def transfers_of_bases(
    basis: Int[Array, "N 6"], miss: Float[Array, "N 6"], problem: Problem
) -> MinimumFuelTransfers:
    """The transfers of optimal bases, given as in ``MinimumFuelTransfers``."""
    scale, reach = acceleration_scale(problem), transfer_maps(problem).reach[-1]
    columns, m = reach * scale[:, None], reach.shape[1]
    sign = np.where(basis < m, 1.0, -1.0)
    basic = (columns.T[basis % m] * sign[..., None]).mT
    weight = np.linalg.solve(basic, (miss * scale)[..., None])[..., 0]
    dual = np.linalg.solve(basic.mT, np.ones((6, 1)))[..., 0]
    dual /= np.maximum(np.abs(dual @ columns).max(axis=1, keepdims=True), 1.0)
    flat = np.zeros((len(miss), m))
    np.put_along_axis(flat, basis % m, weight * sign, axis=1)
    return _transfers(flat, np.vecdot(dual, miss * scale), basis, tabled=False)


def _transfers(
    flat: Float[Array, "N m"], bound: Float[Array, "N"], basis: Int[Array, "N 6"], *, tabled: bool
) -> MinimumFuelTransfers:
    bound = np.maximum(bound, 0.0)
    exact = np.abs(flat).sum(axis=1) <= bound * (1 + ROUNDING) + 1e-15
    return MinimumFuelTransfers(flat.reshape(len(flat), -1, 3), bound, basis, exact, tabled)


def independent_columns(problem: Problem) -> Int[Array, "6"] | None:
    """Six controls whose effects on the final state are independent, or None where there are none.

    Each is the one with most effect beside those before.
    """
    left = transfer_maps(problem).reach[-1] * acceleration_scale(problem)[:, None]
    found, least = [], NEGLIGIBLE * np.abs(left).max()
    for _ in range(6):
        size = np.linalg.norm(left, axis=0)
        best = int(size.argmax())
        if size[best] <= least:
            return None
        along = left[:, best] / size[best]
        left = left - along[:, None] * (along @ left)
        found.append(best)
    return np.array(found)


@once_per_motion
def facets_of(problem: Problem) -> tuple[Facets, ...] | None:
    """Facets of the convex hulls, cached by motion; None if one is too large or degenerate."""
    scale = acceleration_scale(problem)
    reach = transfer_maps(problem).reach[-1] * scale[:, None]
    acts = np.abs(reach) > NEGLIGIBLE * np.abs(reach).max()
    linked = np.linalg.matrix_power(acts @ acts.T | np.eye(6, dtype=bool), 6)
    parts = [np.flatnonzero(part) for part in np.unique(linked, axis=0)[::-1]]
    used = [np.flatnonzero(acts[part].any(axis=0)) for part in parts]
    columns = [reach[np.ix_(*both)].T for both in zip(parts, used, strict=True)]
    points = [np.concatenate([one, -one]) for one in columns]
    if any(one.shape[1] > 4 and len(one) > MOST_POINTS for one in points):
        return None
    try:
        found = zip(parts, used, points, corners(points), strict=True)
        return tuple(_facets(*one, scale[one[0]]) for one in found)
    except (RuntimeError, ValueError):  # degenerate hull
        return None


def acceleration_scale(problem: Problem) -> Float[Array, "6"]:
    """Factors that turn changes of a state into accelerations of the same order, m/s²."""
    return np.repeat([1.0, problem.duration], 3) / problem.duration**2


def _facets(
    component: Int[Array, "d"],
    used: Int[Array, "c"],
    points: Float[Array, "2*c d"],
    corner: Int[Array, "F d"],
    scale: Float[Array, "d"],
) -> Facets:
    """The hull of some components; points are the effects of the used controls, of either sign."""
    corner = corner[np.linalg.cond(points[corner]) < FLAT]
    if len(corner) == 0:
        raise ValueError("all facets are degenerate")
    inverse = np.linalg.inv(points[corner])  # rows of points[corner] are the corners
    dual = inverse.sum(axis=2)  # solves corners · y = 1
    block = max(1, AT_ONCE // len(used))
    for k in range(0, len(dual), block):
        reached = dual[k : k + block] @ points[: len(used)].T  # of the other sign it is as much
        most = np.abs(reached, out=reached).max(axis=1, keepdims=True)
        dual[k : k + block] /= np.maximum(most, 1.0)
    weights = inverse.transpose(0, 2, 1) * scale
    sign = np.where(corner < len(used), 1.0, -1.0)
    return Facets(component, used[corner % len(used)], sign, weights, dual * scale)


def minimum_limits(initial: Formation, goal: Formation, problem: Problem) -> Float[Array, "n"]:
    """Least limit on components, or thrusters, with which each craft reaches its goal, m/s².

    Infinite where no thrust suffices. The problem's own limit is ignored. A thruster that is
    pointed is taken to have limits on its components.
    """
    maps = transfer_maps(problem)
    miss = goal - np.matvec(maps.drift[-1], initial)
    burns = np.ones((len(miss), problem.intervals), dtype=bool)
    return minimum_limits_at_nodes(miss, maps.reach[-1:], burns, problem)


def minimum_limits_at_nodes(
    miss: Float[Array, "n r"],
    reach: Float[Array, "#n r m"],
    burns: Bool[Array, "n intervals"],
    problem: Problem,
) -> Float[Array, "n"]:
    """Least limits, as ``minimum_limits``, for changes of states at some nodes, m and m/s.

    Changes are six for each node; reach is the effect of flattened controls on them, and craft burn
    only in the intervals given. A linear program for each craft: maximize s subject to R w = s b,
    with every component of w within ±1, or every thrust from 0 to 1. The least limit is 1/s. All
    are solved in one call, scaled by the controls of least energy.
    """
    # Slow to import, and only a check of a scenario needs them.
    from scipy.optimize import linprog
    from scipy.sparse import block_diag, csr_array, hstack

    rows = miss.shape[1]
    scale = np.tile(acceleration_scale(problem), rows // 6)
    reach = reach * scale[:, None] * burns.repeat(3, axis=1)[:, None]
    miss = miss * scale
    basis, along = _orthonormal_rows(reach, miss)
    controls = np.vecmat(along, basis)
    left, enough = np.abs(miss - np.matvec(reach, controls)), np.abs(controls).max(axis=1)
    least = np.tile(MISSED, rows // 6) * scale
    short = np.maximum(SHORT * np.abs(miss).max(axis=1, keepdims=True), least)
    missed = (left > short).any(axis=1)
    limits = np.where(missed, np.inf, 0.0)
    moving = np.flatnonzero((enough > 0) & ~missed)  # the others arrive without thrust
    if len(moving) == 0:
        return limits
    low, thrust = -1.0, problem.thrust
    (n, rank, _), wanted = basis.shape, (along[moving] / enough[moving, None])[..., None]
    if not isinstance(thrust.model, str):
        low = 0.0
        basis = (basis.reshape(n, rank, -1, 3) @ np.array(thrust.model).T).reshape(n, rank, -1)
    n, m = len(moving), basis.shape[2]
    blocks = (block_diag([csr_array(one) for one in parts]) for parts in (basis[moving], -wanted))
    balance: Any = hstack(list(blocks), format="csr")
    found = linprog(
        np.repeat([0.0, -1.0], [n * m, n]),
        A_eq=balance,
        b_eq=np.zeros(rank * n),
        bounds=[(low, 1.0)] * (n * m) + [(0.0, np.inf)] * n,
        method="highs",
    )
    if found.x is None:
        raise ProlearnError(f"the least thrust limit was not found: {found.message}")
    with np.errstate(divide="ignore"):
        limits[moving] = enough[moving] / found.x[n * m :]
    return limits


def _orthonormal_rows(
    reach: Float[Array, "n r m"], miss: Float[Array, "n r"]
) -> tuple[Float[Array, "n k m"], Float[Array, "n k"]]:
    """Orthonormal basis V of the row space of R, and b of the least-squares solutions V u = b.

    Over whole periods rows of R nearly depend on each other, by less than a solver's tolerance.
    """
    left, size, basis = np.linalg.svd(reach, full_matrices=False)
    used = size > DEPENDENT * size[:, :1]
    along = np.divide(np.vecmat(miss, left), size, out=np.zeros_like(size), where=used)
    return basis * used[..., None], along


def craft_fuel_bound(
    miss: Float[Array, "r"],
    reach: Float[Array, "r m"],
    burns: Bool[Array, "intervals"],
    most: float,
    problem: Problem,
) -> float:
    """Lower bound on one craft's fuel, m/s², for given changes of its states at some nodes.

    By a linear program of thrusters; a pointed one is relaxed to fixed directions whose hull
    contains its unit ball. Infinite where no controls meet the goal. Changes and reach are as in
    ``minimum_limits_at_nodes``; the most is the limit on each component or thruster, m/s².
    """
    from scipy.optimize import linprog  # slow to import, and only a check of a scenario needs it

    thrust, scale = problem.thrust, np.tile(acceleration_scale(problem), len(miss) // 6)
    directions = _outer_directions() if thrust.directions is None else thrust.directions
    allowed = reach * scale[:, None] * burns.repeat(3)
    (basis,), (wanted,) = _orthonormal_rows(allowed[None], (miss * scale)[None])
    columns = basis.reshape(len(basis), -1, 3)[:, burns] @ directions.T
    columns = columns.reshape(len(basis), -1)
    unit = float(np.abs(wanted).max())
    if unit == 0:
        return 0.0
    pointed_or_free = thrust.directions is None or np.isinf(most)
    found = linprog(
        np.ones(columns.shape[1]),
        A_eq=columns,
        b_eq=wanted / unit,
        bounds=(0, None if pointed_or_free else most / unit),
        method="highs",
    )
    if found.status == 2:  # infeasible
        return np.inf
    if found.x is None:
        raise ProlearnError(f"the least fuel was not found: {found.message}")
    # The dual variables prove a bound whatever the solver's error.
    y = found.eqlin.marginals
    beyond = np.maximum(y @ columns - 1, 0.0)
    bound = y @ wanted / unit / (1 + beyond.max())
    if not pointed_or_free:
        bound = max(bound, y @ wanted / unit - most / unit * beyond.sum())
    return float(unit * bound)


@lru_cache(maxsize=1)
def _outer_directions() -> Float[Array, "26 3"]:
    """Vectors in all directions, whose hull contains the unit ball."""
    from scipy.spatial import ConvexHull  # slow to import, and only some thrust needs it

    ways = np.array([way for way in product((-1.0, 0.0, 1.0), repeat=3) if any(way)])
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    return np.asarray(ways / -ConvexHull(ways).equations[:, 3].max())
