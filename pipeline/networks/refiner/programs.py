"""Each craft's own program: least fuel to its goal, on its side of some separating planes.

That of ``model`` is solved by a dual simplex method on the tableau (``simplex``), from the
decoupled optimum, the one without planes, whose basis a table knows.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from pipeline.arrays import Array
from pipeline.errors import InputError
from pipeline.networks.refiner.arrays import constant, like, plain, rows
from pipeline.networks.refiner.geometry import Grid
from pipeline.networks.refiner.simplex import first_ratios, solve_all
from pipeline.orbit.decoupled import least_fuel
from pipeline.orbit.problem import Problem

LARGEST_DUAL = 50.0
"""Λ: fuel at which a plane is given up, r_col/Δt² a r_col; few ever cost more than 2."""


@dataclass(frozen=True, eq=False)
class Decoupled:
    """The decoupled optimum of each craft and its simplex tableau."""

    controls: Float[Any, "N m"]  # of least ‖u‖₁
    basis: Int[Any, "N 6"]  # basic controls
    others: Int[Any, "N _"]  # nonbasic ones
    side: Float[Any, "N 6"]  # the sign of each basic control
    tableau: Float[Any, "N 6 _"]  # B⁻¹ R of the nonbasic controls
    cost: Float[Any, "N _"]  # side · tableau, from which their reduced costs follow


def decoupled_optima(
    initial: Float[Array, "N 6"], goal: Float[Array, "N 6"], grid: Grid, problem: Problem
) -> Decoupled:
    """The decoupled optima, by table; InputError where controls do not reach every state."""
    miss = goal - initial @ grid.drift[-6:].T  # (N, 6)
    found = least_fuel(np.concatenate([miss[:, :3], miss[:, 3:] / grid.step], axis=1), problem)
    if found is None:
        raise InputError(f"no controls reach every state of {problem}; expected another time grid.")
    N, m = len(initial), grid.reach.shape[1]
    side, basis = np.where(found.basis < m, 1.0, -1.0), found.basis % m
    nonbasic = np.ones((N, m), dtype=bool)
    np.put_along_axis(nonbasic, basis, False, axis=1)
    others = np.nonzero(nonbasic)[1].reshape(N, m - 6)
    columns = grid.reach[-6:].T
    tableau = np.linalg.solve(columns[basis].mT, columns[others].mT)  # (N, 6, m - 6)
    cost = (side[:, None] @ tableau)[:, 0]
    controls = found.controls.reshape(N, m) * grid.step**2
    return Decoupled(controls, basis, others, side, tableau, cost)


@dataclass(frozen=True, eq=False)
class Sides:
    """The two sides 2l and 2l + 1 of each of L planes, by craft."""

    craft: Int[Array, "C"]  # the C craft with planes, in order
    start: Int[Array, "_"]  # where the sides of each begin in ``order``, and their number
    order: Int[Array, "S"]  # all sides, one craft's after the other's
    place: Int[Array, "S"]  # index in ``craft`` of each side's


def sides_of(craft: Int[Array, "L 2"]) -> Sides:
    """The sides of planes between two craft each."""
    flat = craft.reshape(-1)
    there, place, count = np.unique(flat, return_inverse=True, return_counts=True)
    start, order = np.append(0, count.cumsum()), place.argsort(kind="stable")
    return Sides(there, start, order, place)


def optima(
    own: Decoupled, sides: Sides, gain: Float[Any, "L m"], asked: Float[Any, "L 2"]
) -> tuple[Float[Any, "C m"], Float[Array, "L 2"]]:
    """The optimal controls of each craft's program, and the dual of each plane for either craft.

    ``gain`` has the row g of each plane for its first craft, whose negative is that of the second;
    ``asked`` has d. With tensors, gradients run from the controls to both, since the optimum is
    linear in them as long as its basis stays; none runs through duals.
    """
    (L, m), C = gain.shape, len(sides.craft)
    is_tensor = not isinstance(gain, np.ndarray)
    differentiable = is_tensor and (gain.requires_grad or asked.requires_grad)
    controls, dual = np.empty((C, m)), np.zeros((L, 2))
    change = np.zeros((L if differentiable else 0, 2, m))  # ∂u/∂d
    tableau = (own.tableau, own.controls, own.basis, own.others, own.side, own.cost)
    given = (sides.craft, sides.start, sides.order, plain(gain), plain(asked))
    solve_all(*tableau, *given, LARGEST_DUAL, controls, dual, change)
    best = like(controls, gain)
    if differentiable:
        place = like(sides.place, gain)
        turned = (gain - constant(gain))[:, None] * rows(best, place).reshape(L, 2, m)
        more = asked - constant(asked) - turned.sum(axis=2) * gain.new_tensor([1.0, -1.0])
        moved = like(change, gain) * more[..., None]  # (L, 2, m), all 0 but for their gradient
        best = best.index_add(0, place, moved.reshape(2 * L, m))
    return best, dual


def first_duals(
    own: Decoupled, craft: Int[Array, "k"], gain: Float[Array, "k m"]
) -> Float[Array, "k"]:
    """What the first unit along a row costs a craft: the dual simplex ratio."""
    found = first_ratios(own.tableau, own.basis, own.others, own.cost, craft, gain)
    return np.asarray(found)
