"""Decoupled optima by cone programs, for all thruster models and limits, and their bounds."""

from dataclasses import dataclass, replace

import numpy as np

from pipeline.arrays import Array, Bool, Float
from pipeline.expert.conic import IMPOSSIBLE, OPTIMAL, ConicProgram
from pipeline.expert.cuts import HalfSpaces
from pipeline.expert.subproblem import Subproblem
from pipeline.orbit.arrays import Controls, PerCraft, Rows, Values, norm
from pipeline.orbit.decoupled import SHORT
from pipeline.orbit.problem import LIMIT_ROUNDING, RANGES, Problem
from pipeline.orbit.thrust import COMPONENTS, Limits, Thrust
from pipeline.orbit.thrust_cost import (
    allocated_thrusts,
    conjugate_bound,
    cost,
    dual_norm,
    exceeded_limits,
    support_bound,
)
from pipeline.orbit.transfer import transfer_maps
from pipeline.scenario.state_constraints import MET, NO_EFFECT, StateConstraints

LIMIT_SHARE = 1 - 1e-7  # share of a limit that programs may use, so that rounding stays within
BURN = 1e-5  # share of a craft's largest control below which a cone program's control is rounding
NOISE = 1e-3  # least value of a craft's largest control there, as a share of all craft's largest
CANCELLED = 1e-7  # share of the largest dual variable, by effect, below which one counts as zero
CANCELLATIONS = 3  # of rows, at most
UPPER = "max_acceleration", "max_acceleration_norm", "delta_v"  # limits that are upper ones


@dataclass(frozen=True, eq=False)
class Duals(Rows):
    """Dual certificates of the programs of n craft, from dual variables y of their rows.

    Any y proves a bound that is free for goals and waypoints, reach u = miss, and at least 0 for
    half-spaces, reach u ≥ miss.
    """

    value: PerCraft  # y · miss, m/s²
    along: Float[Array, "n intervals 3"]  # y · reach
    # w, of the cones: the part of y · reach that the norm's limit bounds
    split: Float[Array, "n intervals 3"]
    rounding: PerCraft  # largest change of the value by rounding of the miss, m/s²


def decoupled_program(
    at: StateConstraints, limits: Limits, problem: Problem, inside: HalfSpaces | None = None
) -> ConicProgram:
    """The cone program of decoupled craft; it minimizes total fuel, whatever the objective.

    ``inside`` has half-spaces that the controls of a single craft must be in.
    """
    if inside is None:
        inside = HalfSpaces(np.zeros((0, at.reach.shape[1])), np.zeros(0))
    craft = np.zeros(len(inside), dtype=int)
    largest = np.abs(np.matvec(transfer_maps(problem).to_goal, at.miss[:, :6])).max()
    sub = Subproblem(
        *(at.reach, at.miss, craft, craft, inside.row, inside.required, np.inf, np.inf),
        other=inside.other,
        constrained=at.constrained,
        rounding=at.rounding,
        unit=float(largest if largest > problem.negligible_fuel else problem.evasive_control),
        thrust=replace(problem.thrust, objective="total"),
        limits=program_limits(limits, budget=False),
        time_step=problem.time_step,
    )
    return ConicProgram(sub)


def program_limits(limits: Limits, *, budget: bool = True) -> Limits:
    """Limits for programs, slightly smaller so that rounding stays within the given ones."""
    component, norm, delta_v = (
        LIMIT_SHARE * one for one in (limits.component, limits.norm, limits.delta_v)
    )
    delta_v = delta_v if budget else np.inf * delta_v
    return replace(limits, component=component, norm=norm, delta_v=delta_v)


def minimum_fuel_by_cones(
    at: StateConstraints, limits: Limits, problem: Problem, inside: HalfSpaces | None = None
) -> tuple[Controls | None, Duals]:
    """Minimum-fuel controls of all craft by one cone program, or None, and dual certificates.

    Within half-spaces as in ``decoupled_program``.
    """
    program = decoupled_program(at, limits, problem, inside)
    status, x, z = program.solution(*OPTIMAL, IMPOSSIBLE)
    dual = _duals(program, z, at, infeasible=status not in OPTIMAL)
    if status not in OPTIMAL:
        return None, dual
    return program.controls_of(x).reshape(len(at), -1, 3), dual


def _duals(program: ConicProgram, z: Values, at: StateConstraints, *, infeasible: bool) -> Duals:
    """The certificates that the dual variables z of a program give."""
    sub, y = program.sub, np.zeros(at.miss.shape)
    y[at.constrained] = -z[: at.constrained.sum()]
    y = y * sub.goal_scale * sub.unit
    if len(sub.required) == 0:
        along = (y @ at.reach).reshape(len(y), -1, 3)
        return Duals(np.vecdot(at.miss, y), along, program.splits(z), np.abs(y) @ at.rounding)
    limits = program.limits
    rows = np.concatenate([at.reach, sub.row]) * limits.burns[0].ravel()
    y = np.append(y[0], np.maximum(program.half_space_duals(z), 0.0))
    if infeasible and not np.isfinite([limits.component, limits.norm]).any():
        y = _without_effect(y, rows, len(at.reach))
    value, along = y @ np.append(at.miss[0], sub.required), (y @ rows).reshape(1, -1, 3)
    rounding = np.abs(y[: len(at.reach)]) @ at.rounding
    return Duals(np.array([value]), along, program.splits(z), np.array([rounding]))


def _without_effect(
    y: Float[Array, "r"], rows: Float[Array, "r m"], equalities: int
) -> Float[Array, "r"]:
    """Dual variables changed least so that rows cancel out; those next to zero are left out.

    Where thrust has no limit, only such prove that a program is infeasible.
    """
    size = norm(rows)
    scaled = y * size
    used = scaled > CANCELLED * np.abs(scaled).max()
    used[:equalities] = size[:equalities] > 0
    for _ in range(CANCELLATIONS):  # each without those that the last made negative
        unit, found = rows[used] / size[used, None], np.where(size == 0, y, 0.0)
        rest = np.linalg.pinv(unit.T) @ (unit.T @ scaled[used])
        found[used] = (scaled[used] - rest) / size[used]
        used[equalities:] &= found[equalities:] > 0
    found[equalities:] = np.maximum(found[equalities:], 0.0)
    return found


def dual_bounds(duals: Duals, limits: Limits, problem: Problem) -> PerCraft:
    """The lower bound on the fuel of each craft, m/s², that dual variables prove.

    By weak duality: for any y, a control u costs at least y · (reach u) less the conjugate of the
    cost; and at least y · (reach u) where y is scaled until its dual norm is at most 1.
    """
    along = duals.along
    # Less what rounding of the miss may add, which is much where controls have almost no effect
    value = np.where(duals.rounding > LIMIT_ROUNDING * np.abs(duals.value), -duals.rounding, 0.0)
    value += duals.value
    most = np.where(limits.burns.any(axis=2), dual_norm(along, problem.thrust), 0.0).max(axis=1)
    bound = value / np.maximum(1.0, most)
    with np.errstate(invalid="ignore"):
        bound = np.fmax(bound, value - conjugate_bound(along, duals.split, limits, problem.thrust))
    return np.fmax(bound, 0.0)


def proven_infeasible(duals: Duals, at: StateConstraints, limits: Limits, problem: Problem) -> bool:
    """Whether it is proven that no controls of one craft bring it where it must be.

    By the support function of the controls along y (Farkas' lemma), or along directions in which
    controls have almost no effect; where there is no limit, with the largest that a problem may
    have.
    """
    highest = RANGES["max_acceleration"][1]
    bounded = replace(limits, component=np.minimum(limits.component, highest))
    largest = np.abs(duals.value).max()  # infeasible programs end with any size of dual variables
    if 0 < largest < np.inf:
        along, split = duals.along / largest, duals.split / largest
        most = support_bound(along, split, bounded, problem.thrust)[0]
        if (duals.value[0] - duals.rounding[0]) / largest > most * (1 + LIMIT_ROUNDING):
            return True
    rows, columns = at.constrained[0], limits.burns[0].ravel()
    scale, miss, reach = at.scale[rows], at.miss[0, rows], at.reach[rows][:, columns]
    directions = np.linalg.svd(reach * scale[:, None])[0].T * scale
    changes, effects = np.abs(directions @ miss), np.abs(directions @ reach)
    effects[effects < NO_EFFECT * effects.max(initial=0.0)] = 0.0
    furthest = highest * effects.sum(axis=1) + np.abs(directions) @ at.rounding[rows]
    return bool((changes > furthest + SHORT * np.abs(miss * scale).max()).any())


def polished(
    controls: Controls, at: StateConstraints, limits: Limits, problem: Problem
) -> Controls:
    """Controls with rounding set to zero, corrected so that they meet the required states exactly.

    By the least change of the remaining burns; where that is not possible, of all allowed ones.
    """
    thrust, allowed = problem.thrust, limits.burns
    size = np.abs(controls)
    if thrust.model != COMPONENTS:
        size = np.broadcast_to(cost(controls, thrust)[..., None], controls.shape)
    # Rounding of craft that are solved together scales with the largest control.
    largest = np.maximum(size.max(axis=(1, 2), keepdims=True), NOISE * size.max())
    burns = allowed & (size > BURN * largest)
    kept = np.where(burns, controls, 0.0)
    if thrust.min_delta_v is not None and not isinstance(thrust.model, str):
        # Only thrusts that are nonzero change, so that no other thruster fires a little.
        fired = allocated_thrusts(kept, limits, problem)
        fired = np.where(fired > BURN * largest, fired, 0.0)
        kept = _completed(fired, fired > 0, at, thrust) @ thrust.directions
    kept = _completed(kept, burns, at)
    # Where the rest cannot compensate, as where all burns are small, or only beyond its limits,
    # nothing is set to zero.
    unable = _missed(kept, at) > MET
    moved = np.abs(kept - controls).sum(axis=(1, 2)) > LIMIT_ROUNDING / 2 * largest[:, 0, 0]
    exceeded = exceeded_limits(kept[moved], program_limits(limits[moved]), problem)
    unable[moved] |= np.any([exceeded[name] for name in UPPER], axis=0)
    kept = np.where(unable[:, None, None] & allowed, controls, kept)
    return _completed(kept, allowed, at)


def _missed(amounts: Controls, at: StateConstraints) -> Float[Array, "n"]:
    """Largest error of controls at the states required of each craft, m; velocities over e."""
    led = np.matvec(at.reach, amounts.reshape(len(amounts), -1))
    return np.abs(at.weight * (at.miss - led * at.constrained)).max(axis=1)


def _completed(
    amounts: Float[Array, "n intervals V"],
    free: Bool[Array, "n intervals V"],
    at: StateConstraints,
    thrust: Thrust | None = None,
) -> Float[Array, "n intervals V"]:
    """Least-squares correction of free controls, or thrusts, to meet the required states."""
    n, constrained, rows = len(amounts), at.constrained, len(at.reach)
    reach = at.weight[:, None] * at.reach
    if thrust is not None:
        assert thrust.directions is not None
        reach = (reach.reshape(rows, -1, 3) @ thrust.directions.T).reshape(rows, -1)
    left = at.weight * at.miss - np.matvec(reach, amounts.reshape(n, -1)) * constrained
    short = np.abs(left).max(axis=1) > MET
    if not short.any():
        return amounts
    columns = reach * free.reshape(n, 1, -1) * constrained[..., None]
    added = np.matvec(np.linalg.pinv(columns, rcond=1e-9), left) * free.reshape(n, -1)
    return np.where(short[:, None, None], amounts + added.reshape(amounts.shape), amounts)
