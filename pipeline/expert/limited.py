"""Decoupled optima where thrust is more than axes with one limit, and the bounds they prove."""

from dataclasses import dataclass, replace

import numpy as np

from pipeline.arrays import Array, Bool, Float, Int
from pipeline.expert.conic import IMPOSSIBLE, OPTIMAL, ConicProgram
from pipeline.expert.subproblem import Subproblem
from pipeline.orbit.arrays import Controls, Rows
from pipeline.orbit.decoupled import SHORT
from pipeline.orbit.problem import LIMIT_ROUNDING, RANGES, Problem
from pipeline.orbit.thrust import COMPONENTS, Limits, Thrust
from pipeline.orbit.thrust_cost import cost, polar, support, thrusts, worth
from pipeline.orbit.transfer import transfer_maps
from pipeline.scenario.arrivals import Arrivals

LIMIT_SHARE = 1 - 1e-7  # share of a limit that programs use, rounding staying within it
BURN = 1e-5  # share of a craft's largest control under which one is rounding, of a cone program
NOISE = 1e-3  # share of the largest control of all craft that a craft's largest counts as, at least
NO_EFFECT = 1e-14  # share of controls' largest effect along any direction that is rounding of none
MET = 1e-9  # change of a final state that counts as none, m; velocities over e


@dataclass(frozen=True, eq=False)
class Duals(Rows):
    """Dual variables of the programs of n craft; whatever they are, they prove a bound."""

    goal: Float[Array, "n r"]  # y, of the goals and waypoints
    split: Float[Array, "n intervals 3"]  # w, of the cones: what of y reach counts against norms


def decoupled_program(at: Arrivals, limits: Limits, problem: Problem) -> ConicProgram:
    """The cone program of craft that do not see each other; their fuel is least, whatever else."""
    none: Int[Array, 0] = np.zeros(0, dtype=int)
    m = at.reach.shape[1]
    largest = np.abs(np.matvec(transfer_maps(problem).to_goal, at.miss[:, :6])).max()
    sub = Subproblem(
        *(at.reach, at.miss, none, none, np.zeros((0, m)), np.zeros(0), np.inf, 0.0),
        asked=at.asked,
        unit=float(largest if largest > problem.negligible_fuel else problem.evasive_control),
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


def least_of(at: Arrivals, limits: Limits, problem: Problem) -> tuple[Controls | None, Duals]:
    """Controls of least fuel of all craft in one program, or None, and dual variables."""
    program = decoupled_program(at, limits, problem)
    for careful in (False, True):
        found = program.solver(careful=careful).solve()
        if str(found.status) in (*OPTIMAL, IMPOSSIBLE):
            break
    sub = program.sub
    z = np.asarray(found.z)
    y = np.zeros(at.miss.shape)
    y[at.asked] = -z[: at.asked.sum()]
    dual = Duals(y * sub.goal_scale * sub.unit, program.splits(z))
    if str(found.status) not in OPTIMAL:
        return None, dual
    return program.controls_of(program.solved(np.asarray(found.x))).reshape(len(at), -1, 3), dual


def dual_bounds(duals: Duals, at: Arrivals, limits: Limits, problem: Problem) -> Float[Array, "n"]:
    """The lower bound on the fuel of each craft, m/s², that any dual variables prove.

    By weak duality: for any y, a control u costs at least y · (reach u), less the worth of y's
    prices; and also where y is shrunk until nothing is worth more than it costs.
    """
    y = duals.goal
    along, value = _along(y, at), np.vecdot(at.miss, y)
    most = np.where(limits.burns.any(axis=2), polar(along, problem.thrust), 0.0).max(axis=1)
    bound = value / np.maximum(1.0, most)
    with np.errstate(invalid="ignore"):
        bound = np.fmax(bound, value - worth(along, duals.split, limits, problem.thrust))
    return np.fmax(bound, 0.0)


def impossible(duals: Duals, at: Arrivals, limits: Limits, problem: Problem) -> bool:
    """Whether it is proven that the controls of one craft bring it nowhere where it must be.

    They do at most their support along y (Farkas' lemma), and, for the largest limit that a problem
    may have, along the directions in which controls as good as do nothing.
    """
    y = duals.goal
    if np.isfinite(y).all():
        most = support(_along(y, at), duals.split, limits, problem.thrust)[0]
        if at.miss[0] @ y[0] > most * (1 + LIMIT_ROUNDING):
            return True
    asked, columns = at.asked[0], limits.burns[0].ravel()
    scale, miss, reach = at.scale[asked], at.miss[0, asked], at.reach[asked][:, columns]
    directions = np.linalg.svd(reach * scale[:, None])[0].T * scale
    changes, effects = np.abs(directions @ miss), np.abs(directions @ reach)
    effects[effects < NO_EFFECT * effects.max(initial=0.0)] = 0.0
    furthest = RANGES["max_acceleration"][1] * effects.sum(axis=1)
    return bool((changes > furthest + SHORT * np.abs(miss * scale).max()).any())


def _along(y: Float[Array, "n r"], at: Arrivals) -> Float[Array, "n intervals 3"]:
    """What each control does along y, per m/s²."""
    return (y @ at.reach).reshape(len(y), -1, 3)


def settled(controls: Controls, at: Arrivals, limits: Limits, problem: Problem) -> Controls:
    """The controls without what is rounding in them, which lead exactly where craft must be.

    By the least change of the burns that are left; where those cannot, of all that may be.
    """
    thrust, allowed = problem.thrust, limits.burns
    size = np.abs(controls)
    if thrust.model != COMPONENTS:
        size = np.broadcast_to(cost(controls, thrust)[..., None], controls.shape)
    # What is solved together has rounding of the size of the largest.
    largest = np.maximum(size.max(axis=(1, 2), keepdims=True), NOISE * size.max())
    burns = allowed & (size > BURN * largest)
    kept = np.where(burns, controls, 0.0)
    if thrust.min_delta_v is not None and not isinstance(thrust.model, str):
        # A change of the thrusts that are, so that no other thruster fires a little.
        fired = thrusts(kept, limits, thrust)
        fired = np.where(fired > BURN * largest, fired, 0.0)
        kept = _completed(fired, fired > 0, at, thrust) @ thrust.directions
    kept = _completed(kept, burns, at)
    # Where what is left out cannot be made up for, as of burns that are all small, nothing is.
    missed = _missed(kept, at) > MET
    kept = np.where(missed[:, None, None] & allowed, controls, kept)
    return _completed(kept, allowed, at)


def _missed(amounts: Controls, at: Arrivals) -> Float[Array, "n"]:
    """By how much controls miss where each craft must be, m; velocities over e."""
    led = np.matvec(at.reach, amounts.reshape(len(amounts), -1))
    return np.abs(at.weight * (at.miss - led * at.asked)).max(axis=1)


def _completed(
    amounts: Float[Array, "n intervals V"],
    free: Bool[Array, "n intervals V"],
    at: Arrivals,
    thrust: Thrust | None = None,
) -> Float[Array, "n intervals V"]:
    """Controls with the least change of those that are free after which nothing is missed.

    Or thrusts, where the thrusters are given.
    """
    n, asked, rows = len(amounts), at.asked, len(at.reach)
    reach = at.weight[:, None] * at.reach
    if thrust is not None:
        assert thrust.directions is not None
        reach = (reach.reshape(rows, -1, 3) @ thrust.directions.T).reshape(rows, -1)
    left = at.weight * at.miss - np.matvec(reach, amounts.reshape(n, -1)) * asked
    short = np.abs(left).max(axis=1) > MET
    if not short.any():
        return amounts
    columns = reach * free.reshape(n, 1, -1) * asked[..., None]
    added = np.matvec(np.linalg.pinv(columns, rcond=1e-9), left) * free.reshape(n, -1)
    return np.where(short[:, None, None], amounts + added.reshape(amounts.shape), amounts)
