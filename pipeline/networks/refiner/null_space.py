"""Least change in place of least fuel: what rounds come to whose steps lie in the null space of R.

A craft that keeps to its side of some planes departs from its own optimum u₀ as little as it can,
by the sum of squares, while R u = b still holds:

    min ½‖u - u₀‖² + Λ Σ max(0, d - g·u)   subject to   R u = b.

With F, which takes from controls what changes the final state, that is u = u₀ + F Σ λ g, and the
prices λ in [0, Λ] are found one after the other until none changes: C. Hildreth, "A quadratic
programming procedure", Naval Research Logistics Quarterly 4, 1957. Such steps spread thrust over
all nodes. No network plans with them; ablations show what least fuel is worth.
"""

from typing import no_type_check

import torch
from jaxtyping import Float, Int
from numba import njit
from torch import Tensor

from pipeline.networks.refiner.compiled import numbers
from pipeline.networks.refiner.grid import Grid
from pipeline.networks.refiner.program import DEAREST, Own, Program
from pipeline.networks.refiner.sides import Sides

STEADY = 1e-10
"""Change of all prices under which they are found."""

MOST_SWEEPS = 1000
"""Times that all prices of a craft are gone through at most."""

NO_GAIN = 1e-12
"""|F g|² under which a plane cannot be moved."""


def first_price(
    _: Own, craft: Int[Tensor, "k"], gain: Float[Tensor, "k m"], grid: Grid
) -> Float[Tensor, "k"]:
    """What giving way costs at the margin after a unit, 1 / |F g|²; at first it is free."""
    return 1 / (gain @ grid.free).square().sum(dim=1).clamp(min=NO_GAIN)


def optimum(
    own: Own, sides: Sides, gain: Float[Tensor, "L m"], asked: Float[Tensor, "L 2"], grid: Grid
) -> tuple[Float[Tensor, "C m"], Float[Tensor, "L 2"]]:
    """Controls and prices of each craft's program, without gradients."""
    controls, price = own.controls[sides.craft].clone(), torch.zeros_like(asked)
    given = (sides.start, sides.order, gain, gain @ grid.free, asked)
    solve_all(*map(numbers, given), DEAREST, controls.numpy(), price.numpy())
    return controls, price


LEAST_CHANGE = Program(first_price, optimum)
"""The program above."""


@no_type_check
@njit(cache=True)
def solve_all(start, order, gain, free, asked, dearest, controls, price):
    """The optimum of each of C programs; sides are those of ``pivots.solve_all``.

    Args:
        start: where the sides of each craft begin in ``order``, (C + 1,).
        order: sides of planes, (S,).
        gain: rows of planes for the first craft of each, (L, m).
        free: F times these, (L, m).
        asked: what is asked of either craft, (L, 2).
        dearest: cost of what is missing at a plane.
        controls: own optima, which become the result, (C, m).
        price: zeros, which become the result, (L, 2).
    """
    for c in range(len(start) - 1):
        mine, u = order[start[c] : start[c + 1]], controls[c]
        for _ in range(MOST_SWEEPS):
            most = 0.0
            for side in mine:
                plane, second = side >> 1, side & 1
                sign = -1.0 if second else 1.0
                g, f = gain[plane], free[plane]
                left, length = asked[plane, second], 0.0
                for k in range(len(u)):
                    left -= sign * g[k] * u[k]
                    length += g[k] * f[k]
                if length > NO_GAIN:
                    before = price[plane, second]
                    now = min(max(before + left / length, 0.0), dearest)
                    price[plane, second] = now
                    for k in range(len(u)):
                        u[k] += sign * (now - before) * f[k]
                    most = max(most, abs(now - before))
            if most < STEADY:
                break
