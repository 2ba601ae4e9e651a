"""Each craft's own program: least fuel to its goal, on its side of some planes.

For one craft, with controls u, rows g of the planes and what they ask for, d:

    min ‖u‖₁ + Λ Σ max(0, d - g·u)   subject to   R u = b,

a linear program whose cost has a kink at 0 in every variable: a control costs 1 in either
direction, and what is left at a plane, q = g·u - d, costs Λ below 0 and nothing above. It is
solved by a dual simplex method on the tableau, begun at the own optimum, whose basis the table of
own optima knows. A basic variable on the wrong side of its kink leaves the basis at 0, or goes
over to that side's slope, whichever the ratio test meets first.

The price of a plane, its multiplier λ in [0, Λ], is what another unit of separation would cost.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields

import torch
from jaxtyping import Float, Int
from torch import Tensor

from pipeline.networks.refiner.compiled import numbers
from pipeline.networks.refiner.grid import Grid
from pipeline.networks.refiner.pivots import first_prices, solve_all
from pipeline.networks.refiner.sides import Sides

DEAREST = 50.0
"""Λ: fuel at which a plane is given up, r_col/Δt² a r_col; few ever cost more than 2."""


@dataclass(frozen=True, eq=False)
class Own:
    """The own optimum of each craft as a tableau, N craft with m controls.

    Attributes:
        controls: (N, m).
        basis: basic controls, (N, 6).
        others: nonbasic ones, (N, m - 6).
        side: the sign of each basic control, (N, 6).
        tableau: B⁻¹ R of the nonbasic controls, (N, 6, m - 6).
        cost: side · tableau, (N, m - 6).
    """

    controls: Float[Tensor, "N m"]
    basis: Int[Tensor, "N 6"]
    others: Int[Tensor, "N _"]
    side: Float[Tensor, "N 6"]
    tableau: Float[Tensor, "N 6 _"]
    cost: Float[Tensor, "N _"]


@dataclass(frozen=True, eq=False)
class Optimum:
    """The optimum of each program.

    Attributes:
        controls: of each craft that has planes, (C, m).
        price: of each plane for either craft, (L, 2).
        change: of a craft's controls with what a plane asks of it, ∂u/∂d, (L, 2, m); (0, 2, m)
            where it was not wanted.
    """

    controls: Float[Tensor, "C m"]
    price: Float[Tensor, "L 2"]
    change: Float[Tensor, "_ 2 m"]


def own_tableau(
    controls: Float[Tensor, "N m"],
    basis: Int[Tensor, "N 6"],
    side: Float[Tensor, "N 6"],
    reach: Float[Tensor, "6 m"],
) -> Own:
    """The tableau of own optima of given bases."""
    N, m = controls.shape
    nonbasic = torch.ones(N, m, dtype=torch.bool, device=controls.device).scatter(1, basis, False)
    others = nonbasic.nonzero()[:, 1].reshape(N, m - 6)
    tableau = torch.linalg.solve(reach.T[basis].mT, reach.T[others].mT).contiguous()
    return Own(controls, basis, others, side, tableau, torch.einsum("ni,nij->nj", side, tableau))


def optimum(
    own: Own, sides: Sides, gain: Float[Tensor, "L m"], asked: Float[Tensor, "L 2"], _: Grid
) -> tuple[Float[Tensor, "C m"], Float[Tensor, "L 2"]]:
    """Controls and prices of each craft's program.

    Gradients run from the controls to rows and what is asked for, as the optimum moves while its
    basis stays; prices have none.

    Args:
        own: own optima of all craft.
        sides: which planes are whose.
        gain: g of each plane for its first craft; that of the second is -g.
        asked: d of each plane, for either craft.
    """
    wanted = gain.requires_grad or asked.requires_grad
    found = solve(own, sides, gain, asked, differentiable=wanted)
    controls = found.controls
    if wanted:
        place = sides.place
        theirs = controls.index_select(0, place).reshape(found.change.shape)
        moved = ((gain - gain.detach())[:, None] * theirs).sum(dim=2)
        more = asked - asked.detach() - torch.stack([moved[:, 0], -moved[:, 1]], dim=1)
        change = found.change * more[..., None]
        controls = controls.index_add(0, place, change.flatten(0, 1))
    return controls, found.price


def first_price(
    own: Own, craft: Int[Tensor, "k"], gain: Float[Tensor, "k m"], _: Grid
) -> Float[Tensor, "k"]:
    """What the first unit along a row costs a craft: the dual simplex ratio."""
    price = torch.empty(len(craft), dtype=torch.float64)
    given = (own.tableau, own.basis, own.others, own.cost, craft, gain)
    first_prices(*map(numbers, given), price.numpy())
    return price.to(gain.device)


def solve(
    own: Own,
    sides: Sides,
    gain: Float[Tensor, "L m"],
    asked: Float[Tensor, "L 2"],
    *,
    differentiable: bool = False,
) -> Optimum:
    """The optimum of each craft's program, with its change where it is wanted; on the CPU."""
    (L, m), C = gain.shape, len(sides.craft)
    found = Optimum(
        torch.empty(C, m, dtype=torch.float64),
        torch.zeros(L, 2, dtype=torch.float64),
        torch.zeros(L if differentiable else 0, 2, m, dtype=torch.float64),
    )
    tableaux = (own.tableau, own.controls, own.basis, own.others, own.side, own.cost)
    given = (*tableaux, sides.craft, sides.start, sides.order, gain, asked)
    results = (found.controls, found.price, found.change)
    solve_all(*map(numbers, given), DEAREST, *(part.numpy() for part in results))
    return Optimum(*(getattr(found, one.name).to(gain.device) for one in fields(found)))


@dataclass(frozen=True)
class Program:
    """What each craft solves.

    Attributes:
        price: what the first unit along a row costs a craft that has no planes yet.
        optimum: controls of each craft that has planes, and prices of these for either craft.
    """

    price: Callable[[Own, Tensor, Tensor, Grid], Tensor]
    optimum: Callable[[Own, Sides, Tensor, Tensor, Grid], tuple[Tensor, Tensor]]


LEAST_FUEL = Program(first_price, optimum)
"""The program above."""
