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

from dataclasses import dataclass, fields

import numpy as np
import torch
from jaxtyping import Float, Int, Shaped
from torch import Tensor

from pipeline.arrays import Array
from pipeline.networks.refiner.pivots import SMALL, solve_all

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

    def of(self, craft: Int[Tensor, "k"]) -> "Own":
        """Some of the craft, in any order."""
        return Own(*(getattr(self, one.name)[craft] for one in fields(self)))

    def price(self, row: Float[Tensor, "N m"]) -> Float[Tensor, "N"]:
        """What the first unit along a row of each craft costs: the dual simplex ratio."""
        gain = row.gather(1, self.others)
        gain = gain - torch.einsum("ni,nij->nj", row.gather(1, self.basis), self.tableau)
        rise = torch.where(gain > 0, 1 - self.cost, 1 + self.cost)
        rise = torch.where(gain.abs() < SMALL, 1.0, rise)  # the sign of rounding says nothing
        return (rise / gain.abs().clamp(min=SMALL)).amin(dim=1)


@dataclass(frozen=True, eq=False)
class Optimum:
    """The optimum of each program.

    Attributes:
        controls: (C, m).
        price: of each plane, (S,).
        change: of a craft's controls with what a plane of its own asks for, ∂u/∂d, (S, m); (0, m)
            where it was not wanted.
    """

    controls: Float[Tensor, "C m"]
    price: Float[Tensor, "S"]
    change: Float[Tensor, "_ m"]


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
    tableau = torch.linalg.solve(reach.T[basis].mT, reach.T[others].mT)
    return Own(controls, basis, others, side, tableau, torch.einsum("ni,nij->nj", side, tableau))


def optimum(
    own: Own, row: Float[Tensor, "S m"], asked: Float[Tensor, "S"], count: Int[Tensor, "C"]
) -> tuple[Float[Tensor, "C m"], Float[Tensor, "S"]]:
    """Controls and prices of each craft's program.

    Gradients run from the controls to rows and what is asked for, as the optimum moves while its
    basis stays; prices have none.

    Args:
        own: own optima.
        row: g of each plane, one craft's after the other's.
        asked: d of each plane.
        count: planes of each craft, at least one.
    """
    wanted = row.requires_grad or asked.requires_grad
    found = solve(own, row, asked, count, differentiable=wanted)
    controls = found.controls
    if wanted:
        craft = torch.arange(len(count), device=count.device).repeat_interleave(count)
        theirs = controls.index_select(0, craft)
        more = asked - asked.detach() - ((row - row.detach()) * theirs).sum(dim=1)
        controls = controls.index_add(0, craft, found.change * more[:, None])
    return controls, found.price


def solve(
    own: Own,
    row: Float[Tensor, "S m"],
    asked: Float[Tensor, "S"],
    count: Int[Tensor, "C"],
    *,
    differentiable: bool = False,
) -> Optimum:
    """The optimum of each craft's program, with its change where it is wanted; on the CPU."""
    (S, m), C = row.shape, len(count)
    found = Optimum(
        torch.empty(C, m, dtype=torch.float64),
        torch.zeros(S, dtype=torch.float64),
        torch.zeros(S if differentiable else 0, m, dtype=torch.float64),
    )
    start = np.concatenate([[0], np.cumsum(_array(count))])
    given = (own.tableau, own.controls, own.basis, own.others, own.side, own.cost, row, asked)
    results = (part.numpy() for part in (found.controls, found.price, found.change))
    solve_all(*map(_array, given), start, DEAREST, *results)
    return Optimum(*(getattr(found, one.name).to(row.device) for one in fields(found)))


def _array(values: Tensor) -> Shaped[Array, "..."]:
    """The same numbers for compiled code."""
    return values.detach().cpu().contiguous().numpy()
