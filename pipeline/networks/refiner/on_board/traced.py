"""What is compiled for a swarm, for one craft and by torch alone, so that it can be traced.

``nearest`` is that of ``refiner.nearest``, ``decoupled_optimum`` looks up the table of
``orbit.decoupled``, and ``solve_one`` takes the pivots of ``refiner.simplex``. A graph has no
branches, so each computes all cases and chooses among them; for many craft that would be slower
than the compiled code by far.
"""

from collections.abc import Callable
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from pipeline.errors import InputError
from pipeline.networks.refiner.geometry import Grid, accelerations, positions, velocities
from pipeline.networks.refiner.nearest import LEVEL, NEWTON_STEPS, STRETCHES
from pipeline.networks.refiner.programs import LARGEST_DUAL
from pipeline.networks.refiner.simplex import MOST_PIVOTS, NO_PIVOT, SMALL, STEEP, TIE
from pipeline.orbit.decoupled import ROUNDING, Facets, facets_of
from pipeline.orbit.problem import Problem


def turns(ends: Float[Tensor, "L 2 6"], share: Float[Tensor, "L"]) -> Bool[Tensor, "L"]:
    """Whether each pair comes closer before and parts after its closest approach."""
    gap, speed = positions(ends, share), velocities(ends, share)
    along = (gap * speed).sum(dim=1) ** 2
    level = along <= LEVEL**2 * (gap**2).sum(dim=1) * (speed**2).sum(dim=1)
    return ((share > 0) & (share < 1)) | level


def nearest(ends: Float[Tensor, "L 2 6"]) -> Float[Tensor, "L"]:
    """When each relative position is closest to 0, as a share of the interval."""
    knots = torch.arange(STRETCHES + 1, dtype=ends.dtype)[:, None] / STRETCHES
    knots = knots.expand(-1, ends.shape[0])
    here = positions(ends, knots)
    way = here[1:] - here[:-1]
    length = way.square().sum(dim=2).clamp(min=torch.finfo(ends.dtype).tiny)
    share = (-(here[:-1] * way).sum(dim=2) / length).clamp(0.0, 1.0)
    times = torch.cat([knots, knots[:-1] + share / STRETCHES])
    squares = positions(ends, times).square().sum(dim=2)
    least = squares.amin(dim=0)
    s = when = times.gather(0, squares.argmin(dim=0, keepdim=True))[0]
    low, high = (when - 1 / STRETCHES).clamp(min=0.0), (when + 1 / STRETCHES).clamp(max=1.0)
    for _ in range(NEWTON_STEPS):
        gap, speed = positions(ends, s), velocities(ends, s)
        slope = (gap * speed).sum(dim=1)
        curvature = (speed.square() + gap * accelerations(ends, s)).sum(dim=1)
        flat = torch.sign(slope) * (high - low) / 4
        step = torch.where(curvature > 0, slope / curvature, flat)
        s = torch.minimum(torch.maximum(s - step, low), high)
        square = positions(ends, s).square().sum(dim=1)
        when = torch.where(square < least, s, when)
        least = torch.minimum(square, least)
    return when


class Tableau(NamedTuple):
    """A craft's program with b basic and o other variables, as in ``refiner.simplex``."""

    body: Float[Tensor, "b o"]
    value: Float[Tensor, "b"]
    side: Float[Tensor, "b"]
    basic: Tensor  # (b,), whole numbers
    other: Tensor  # (o,), whole numbers
    cost: Float[Tensor, "o"]
    pivots: Tensor  # how many so far, (1,)

    def controls(self, m: int) -> Float[Tensor, "m"]:
        """The values of the m controls, which are the first variables."""
        every = self.value.new_zeros(self.basic.shape[0] + self.other.shape[0])
        return every.scatter(0, self.basic, self.value)[:m]


def decoupled_optimum(
    initial: Float[Tensor, "6"], goal: Float[Tensor, "6"], grid: Grid, problem: Problem
) -> Tableau:
    """The decoupled optimum in r_col and Δt, by table; InputError where a state is out of reach."""
    table = facets_of(problem)
    if table is None:
        raise InputError(f"no controls reach every state of {problem}; expected another time grid.")
    units = torch.tensor([1.0, 1 / grid.step], dtype=initial.dtype).repeat_interleave(3)
    miss = (goal - grid.drift[-6:] @ initial) * units
    m = grid.reach.shape[1]
    inverse, side = miss.new_zeros(6, 6), torch.zeros_like(miss)
    basic = torch.zeros(6, dtype=torch.long)
    for facets in table:
        component = torch.from_numpy(facets.component)
        facet, weights = _met(facets, miss[component])
        its_side = torch.from_numpy(facets.sign)[facet][0]
        part = miss.new_zeros(len(component), 6).index_copy(1, component, weights)
        inverse = inverse.index_copy(0, component, its_side[:, None] * part)
        basic = basic.index_copy(0, component, torch.from_numpy(facets.column)[facet][0])
        side = side.index_copy(0, component, its_side)
    inverse = inverse * grid.step**2
    is_basic = torch.zeros(m, dtype=torch.long).scatter(0, basic, 1)
    other = (torch.arange(m) + m * is_basic).sort().values[: m - 6]
    body = (inverse * units) @ grid.reach[-6:, other]
    none = torch.zeros(1, dtype=torch.long)
    return Tableau(body, inverse @ miss, side, basic, other, side @ body, none)


def _met(facets: Facets, part: Float[Tensor, "d"]) -> tuple[Tensor, Float[Tensor, "d d"]]:
    """The facet that the ray meets, (1,), and its weights, as ``orbit.decoupled`` chooses it."""
    table, dual = torch.from_numpy(facets.weights), torch.from_numpy(facets.dual)
    value, weight = dual @ part, table @ part  # (F,), (F, d)
    first = value.argmax(dim=0, keepdim=True)
    near = value >= value[first] - ROUNDING * value[first].abs()
    inner = torch.where(near, weight.amin(dim=1), -torch.inf).argmax(dim=0, keepdim=True)
    wrong = weight[first].min() < -ROUNDING * weight[first].abs().sum()
    facet = torch.where(wrong, inner, first)
    return facet, table[facet][0]


def first_duals(own: Tableau, gain: Float[Tensor, "P m"]) -> Float[Tensor, "P"]:
    """What the first unit along each row costs the craft: the dual simplex ratio."""
    moved = gain[:, own.other] - gain[:, own.basic] @ own.body
    rise = torch.where(moved > 0, 1 - own.cost, 1 + own.cost)
    rise = torch.where(moved.abs() < SMALL, 1.0, rise)  # the sign of rounding says nothing
    return (rise / moved.abs().clamp(min=SMALL)).amin(dim=1)


def solve_one(
    own: Tableau, row: Float[Tensor, "p m"], asked: Float[Tensor, "p"], real: Bool[Tensor, "p"]
) -> tuple[Float[Tensor, "m"], Float[Tensor, "p"]]:
    """Controls and duals of one craft's program with planes g·u ≥ d where they are ``real``."""
    p, m = row.shape
    row = torch.where(real[:, None], row, 0.0)
    left = torch.where(real, row @ own.controls(m) - asked, 1.0)
    now = Tableau(
        torch.cat([own.body, row[:, own.basic] @ own.body - row[:, own.other]]),
        torch.cat([own.value, left]),
        torch.cat([own.side, torch.ones_like(left)]),
        torch.cat([own.basic, torch.arange(m, m + p)]),
        own.other.clone(),
        own.cost.clone(),
        own.pivots.clone(),
    )
    low = torch.cat([row.new_full((m,), -1.0), row.new_full((p,), -LARGEST_DUAL)])
    high = torch.cat([row.new_ones(m), row.new_zeros(p)])
    found = _repeat(_goes_on, lambda *parts: _pivot(Tableau(*parts), low, high), now)
    slope = torch.where(found.side > 0, high[found.basic], low[found.basic])
    every = torch.zeros_like(low).scatter(0, found.basic, slope)
    dual = -every.scatter(0, found.other, found.cost)[m:]
    return found.controls(m), dual.clamp(0.0, LARGEST_DUAL)  # ties may take it beyond


def _repeat(goes_on: Callable[..., Tensor], pivot: Callable[..., Tableau], now: Tableau) -> Tableau:
    """Pivots as long as it goes on; where it is traced, as one loop of the graph."""
    if torch.compiler.is_exporting():
        loop = torch.while_loop(goes_on, lambda *parts: tuple(pivot(*parts)), tuple(now))  # type: ignore[no-untyped-call]
        return Tableau(*loop)
    while goes_on(*now):
        now = pivot(*now)
    return now


def _goes_on(*parts: Tensor) -> Tensor:
    """Whether a basic variable is on the wrong side of its kink."""
    now = Tableau(*parts)
    return ((-now.value * now.side).max() > SMALL) & (now.pivots[0] < MOST_PIVOTS)


def _pivot(now: Tableau, low: Tensor, high: Tensor) -> Tableau:
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
    over, step = span <= here, torch.minimum(span, here)
    cost = cost - step * slope
    pivot = torch.where(over, 1.0, row[entering])
    come = other[entering]
    out = torch.where(over, -its_side, -torch.sign(its_side * pivot))
    kept = torch.where(its_side > 0, high[gone] - step, low[gone] + step)
    # An exchange is a change of the tableau by one product, once 1 is taken and added at the pivot.
    share = body[:, entering][:, 0].scatter_add(0, leaving, -torch.ones_like(pivot)) / pivot
    share = torch.where(over, 0.0, share)
    return Tableau(
        body - share[:, None] * row.scatter_add(0, entering, torch.ones_like(pivot)),
        value - share * value[leaving],
        side.scatter(0, leaving, out),
        basic.scatter(0, leaving, torch.where(over, gone, come)),
        other.scatter(0, entering, torch.where(over, come, gone)),
        cost.scatter(0, entering, torch.where(over, cost[entering], kept)),
        count + 1,
    )
