"""The program of one craft as a loop of pivots that can be traced: ``program.solve`` for one.

The steps are those of ``refiner.pivots``, but on tensors, and nothing is written in place.
"""

from collections.abc import Callable

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from pipeline.networks.refiner.pivots import MOST_PIVOTS, NO_PIVOT, SMALL, STEEP, TIE
from pipeline.networks.refiner.program import DEAREST, Own

State = tuple[Tensor, ...]
"""Of a tableau with b basic and o other variables: body (b, o), value (b,), side (b,), basic (b,),
other (o,), cost (o,), and how often it has pivoted, (1,)."""


def solve_one(
    own: Own, row: Float[Tensor, "p m"], asked: Float[Tensor, "p"], real: Bool[Tensor, "p"]
) -> tuple[Float[Tensor, "m"], Float[Tensor, "p"]]:
    """Controls and prices of one craft's program.

    Args:
        own: its own optimum, N = 1.
        row: g of each plane.
        asked: d of each plane.
        real: which planes there are.
    """
    p, m = row.shape
    state = _begin(own, torch.where(real[:, None], row, 0.0), asked, real)
    low = torch.cat([row.new_full((m,), -1.0), row.new_full((p,), -DEAREST)])
    high = torch.cat([row.new_ones(m), row.new_zeros(p)])

    def pivot(*now: Tensor) -> State:
        return _pivot(now, low, high)

    _, value, side, basic, other, cost, _ = _repeat(_goes_on, pivot, state)
    every = torch.zeros_like(low)
    controls = every.scatter(0, basic, value)[:m]
    slope = torch.where(side > 0, high[basic], low[basic])
    price = -every.scatter(0, basic, slope).scatter(0, other, cost)[m:]
    return controls, price.clamp(0.0, DEAREST)  # ties may take it beyond


def _repeat(goes_on: Callable[..., Tensor], pivot: Callable[..., State], state: State) -> State:
    """Pivots as long as it goes on; where it is traced, as one loop of the graph."""
    if torch.compiler.is_exporting():
        return torch.while_loop(goes_on, pivot, state)  # type: ignore[no-untyped-call]
    while goes_on(*state):
        state = pivot(*state)
    return state


def _begin(own: Own, row: Tensor, asked: Tensor, real: Tensor) -> State:
    """The tableau at the own optimum; a plane that is not real is met and stays so."""
    p, m = row.shape
    left = torch.where(real, row @ own.controls[0] - asked, 1.0)
    body = row[:, own.basis[0]] @ own.tableau[0] - row[:, own.others[0]]
    return (
        torch.cat([own.tableau[0], body]),
        torch.cat([own.controls[0][own.basis[0]], left]),
        torch.cat([own.side[0], torch.ones_like(left)]),
        torch.cat([own.basis[0], torch.arange(m, m + p, device=row.device)]),
        own.others[0].clone(),
        own.cost[0].clone(),
        torch.zeros(1, dtype=torch.long, device=row.device),
    )


def _goes_on(*now: Tensor) -> Tensor:
    """Whether a basic variable is on the wrong side of its kink."""
    _, value, side, _, _, _, count = now
    return ((-value * side).max() > SMALL) & (count[0] < MOST_PIVOTS)


def _pivot(now: State, low: Tensor, high: Tensor) -> State:
    """One step: the worst variable goes over to its other side, or another takes its place."""
    body, value, side, basic, other, cost, count = now
    leaving = (-value * side).argmax(dim=0, keepdim=True)  # (1,)
    row, gone, its_side = body[leaving][0], basic[leaving], side[leaving]
    slope = its_side * row
    bound = torch.where(slope > 0, low[other], high[other])
    ratio = ((cost - bound) / slope).clamp(min=0)
    ratio = torch.where(slope.abs() < NO_PIVOT, torch.inf, ratio)
    tied = ratio <= ratio.amin(dim=0) + TIE
    tied = tied & (slope.abs() >= STEEP * torch.where(tied, slope.abs(), 0.0).amax(dim=0))
    entering = torch.where(tied, other, len(low)).argmin(dim=0, keepdim=True)
    here, span = ratio[entering], high[gone] - low[gone]
    over = span <= here
    step = torch.minimum(span, here)
    cost = cost - step * slope
    pivot = torch.where(over, 1.0, row[entering])
    come = other[entering]
    out = torch.where(over, -its_side, -torch.sign(its_side * pivot))
    kept = torch.where(its_side > 0, high[gone] - step, low[gone] + step)
    return (
        torch.where(over, body, _exchanged(body, row, leaving, entering, pivot)),
        torch.where(over, value, _moved(value, body, leaving, entering, pivot)),
        side.scatter(0, leaving, out),
        basic.scatter(0, leaving, torch.where(over, gone, come)),
        other.scatter(0, entering, torch.where(over, come, gone)),
        cost.scatter(0, entering, torch.where(over, cost[entering], kept)),
        count + 1,
    )


def _exchanged(
    body: Tensor, row: Tensor, leaving: Tensor, entering: Tensor, pivot: Tensor
) -> Tensor:
    """The tableau after an exchange."""
    column = body[:, entering]  # (b, 1)
    new_row = (row / pivot).scatter(0, entering, 1 / pivot)
    new = body - column * (row / pivot)
    new = new.scatter(1, entering.expand(body.shape[0], 1), -column / pivot)
    return new.scatter(0, leaving[:, None].expand(1, row.shape[0]), new_row[None])


def _moved(value: Tensor, body: Tensor, leaving: Tensor, entering: Tensor, pivot: Tensor) -> Tensor:
    """The values after an exchange."""
    new = value[leaving] / pivot
    return (value - body[:, entering][:, 0] * new).scatter(0, leaving, new)
