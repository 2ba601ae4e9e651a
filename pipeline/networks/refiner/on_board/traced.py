"""What is compiled for a swarm, for one craft and by torch alone, so that it can be traced.

``nearest`` is that of ``refiner.nearest``, ``decoupled_optimum`` looks up the table of
``orbit.decoupled``, and ``solve_one`` takes the pivots of ``refiner.simplex``. A graph has no
branches, so each computes all cases and chooses among them; for many craft that would be slower
than the compiled code by far.
"""

from collections.abc import Callable

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from pipeline.errors import InputError
from pipeline.networks.refiner.geometry import Grid
from pipeline.networks.refiner.nearest import LEVEL, NEWTON_STEPS, STRETCHES
from pipeline.networks.refiner.programs import LARGEST_DUAL, Decoupled
from pipeline.networks.refiner.simplex import MOST_PIVOTS, NO_PIVOT, SMALL, STEEP, TIE
from pipeline.orbit.decoupled import ROUNDING, Facets, facets_of
from pipeline.orbit.problem import Problem

Cubic = tuple[Tensor, Tensor, Tensor, Tensor]
"""p0, v0, a2, a3 of the relative position p0 + v0 s + a2 s² + a3 s³, each (L, 3)."""


def cubic(ends: Float[Tensor, "L 2 6"]) -> Cubic:
    """The cubic of relative motion between states at both ends of an interval."""
    p0, v0, p1, v1 = ends[:, 0, :3], ends[:, 0, 3:], ends[:, 1, :3], ends[:, 1, 3:]
    return p0, v0, 3 * (p1 - p0) - 2 * v0 - v1, 2 * (p0 - p1) + v0 + v1


def position(motion: Cubic, share: Float[Tensor, "L"]) -> Float[Tensor, "L 3"]:
    """Value of the cubic."""
    (p0, v0, a2, a3), s = motion, share[:, None]
    return p0 + s * (v0 + s * (a2 + s * a3))


def velocity(motion: Cubic, share: Float[Tensor, "L"]) -> Float[Tensor, "L 3"]:
    """Derivative of the cubic."""
    (_, v0, a2, a3), s = motion, share[:, None]
    return v0 + s * (2 * a2 + 3 * s * a3)


def turns(motion: Cubic, share: Float[Tensor, "L"]) -> Bool[Tensor, "L"]:
    """Whether the pair comes closer before and parts after its closest approach."""
    gap, speed = position(motion, share), velocity(motion, share)
    along = (gap * speed).sum(dim=1) ** 2
    level = along <= LEVEL**2 * (gap**2).sum(dim=1) * (speed**2).sum(dim=1)
    return ((share > 0) & (share < 1)) | level


def nearest(motion: Cubic) -> Float[Tensor, "k"]:
    """When the cubic is closest to 0, as a share of the interval."""
    times = _looked_at(motion)
    squares = torch.stack([_derivatives(motion, s)[0] for s in times])
    first, least = squares.argmin(dim=0, keepdim=True), squares.amin(dim=0)
    when = torch.stack(times).gather(0, first)[0]
    low, high = (when - 1 / STRETCHES).clamp(min=0.0), (when + 1 / STRETCHES).clamp(max=1.0)
    s = when
    for _ in range(NEWTON_STEPS):
        _, slope, curvature = _derivatives(motion, s)
        flat = torch.sign(slope) * (high - low) / 4
        step = torch.where(curvature > 0, slope / curvature, flat)
        s = torch.minimum(torch.maximum(s - step, low), high)
        square, _, _ = _derivatives(motion, s)
        when = torch.where(square < least, s, when)
        least = torch.minimum(square, least)
    return when


def _looked_at(motion: Cubic) -> list[Float[Tensor, "k"]]:
    """Both ends of every stretch, and where the straight way between them is closest to 0."""
    zero = torch.zeros_like(motion[0][:, 0])
    times = [zero]
    for stretch in range(STRETCHES):
        begin, end = stretch / STRETCHES, (stretch + 1) / STRETCHES
        here = position(motion, zero + begin)
        way = position(motion, zero + end) - here
        length = way.square().sum(dim=1)
        share = (-(here * way).sum(dim=1) / length).clamp(0.0, 1.0)
        share = torch.where(length > 0, share, 0.0)
        times += [begin + share * (end - begin), zero + end]
    return times


def _derivatives(motion: Cubic, s: Float[Tensor, "k"]) -> tuple[Tensor, Tensor, Tensor]:
    """|p|², and half its first two derivatives, each (k,)."""
    _, _, a2, a3 = motion
    p, v = position(motion, s), velocity(motion, s)
    curvature = v.square() + p * (2 * a2 + 6 * s[:, None] * a3)
    return p.square().sum(dim=1), (p * v).sum(dim=1), curvature.sum(dim=1)


def decoupled_optimum(
    initial: Float[Tensor, "1 6"], goal: Float[Tensor, "1 6"], grid: Grid, problem: Problem
) -> Decoupled:
    """The decoupled optimum in r_col and Δt, N = 1.

    The weights of the facet that is met are B⁻¹ but for units, so no equations are solved.

    Raises:
        InputError: for a problem whose controls do not reach every state.
    """
    table = facets_of(problem)
    if table is None:
        raise InputError(f"no controls reach every state of {problem}; expected another time grid.")
    units = torch.tensor([1.0, 1 / grid.step], dtype=initial.dtype).repeat_interleave(3)
    miss = ((goal - initial @ grid.drift[-6:].T)[0] * units).to(initial.dtype)
    m = grid.reach.shape[1]
    inverse, side = miss.new_zeros(6, 6), torch.zeros_like(miss)
    basis = torch.zeros(6, dtype=torch.long)
    for facets in table:
        component = torch.from_numpy(facets.component)
        facet, weights = _met(facets, miss[component])
        its_side = torch.from_numpy(facets.sign)[facet][0]
        part = miss.new_zeros(len(component), 6).index_copy(1, component, weights)
        inverse = inverse.index_copy(0, component, its_side[:, None] * part)
        basis = basis.index_copy(0, component, torch.from_numpy(facets.column)[facet][0])
        side = side.index_copy(0, component, its_side)
    inverse = inverse * grid.step**2
    every = torch.arange(m)
    others = (every + m * torch.zeros(m, dtype=torch.long).scatter(0, basis, 1)).sort().values
    others = others[: m - 6]
    tableau = (inverse * units) @ grid.reach[-6:, others]
    controls = miss.new_zeros(m).scatter(0, basis, inverse @ miss)
    record = (controls, basis, others, side, tableau, side @ tableau)
    return Decoupled(*(part[None] for part in record))


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


def first_duals(own: Decoupled, gain: Float[Tensor, "P m"]) -> Float[Tensor, "P"]:
    """What the first unit along each row costs the craft: the dual simplex ratio."""
    moved = gain[:, own.others[0]] - gain[:, own.basis[0]] @ own.tableau[0]
    rise = torch.where(moved > 0, 1 - own.cost, 1 + own.cost)
    rise = torch.where(moved.abs() < SMALL, 1.0, rise)  # the sign of rounding says nothing
    return (rise / moved.abs().clamp(min=SMALL)).amin(dim=1)


Tableau = tuple[Tensor, ...]
"""With b basic and o other variables: body (b, o), value (b,), side (b,), basic (b,), other (o,),
cost (o,), and the number of pivots so far, (1,)."""


def solve_one(
    own: Decoupled, row: Float[Tensor, "p m"], asked: Float[Tensor, "p"], real: Bool[Tensor, "p"]
) -> tuple[Float[Tensor, "m"], Float[Tensor, "p"]]:
    """Controls and duals of one craft's program.

    Args:
        own: its decoupled optimum, N = 1.
        row: g of each plane.
        asked: d of each plane.
        real: which planes there are; the others are met and stay so.
    """
    p, m = row.shape
    row = torch.where(real[:, None], row, 0.0)
    left = torch.where(real, row @ own.controls[0] - asked, 1.0)
    body = row[:, own.basis[0]] @ own.tableau[0] - row[:, own.others[0]]
    tableau = (
        torch.cat([own.tableau[0], body]),
        torch.cat([own.controls[0][own.basis[0]], left]),
        torch.cat([own.side[0], torch.ones_like(left)]),
        torch.cat([own.basis[0], torch.arange(m, m + p, device=row.device)]),
        own.others[0].clone(),
        own.cost[0].clone(),
        torch.zeros(1, dtype=torch.long, device=row.device),
    )
    low = torch.cat([row.new_full((m,), -1.0), row.new_full((p,), -LARGEST_DUAL)])
    high = torch.cat([row.new_ones(m), row.new_zeros(p)])

    def pivot(*now: Tensor) -> Tableau:
        return _pivot(now, low, high)

    _, value, side, basic, other, cost, _ = _repeat(_goes_on, pivot, tableau)
    every = torch.zeros_like(low)
    controls = every.scatter(0, basic, value)[:m]
    slope = torch.where(side > 0, high[basic], low[basic])
    dual = -every.scatter(0, basic, slope).scatter(0, other, cost)[m:]
    return controls, dual.clamp(0.0, LARGEST_DUAL)  # ties may take it beyond


def _repeat(goes_on: Callable[..., Tensor], pivot: Callable[..., Tableau], now: Tableau) -> Tableau:
    """Pivots as long as it goes on; where it is traced, as one loop of the graph."""
    if torch.compiler.is_exporting():
        return torch.while_loop(goes_on, pivot, now)  # type: ignore[no-untyped-call]
    while goes_on(*now):
        now = pivot(*now)
    return now


def _goes_on(*now: Tensor) -> Tensor:
    """Whether a basic variable is on the wrong side of its kink."""
    _, value, side, _, _, _, count = now
    return ((-value * side).max() > SMALL) & (count[0] < MOST_PIVOTS)


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
    over = span <= here
    step = torch.minimum(span, here)
    cost = cost - step * slope
    pivot = torch.where(over, 1.0, row[entering])
    come = other[entering]
    out = torch.where(over, -its_side, -torch.sign(its_side * pivot))
    kept = torch.where(its_side > 0, high[gone] - step, low[gone] + step)
    column, new_value = body[:, entering], value[leaving] / pivot  # (b, 1), (1,)
    new_row = (row / pivot).scatter(0, entering, 1 / pivot)
    new_body = body - column * (row / pivot)
    new_body = new_body.scatter(1, entering.expand(body.shape[0], 1), -column / pivot)
    new_body = new_body.scatter(0, leaving[:, None].expand(1, row.shape[0]), new_row[None])
    new_values = (value - column[:, 0] * new_value).scatter(0, leaving, new_value)
    return (
        torch.where(over, body, new_body),
        torch.where(over, value, new_values),
        side.scatter(0, leaving, out),
        basic.scatter(0, leaving, torch.where(over, gone, come)),
        other.scatter(0, entering, torch.where(over, come, gone)),
        cost.scatter(0, entering, torch.where(over, cost[entering], kept)),
        count + 1,
    )
