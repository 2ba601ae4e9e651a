"""Decoupled optima where thrust is more than axes with one limit, and the bounds they prove."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.arrays import Array
from pipeline.expert.conic import TOLERANCE, ConicProgram
from pipeline.expert.solvers import OPTIMAL
from pipeline.expert.subproblem import Subproblem
from pipeline.orbit.arrays import Controls, Formation, Rows
from pipeline.orbit.decoupled import SHORT, acceleration_scale
from pipeline.orbit.problem import RANGES, Problem
from pipeline.orbit.thrust import COMPONENTS, Limits, Thrust
from pipeline.orbit.thrust_cost import cost, polar, support, thrusts, worth
from pipeline.orbit.transfer import state_weight, transfer_maps

LIMIT_SHARE = 1 - 1e-7  # share of a limit that programs use, rounding staying within it
FARKAS_MARGIN = 1e-6  # relative margin by which a proof of impossibility must hold, beyond rounding
BURN = 1e-5  # share of a craft's largest control under which one is rounding, of a cone program
MET = 1e-9  # change of a final state that counts as none, m; velocities over e


@dataclass(frozen=True, eq=False)
class Duals(Rows):
    """Dual variables of the programs of n craft; whatever they are, they prove a bound."""

    goal: Float[Array, "n 6"]  # y, of the goals
    split: Float[Array, "n intervals 3"]  # w, of the cones: what of y reach counts against norms


def decoupled_program(miss: Formation, limits: Limits, problem: Problem) -> ConicProgram:
    """The cone program of craft that do not see each other; their fuel is least, whatever else."""
    none: Int[Array, 0] = np.zeros(0, dtype=int)
    reach = transfer_maps(problem).reach[-1]
    largest = np.abs(np.matvec(transfer_maps(problem).to_goal, miss)).max()
    sub = Subproblem(
        *(reach, miss, none, none, np.zeros((0, reach.shape[1])), np.zeros(0), np.inf, 0.0),
        unit=float(max(largest, problem.evasive_control)),
        thrust=replace(problem.thrust, objective="total"),
        limits=of_program(limits, budget=False),
        time_step=problem.time_step,
    )
    return ConicProgram(sub)


def of_program(limits: Limits, *, budget: bool = True) -> Limits:
    """The limits that programs are given, so that rounding stays within them."""
    component, norm, delta_v = (
        LIMIT_SHARE * one for one in (limits.component, limits.norm, limits.delta_v)
    )
    return Limits(component, norm, delta_v if budget else np.inf * delta_v, limits.burns)


def least_of(miss: Formation, limits: Limits, problem: Problem) -> tuple[Controls | None, Duals]:
    """Controls of least fuel of all craft in one program, or None, and dual variables."""
    program = decoupled_program(miss, limits, problem)
    for careful in (False, True):
        found = program.solver(TOLERANCE, careful=careful).solve()
        if str(found.status) in OPTIMAL:
            break
    sub = program.sub
    z = np.asarray(found.z)
    y = -z[: 6 * len(miss)].reshape(-1, 6) * sub.goal_scale * sub.unit
    dual = Duals(y, program.splits(z))
    if str(found.status) not in OPTIMAL:
        return None, dual
    return program.controls_of(program.solved(np.asarray(found.x))).reshape(len(miss), -1, 3), dual


def dual_bounds(
    duals: Duals, miss: Formation, limits: Limits, problem: Problem
) -> Float[Array, "n"]:
    """The lower bound on the fuel of each craft, m/s², that any dual variables prove.

    By weak duality: for any y, a control u costs at least y · (reach u), less the worth of y's
    prices; and also where y is shrunk until nothing is worth more than it costs.
    """
    y = duals.goal
    along, value = _along(y, problem), np.vecdot(miss, y)
    most = np.where(limits.burns.any(axis=2), polar(along, problem.thrust), 0.0).max(axis=1)
    bound = value / np.maximum(1.0, most)
    with np.errstate(invalid="ignore"):
        bound = np.fmax(bound, value - worth(along, duals.split, limits, problem.thrust))
    return np.fmax(bound, 0.0)


def impossible(duals: Duals, miss: Float[Array, "6"], limits: Limits, problem: Problem) -> bool:
    """Whether it is proven that the controls of one craft bring about no such change of state.

    They do at most their support along y (Farkas' lemma), and, for the largest limit that a problem
    may have, along the directions in which controls as good as do nothing.
    """
    y = duals.goal
    if np.isfinite(y).all():
        most = support(_along(y, problem), duals.split, limits, problem.thrust)[0]
        if miss @ y[0] > most * (1 + FARKAS_MARGIN):
            return True
    columns = limits.burns[0].ravel()
    scale = acceleration_scale(problem)
    reach = transfer_maps(problem).reach[-1][:, columns]
    directions = np.linalg.svd(reach * scale[:, None])[0].T * scale
    changes = np.abs(directions @ miss)
    furthest = RANGES["max_acceleration"][1] * np.abs(directions @ reach).sum(axis=1)
    return bool((changes > furthest + SHORT * np.abs(miss * scale).max()).any())


def _along(y: Float[Array, "n 6"], problem: Problem) -> Float[Array, "n intervals 3"]:
    """What each control does along y, per m/s²."""
    return (y @ transfer_maps(problem).reach[-1]).reshape(len(y), -1, 3)


def settled(controls: Controls, miss: Formation, limits: Limits, problem: Problem) -> Controls:
    """The controls without what is rounding in them, which bring about a change exactly.

    By the least change of the burns that are left; where those cannot, of all that may be. ``miss``
    is what controls must bring about, m and m/s.
    """
    thrust, allowed = problem.thrust, limits.burns
    size = np.abs(controls)
    if thrust.model != COMPONENTS:
        size = np.broadcast_to(cost(controls, thrust)[..., None], controls.shape)
    largest = np.maximum(size.max(axis=(1, 2), keepdims=True), problem.evasive_control)
    burns = allowed & (size > BURN * largest)
    kept = np.where(burns, controls, 0.0)
    if thrust.min_delta_v is not None and not isinstance(thrust.model, str):
        # A change of the thrusts that are, so that no other thruster fires a little.
        fired = thrusts(kept, limits, thrust)
        fired = np.where(fired > BURN * largest, fired, 0.0)
        kept = _completed(fired, fired > 0, miss, problem, thrust) @ thrust.directions
    for free in (burns, allowed):
        kept = _completed(kept, free, miss, problem)
    return kept


def _completed(
    amounts: Float[Array, "n intervals V"],
    free: Bool[Array, "n intervals V"],
    miss: Formation,
    problem: Problem,
    thrust: Thrust | None = None,
) -> Float[Array, "n intervals V"]:
    """Controls with the least change of those that are free after which nothing is missed.

    Or thrusts, where the thrusters are given.
    """
    weight, n = state_weight(problem), len(amounts)
    reach = weight[:, None] * transfer_maps(problem).reach[-1]
    if thrust is not None:
        assert thrust.directions is not None
        reach = (reach.reshape(6, -1, 3) @ thrust.directions.T).reshape(6, -1)
    left = weight * miss - np.matvec(reach, amounts.reshape(n, -1))
    short = np.abs(left).max(axis=1) > MET
    if not short.any():
        return amounts
    columns = reach * free.reshape(n, 1, -1)
    added = np.matvec(np.linalg.pinv(columns, rcond=1e-9), left) * free.reshape(n, -1)
    return np.where(short[:, None, None], amounts + added.reshape(amounts.shape), amounts)
