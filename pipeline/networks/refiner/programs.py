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
from typing import Any, no_type_check

import numpy as np

from pipeline.arrays import Array, Float, Int, like, plain
from pipeline.errors import InputError
from pipeline.expert.decoupled import minimum_fuel
from pipeline.networks.refiner.arrays import constant, njit, rows
from pipeline.networks.refiner.geometry import Grid, Sides, per_step
from pipeline.orbit.arrays import Rows
from pipeline.orbit.decoupled import MinimumFuelTransfers
from pipeline.orbit.problem import Problem

LARGEST_DUAL = 50.0  # Λ: dual up to which a plane is kept, r_col/Δt² per r_col; few exceed 2
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
        change = np.zeros((L if differentiable else 0, 2, m))  # ∂u/∂d
        own = (self.tableau, self.controls, self.basis, self.others, self.side, self.cost)
        given = (sides.craft, sides.start, sides.order, plain(gain), plain(required))
        solve_all(*own, *given, LARGEST_DUAL, controls, dual, change)
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
        return first_ratios(self.tableau, self.basis, self.others, self.cost, craft, gain)


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


# The dual simplex method, compiled. jaxtyping cannot look into compiled functions; their shapes are
# those of ``solve_all``.


@no_type_check
@njit(cache=True)
def solve_all(
    tableau, own, basis, others, sides, costs, craft_of, start, order, gain, required, largest,
    controls, dual, change,
):  # fmt: skip
    """The optimum of each of C programs; all arrays are contiguous float64 or int64.

    The first six arguments are the fields of ``Decoupled``, the next three those of
    ``Sides``; gain (L, m), required (L, 2) and largest are g, d and Λ. Results are controls
    (C, m), and what begins as zeros: duals (L, 2), and ∂u/∂required (L, 2, m), which is (0, 2, m)
    where it is not wanted. A plane has two sides, 2l and 2l + 1, for the two craft between which
    it is.
    """
    C, m = len(craft_of), own.shape[1]
    most = 0
    for c in range(C):
        most = max(most, start[c + 1] - start[c])
    body, value, side = np.empty((6 + most, m - 6)), np.empty(6 + most), np.empty(6 + most)
    basic, other = np.empty(6 + most, np.int64), np.empty(m - 6, np.int64)
    cost, ratio, there = np.empty(m - 6), np.empty(m - 6), np.empty(most, np.bool_)
    for c in range(C):
        craft, mine, u = craft_of[c], order[start[c] : start[c + 1]], controls[c]
        copy(own[craft], u)
        copy(others[craft], other)
        copy(costs[craft], cost)
        copy(basis[craft], basic)
        copy(sides[craft], side)
        rows, there[:] = basis.shape[1], False
        for i in range(rows):
            value[i] = u[basic[i]]
            copy(tableau[craft, i], body[i])
        while True:
            # The optimum without their rows satisfies most planes, which then need none.
            before = rows
            for p in range(len(mine)):
                if there[p]:
                    continue
                left = slack(gain, required, mine[p], u)
                if left < -SMALL:
                    there[p] = True
                    add_row(rows, m, p, gain, mine[p], left, body, value, side, basic, other)
                    rows += 1
            if rows == before:
                break
            for _ in range(MOST_PIVOTS):
                if not pivot(rows, m, largest, body, value, side, basic, other, cost, ratio):
                    break
            u[:] = 0.0
            for i in range(rows):
                if basic[i] < m:
                    u[basic[i]] = value[i]
        read_duals(rows, mine, m, largest, body, side, basic, other, cost, dual, change)


@no_type_check
@njit(cache=True)
def copy(values, into):
    """Copy values into the first elements of an array; slices take numba seconds to compile."""
    for k in range(len(values)):
        into[k] = values[k]


@no_type_check
@njit(cache=True, fastmath={"reassoc"})
def slack(gain, required, mine, controls):
    """Slack of controls at a side's plane."""
    plane, second = mine >> 1, mine & 1
    along = 0.0
    for k in range(len(controls)):
        along += gain[plane, k] * controls[k]
    return (-along if second else along) - required[plane, second]


@no_type_check
@njit(cache=True)
def add_row(i, m, p, gain, mine, left, body, value, side, basic, other):
    """Append the slack of plane p as row i, expressed by the present nonbasic variables."""
    plane, sign = mine >> 1, -1.0 if mine & 1 else 1.0
    value[i], side[i], basic[i] = left, 1.0, m + p
    for k in range(len(other)):
        body[i, k] = -sign * gain[plane, other[k]] if other[k] < m else 0.0
    for b in range(i):
        if basic[b] < m:
            share = sign * gain[plane, basic[b]]
            for k in range(len(other)):
                body[i, k] += share * body[b, k]


@no_type_check
@njit(cache=True)
def first_ratios(tableau, basis, others, costs, craft_of, gain):
    """The cost to craft, (k,), of the first unit along rows (k, m): the dual simplex ratio."""
    moved, dual = np.empty(others.shape[1]), np.empty(len(craft_of))
    for c in range(len(craft_of)):
        craft, g = craft_of[c], gain[c]
        for k in range(len(moved)):
            moved[k] = g[others[craft, k]]
        for b in range(6):
            for k in range(len(moved)):
                moved[k] -= g[basis[craft, b]] * tableau[craft, b, k]
        least = np.inf
        for k in range(len(moved)):
            size, cost = abs(moved[k]), costs[craft, k]
            rise = 1.0 - cost if moved[k] > 0 else 1.0 + cost
            # The sign of a rounding error has no meaning.
            least = min(least, 1.0 / SMALL if size < SMALL else rise / size)
        dual[c] = least
    return dual


@no_type_check
@njit(cache=True)
def slopes(variable, m, largest):
    """Slopes of a variable's cost, below and above 0."""
    return (-1.0, 1.0) if variable < m else (-largest, 0.0)


@no_type_check
@njit(cache=True)
def pivot(rows, m, largest, body, value, side, basic, other, cost, ratio):
    """One step: the worst infeasible variable changes side or leaves; False if there is none."""
    leaving, worst = rows, SMALL
    for i in range(rows):
        if -value[i] * side[i] > worst:
            leaving, worst = i, -value[i] * side[i]
    if leaving == rows:
        return False
    sign, line = side[leaving], body[leaving]
    entering = entering_variable(sign, line, cost, other, m, largest, ratio)
    step = ratio[entering]
    low, high = slopes(basic[leaving], m, largest)
    over = high - low <= step
    step = min(step, high - low)
    for k in range(len(other)):
        cost[k] -= step * sign * line[k]
    if over:
        side[leaving] = -sign
    else:
        exchange(rows, leaving, entering, body, value, basic, other)
        side[leaving] = -1.0 if sign * line[entering] > 0 else 1.0
        cost[entering] = high - step if sign > 0 else low + step
    return True


@no_type_check
@njit(cache=True)
def entering_variable(sign, line, cost, other, m, largest, ratio):
    """The nonbasic variable that enters for one that leaves its side: the first of the cheapest.

    ``ratio`` becomes the dual of the leaving variable's row, ``line``, at which each would enter.
    """
    least, steepest, found = np.inf, 0.0, -1
    for k in range(len(other)):
        slope, (low, high) = sign * line[k], slopes(other[k], m, largest)
        ratio[k] = np.inf
        if abs(slope) >= NO_PIVOT:
            ratio[k] = max((cost[k] - (low if slope > 0 else high)) / slope, 0.0)
        least = min(least, ratio[k])
    for k in range(len(other)):
        if ratio[k] <= least + TIE:
            steepest = max(steepest, abs(line[k]))
    for k in range(len(other)):
        tied = ratio[k] <= least + TIE and abs(line[k]) >= STEEP * steepest
        if tied and (found < 0 or other[k] < other[found]):
            found = k
    return found


@no_type_check
@njit(cache=True)
def exchange(rows, leaving, entering, body, value, basic, other):
    """Exchange a basic and a nonbasic variable."""
    line = body[leaving]
    inverse = 1.0 / line[entering]
    amount = value[leaving] * inverse
    for k in range(len(other)):
        line[k] *= inverse
    line[entering] = inverse
    for i in range(rows):
        share = body[i, entering]
        if i != leaving and share != 0.0:
            for k in range(len(other)):
                body[i, k] -= share * line[k]
            body[i, entering] = -share * inverse
            value[i] -= share * amount
    value[leaving] = amount
    basic[leaving], other[entering] = other[entering], basic[leaving]


@no_type_check
@njit(cache=True)
def read_duals(rows, mine, m, largest, body, side, basic, other, cost, dual, change):
    """Read duals off the tableau, and the derivatives of controls by the effects required."""
    for i in range(rows):
        if basic[i] >= m and side[i] < 0:  # the plane is violated
            plane = mine[basic[i] - m]
            dual[plane >> 1, plane & 1] = largest
    for k in range(m - 6):
        if other[k] >= m:
            plane, second = mine[other[k] - m] >> 1, mine[other[k] - m] & 1
            dual[plane, second] = min(max(-cost[k], 0.0), largest)  # ties may take it beyond
            if len(change):
                for i in range(rows):
                    if basic[i] < m:
                        change[plane, second, basic[i]] = -body[i, k]
