"""Each craft's own program: minimum fuel to its goal, on its side of some separating planes.

The program of ``model`` is solved by a dual simplex method on the tableau, from the decoupled
optimum (no planes), whose basis is known. A program has 6 + p basic and m - 6 nonbasic
variables, m controls and p planes, all of whose costs have a kink at 0:

    x_B = value - body · x_N,    x_N = 0.

``side`` is the side of 0 on which the cost of each basic variable is taken; ``cost`` is the dual of
each nonbasic one, between the slopes at its kink. Pivots keep these bounds; a basic variable on the
wrong side leaves, until there is none.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.arrays import Array, Float, Int, like, plain
from pipeline.errors import InputError
from pipeline.expert.decoupled import minimum_fuel
from pipeline.networks.refiner.arrays import KERNELS, constant, rows
from pipeline.networks.refiner.geometry import Grid, Sides, per_step
from pipeline.orbit.arrays import Rows
from pipeline.orbit.decoupled import MinimumFuelTransfers
from pipeline.orbit.problem import Problem

LARGEST_DUAL = 50.0  # Λ: dual up to which a plane is kept, r_col/Δt² per r_col; few exceed 2
# Those of kernels.c, too:
SMALL = 1e-9  # what counts as 0 among the values of basic variables, r_col
NO_PIVOT = 1e-11  # entries of a tableau smaller than this are no pivots
# Difference of duals that counts as none: where several optima cost the same, the earliest control
# enters, or rounding and the order of planes would choose between them.
TIE = 1e-6
STEEP = 0.1  # least size of a pivot, as a share of the largest entry among ties
MOST_PIVOTS = 500  # most pivots after planes are added, at which a program stops unsolved


@dataclass(frozen=True, eq=False)
class Decoupled(Rows):
    """The decoupled optimum of each craft and its simplex tableau."""

    controls: Float[Any, "N m"]  # of least ‖u‖₁
    basis: Int[Any, "N 6"]  # basic controls
    others: Int[Any, "N _"]  # nonbasic ones
    side: Float[Any, "N 6"]  # the sign of each basic control
    tableau: Float[Any, "N 6 _"]  # B⁻¹ R of the nonbasic controls
    cost: Float[Any, "N _"]  # side · tableau, from which their reduced costs follow

    def optima(
        self, sides: Sides, gain: Float[Any, "L m"], required: Float[Any, "L 2"]
    ) -> tuple[Float[Any, "C m"], Float[Any, "L 2"]]:
        """The optimal controls of each craft's program, and the dual of each plane for both craft.

        ``gain`` has the row g of each plane for its first craft, whose negative is that of the
        second; ``required`` has d. With tensors, gradients run from the controls to both, since the
        optimum is linear in them as long as its basis stays; none runs through duals.
        """
        (L, m), C = gain.shape, len(sides.craft)
        is_tensor = not isinstance(gain, np.ndarray)
        differentiable = is_tensor and (gain.requires_grad or required.requires_grad)
        controls, dual = np.empty((C, m)), np.zeros((L, 2))
        change = np.zeros((L, 2, m)) if differentiable else None  # ∂u/∂d
        own = (self.tableau, self.controls, self.basis, self.others, self.side, self.cost)
        given = (sides.craft, sides.start, sides.order, plain(gain), plain(required))
        most = int(np.diff(sides.start).max(initial=0))
        work = np.empty((6 + most) * (m - 4) + 2 * m), np.empty(m + 2 * most, dtype=np.int64)
        result = controls, dual, change
        KERNELS.call(
            "solve_all", C, m, MOST_PIVOTS, LARGEST_DUAL, *own, *given, most, *work, *result
        )
        best = like(controls, gain)
        if differentiable:
            place = like(sides.place, gain)
            turned = (gain - constant(gain))[:, None] * rows(best, place).reshape(L, 2, m)
            more = required - constant(required) - turned.sum(axis=2) * gain.new_tensor([1.0, -1.0])
            moved = like(change, gain) * more[..., None]  # (L, 2, m), all 0 but for their gradient
            best = best.index_add(0, place, moved.reshape(2 * L, m))
        return best, dual

    def first_duals(self, craft: Int[Any, "k"], gain: Float[Any, "k m"]) -> Float[Any, "k"]:
        """The cost to a craft of the first unit along a row: the dual simplex ratio."""
        k, m = gain.shape
        own, result = (self.tableau, self.basis, self.others, self.cost), np.empty(k)
        KERNELS.call("first_ratios", k, m, *own, craft, gain, np.empty(m), result)
        return result


def reaching(miss: Float[Array, "N 6"], problem: Problem) -> MinimumFuelTransfers:
    """Minimum-fuel transfers for changes of state; InputError where not every one is reached."""
    found = minimum_fuel(miss, problem)
    if found is None:
        raise InputError(
            f"on {problem.nodes} nodes {problem.time_step:g} s apart no controls reach every "
            "state; expected another time grid."
        )
    return found


def decoupled_optima(
    initial: Float[Array, "N 6"], goal: Float[Array, "N 6"], grid: Grid, problem: Problem
) -> Decoupled:
    """The decoupled optima; InputError where controls do not reach every state."""
    miss = goal - initial @ grid.drift[-6:].T  # (N, 6)
    found = reaching(miss / per_step(problem), problem)
    N, m = len(initial), grid.reach.shape[1]
    side, basis = np.where(found.basis < m, 1.0, -1.0), found.basis % m
    nonbasic = np.ones((N, m), dtype=bool)
    np.put_along_axis(nonbasic, basis, False, axis=1)
    others = np.nonzero(nonbasic)[1].reshape(N, m - 6)
    columns = grid.reach[-6:].T
    tableau = np.linalg.solve(columns[basis].mT, columns[others].mT)  # (N, 6, m - 6)
    cost = (side[:, None] @ tableau)[:, 0]
    controls = found.controls.reshape(N, m) * problem.time_step**2
    return Decoupled(controls, basis, others, side, tableau, cost)
