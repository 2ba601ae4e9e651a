"""Each craft's own program: least fuel to its goal, on its side of some planes.

For one craft, with controls u, rows g of the planes and what they ask for, d:

    min ‖u‖₁ + Λ Σ max(0, d - g·u)   subject to   R u = b,

a linear program whose cost has a kink at 0 in every variable: a control costs 1 in either
direction, and what is left at a plane, q = g·u - d, costs Λ below 0 and nothing above. It is
solved by a dual simplex method on the tableau, begun at the own optimum, whose basis the table of
own optima knows. A basic variable on the wrong side of its kink leaves the basis at 0, or goes
over to that side's slope, whichever the ratio test meets first. All craft pivot at once.

The price of a plane, its multiplier λ in [0, Λ], is what another unit of separation would cost.
"""

from dataclasses import dataclass, fields

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

DEAREST = 50.0
"""Λ: fuel at which a plane is given up, r_col/Δt² a r_col; few ever cost more than 2."""

SMALL = 1e-9
"""What counts as 0 among the values of basic variables, r_col."""

NO_PIVOT = 1e-11
"""Entries of a tableau under which nothing is divided by them."""

MOST_PIVOTS = 200
"""Pivots of a program after which it is left as it is."""

PACKED = 0.75
"""Share of craft that still pivot under which the others are taken out of the tableau."""


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
        return (rise / gain.abs().clamp(min=SMALL)).amin(dim=1)


@dataclass(frozen=True, eq=False)
class Optimum:
    """The optimum of each program.

    Attributes:
        controls: (N, m).
        price: of each plane, (N, p).
        change: of the controls with what each plane asks for, ∂u/∂d, (N, m, p), where wanted.
    """

    controls: Float[Tensor, "N m"]
    price: Float[Tensor, "N p"]
    change: Float[Tensor, "N m p"] | None


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
    own: Own, row: Float[Tensor, "N p m"], asked: Float[Tensor, "N p"], real: Bool[Tensor, "N p"]
) -> tuple[Float[Tensor, "N m"], Float[Tensor, "N p"]]:
    """Controls and prices of each craft's program.

    Gradients run from the controls to rows and what is asked for, as the optimum moves while its
    basis stays; prices have none.

    Args:
        own: its own optimum.
        row: g of each plane.
        asked: d of each plane.
        real: which planes there are; the others fill the table.
    """
    differentiable = row.requires_grad or asked.requires_grad
    found = solve(own, row.detach(), asked.detach(), real, differentiable=differentiable)
    controls = found.controls
    if found.change is not None:
        more = asked - asked.detach() - ((row - row.detach()) @ controls[:, :, None])[:, :, 0]
        controls = controls + (found.change @ more[:, :, None])[:, :, 0]
    return controls, found.price


@torch.no_grad()
def solve(
    own: Own,
    row: Float[Tensor, "N p m"],
    asked: Float[Tensor, "N p"],
    real: Bool[Tensor, "N p"],
    *,
    differentiable: bool = False,
) -> Optimum:
    """The optimum of each craft's program, with its change where it is wanted."""
    N, p, m = row.shape
    left = ((row @ own.controls[:, :, None])[:, :, 0] - asked).masked_fill_(~real, torch.inf)
    found = Optimum(
        own.controls.clone(),
        row.new_zeros(N, p),
        row.new_zeros(N, m, p) if differentiable else None,
    )
    craft = (left.amin(dim=1) < -SMALL).nonzero()[:, 0]  # others keep their own optimum
    if len(craft) == 0:
        return found
    tableau = _Tableau(own.of(craft), row[craft], left[craft], craft)
    for _ in range(MOST_PIVOTS):
        if not tableau.pivot(found):
            break
    tableau.write(slice(None), found)
    return found


class _Tableau:
    """x_B = value - body · x_N of the craft that still pivot; variables are controls, then q."""

    def __init__(self, own: Own, row: Tensor, left: Tensor, craft: Tensor) -> None:
        n, p, m = row.shape
        self.m = m
        inside = row.gather(2, own.basis[:, None, :].expand(n, p, 6))
        outside = row.gather(2, own.others[:, None, :].expand(n, p, m - 6))
        self.body = torch.cat([own.tableau, inside @ own.tableau - outside], dim=1)
        self.value = torch.cat([own.controls.gather(1, own.basis), left], dim=1)
        self.side = torch.cat([own.side, torch.ones_like(left)], dim=1)
        number = torch.arange(m, m + p, device=row.device)
        self.basic = torch.cat([own.basis, number.expand(n, p)], dim=1)
        self.other, self.cost, self.craft = own.others.clone(), own.cost.clone(), craft
        # Slopes of the cost on either side of 0.
        self.low = torch.cat([row.new_full((m,), -1.0), row.new_full((p,), -DEAREST)])
        self.high = torch.cat([row.new_ones(m), row.new_zeros(p)])

    def pivot(self, found: Optimum) -> bool:
        """One step of the dual simplex method for every craft; whether any had one to make."""
        worst, leaving = (-self.value * self.side).max(dim=1)
        busy = worst > SMALL
        going = int(busy.sum())
        if going == 0:
            return False
        if going < PACKED * len(busy):
            self.write(~busy, found)
            for name in ("body", "value", "side", "basic", "other", "cost", "craft"):
                setattr(self, name, getattr(self, name)[busy])
            leaving, busy = leaving[busy], busy[busy]
        self._step(leaving, busy)
        return True

    def _step(self, leaving: Tensor, busy: Tensor) -> None:
        """A basic variable of each craft goes over to its other side, or another takes its place.

        Craft that are not busy do as the former, but for nothing.
        """
        at = torch.arange(len(leaving), device=leaving.device)
        side, row = self.side[at, leaving], self.body[at, leaving]
        slope = side[:, None] * row
        bound = torch.where(slope > 0, self.low[self.other], self.high[self.other])
        ratio = ((self.cost - bound) / slope).clamp_(min=0)
        least, entering = ratio.masked_fill_(slope.abs() < NO_PIVOT, torch.inf).min(dim=1)
        gone = self.basic[at, leaving]
        span = self.high[gone] - self.low[gone]
        step = torch.minimum(span, least) * busy
        self.cost -= step[:, None] * slope
        over = (span <= least) | ~busy
        self.side[at, leaving] = torch.where(over & busy, -side, side)
        slope_left = torch.where(side > 0, self.high[gone] - step, self.low[gone] + step)
        self._exchange(at, leaving, entering, ~over, slope_left)

    def _exchange(
        self, at: Tensor, leaving: Tensor, entering: Tensor, real: Tensor, slope: Tensor
    ) -> None:
        """Let basic variables go and others come, where it is real."""
        body, some = self.body, real[:, None]
        column, row = body[at, :, entering], body[at, leaving]
        pivot = torch.where(real, row[at, entering], 1.0)
        row = row / pivot[:, None]
        value = self.value[at, leaving] / pivot
        new_row = row.clone()
        new_row[at, entering] = 1 / pivot
        new_column = torch.where(some, -column / pivot[:, None], column)
        kept_row = torch.where(some, new_row, body[at, leaving])
        moved = torch.where(some, column, 0.0)
        body.addcmul_(moved[:, :, None], row[:, None, :], value=-1)
        body[at, :, entering] = new_column
        body[at, leaving] = kept_row
        kept_value = torch.where(real, value, self.value[at, leaving])
        self.value -= moved * value[:, None]
        self.value[at, leaving] = kept_value
        side = self.side[at, leaving]
        self.side[at, leaving] = torch.where(real, -(side * pivot).sign(), side)
        come, go = self.other[at, entering], self.basic[at, leaving]
        self.other[at, entering] = torch.where(real, go, come)
        self.basic[at, leaving] = torch.where(real, come, go)
        cost = self.cost[at, entering]
        self.cost[at, entering] = torch.where(real, slope, cost)

    def write(self, some: Tensor | slice, found: Optimum) -> None:
        """Write the optima of some of the craft."""
        craft, basic, other, m = self.craft[some], self.basic[some], self.other[some], self.m
        n, every = len(craft), len(self.low)
        value = self.value.new_zeros(n, every).scatter_(1, basic, self.value[some])
        found.controls[craft] = value[:, :m]
        slope = torch.where(self.side[some] > 0, self.high[basic], self.low[basic])
        dual = torch.zeros_like(value).scatter_(1, basic, slope).scatter_(1, other, self.cost[some])
        found.price[craft] = -dual[:, m:]
        if found.change is not None:
            # How basic controls go with what is left at a plane, in the columns of nonbasic q.
            part = value.new_zeros(n, every, m - 6)
            part.scatter_(1, basic[:, :, None].expand(-1, -1, m - 6), -self.body[some])
            whole = value.new_zeros(n, m, every)
            whole.scatter_(2, other[:, None, :].expand(n, m, m - 6), part[:, :m])
            found.change[craft] = whole[:, :, m:]
