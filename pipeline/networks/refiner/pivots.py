"""The dual simplex method on the tableaux of many small programs, compiled.

A program has 6 + p basic and m - 6 other variables, m controls and p planes, all of whose costs
have a kink at 0 (``pipeline.networks.refiner.program``):

    x_B = value - body · x_N,    x_N = 0.

Of each basic variable, side says on which side of 0 its cost is taken to be; of each other one,
cost is its dual, between the slopes on either side. That is kept true; a basic variable that is
on the wrong side leaves, until there is none.
"""

from typing import no_type_check

import numpy as np
from numba import njit

SMALL = 1e-9
"""What counts as 0 among the values of basic variables, r_col."""

NO_PIVOT = 1e-11
"""Entries of a tableau under which nothing is divided by them."""

MOST_PIVOTS = 500
"""Pivots of a program after which it is left as it is."""

# jaxtyping cannot look into compiled functions; their shapes are those of ``solve_all``.


@no_type_check
@njit(cache=True)
def solve_all(
    tableau, own, basis, others, sides, costs, row, asked, start, dearest, controls, price, change
):
    """The optimum of each of C programs; all arrays are contiguous float64 or int64.

    Args:
        tableau: B⁻¹ R of own optima, (C, 6, m - 6).
        own: own optima, (C, m).
        basis: basic controls there, (C, 6).
        others: the other controls, (C, m - 6).
        sides: sign of each basic control, (C, 6).
        costs: duals of the others, (C, m - 6).
        row: planes of all craft, one craft's after the other's, (S, m).
        asked: what each plane asks for, (S,).
        start: where each craft's planes begin, and S, (C + 1,).
        dearest: cost of what is missing at a plane.
        controls: result, (C, m).
        price: result, (S,).
        change: result ∂u/∂asked, (S, m), or (0, m) where it is not wanted.
    """
    C, m = own.shape
    most = np.max(start[1:] - start[:-1])
    body, value, side = np.empty((6 + most, m - 6)), np.empty(6 + most), np.empty(6 + most)
    basic, other = np.empty(6 + most, np.int64), np.empty(m - 6, np.int64)
    cost = np.empty(m - 6)
    for craft in range(C):
        first, p = start[craft], start[craft + 1] - start[craft]
        begin(
            tableau[craft],
            own[craft],
            basis[craft],
            others[craft],
            sides[craft],
            costs[craft],
            row,
            asked,
            first,
            p,
            body,
            value,
            side,
            basic,
            other,
            cost,
        )
        for _ in range(MOST_PIVOTS):
            if not pivot(6 + p, m, dearest, body, value, side, basic, other, cost):
                break
        finish(
            first,
            6 + p,
            m,
            dearest,
            body,
            value,
            side,
            basic,
            other,
            cost,
            controls[craft],
            price,
            change,
        )


@no_type_check
@njit(cache=True)
def begin(
    tableau,
    own,
    basis,
    others,
    sides,
    costs,
    row,
    asked,
    first,
    p,
    body,
    value,
    side,
    basic,
    other,
    cost,
):
    """The tableau at the own optimum, where what is left at the planes is basic."""
    K = len(others)
    for k in range(K):
        other[k], cost[k] = others[k], costs[k]
    for i in range(6):
        value[i], side[i], basic[i] = own[basis[i]], sides[i], basis[i]
        for k in range(K):
            body[i, k] = tableau[i, k]
    for c in range(p):
        g = row[first + c]
        left = -asked[first + c]
        for k in range(len(own)):
            left += g[k] * own[k]
        value[6 + c], side[6 + c], basic[6 + c] = left, 1.0, len(own) + c
    for c in range(p):
        g = row[first + c]
        for k in range(K):
            moved = -g[others[k]]
            for i in range(6):
                moved += g[basis[i]] * tableau[i, k]
            body[6 + c, k] = moved


@no_type_check
@njit(cache=True)
def slopes(variable, m, dearest):
    """Slopes of a variable's cost below and above 0."""
    return (-1.0, 1.0) if variable < m else (-dearest, 0.0)


@no_type_check
@njit(cache=True)
def pivot(rows, m, dearest, body, value, side, basic, other, cost):
    """One step: a variable on the wrong side goes over, or leaves; False where there is none."""
    leaving, worst = -1, SMALL
    for i in range(rows):
        if -value[i] * side[i] > worst:
            leaving, worst = i, -value[i] * side[i]
    if leaving < 0:
        return False
    sign, line = side[leaving], body[leaving]
    entering, step = -1, np.inf
    for k in range(len(other)):
        slope = sign * line[k]
        if abs(slope) >= NO_PIVOT:
            low, high = slopes(other[k], m, dearest)
            ratio = max((cost[k] - (low if slope > 0 else high)) / slope, 0.0)
            if ratio < step:
                entering, step = k, ratio
    low, high = slopes(basic[leaving], m, dearest)
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
def exchange(rows, leaving, entering, body, value, basic, other):
    """Let a basic variable go and another come."""
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
def finish(first, rows, m, dearest, body, value, side, basic, other, cost, controls, price, change):
    """Read the optimum off the tableau."""
    controls[:] = 0.0
    for i in range(rows):
        if basic[i] < m:
            controls[basic[i]] = value[i]
        else:  # what is left at a plane, or missing
            price[first + basic[i] - m] = 0.0 if side[i] > 0 else dearest
    for k in range(len(other)):
        if other[k] >= m:
            plane = first + other[k] - m
            price[plane] = -cost[k]
            if len(change):
                for i in range(rows):
                    if basic[i] < m:
                        change[plane, basic[i]] = -body[i, k]
