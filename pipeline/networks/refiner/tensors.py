"""The refiner's rounds in batched torch operations, for a GPU and for the graphs of one craft.

What ``Encounters``, ``Sides`` and ``Decoupled`` compute by loops over craft and pairs, subclasses
here compute for all at once, on the device where their arrays are: the closest approach of cubics,
sums over the planes of a craft, the table of ``orbit.decoupled``, and the pivots of ``programs``.
None of it has gradients. For few craft that is slower than the compiled code by far.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from pipeline.arrays import Array, Bool, Float, Int, like, plain, tensor
from pipeline.errors import InputError
from pipeline.networks.device import torch_device
from pipeline.networks.refiner import geometry, model, programs
from pipeline.networks.refiner.arrays import where
from pipeline.networks.refiner.geometry import Grid, Sides, positions
from pipeline.orbit.decoupled import ROUNDING, Facets, facets_of
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import transfer_maps

PAIRS_AT_ONCE = 2_000_000  # pairs times intervals that are computed at once
PIVOTS_AT_ONCE = 4  # pivots of all programs, before those that are solved are left out


# Encounters: which craft come close to each other, and when.


class TensorEncounters(geometry.Encounters):
    """Encounters whose closest approaches are found all at once."""

    @property
    def sides(self) -> Sides:
        """Both sides of the separating plane of each encounter, by craft."""
        return PaddedSides.of(self.craft)

    def approaches(
        self,
        states: Float[Tensor, "N T 6"],
        within: Float[Tensor, "E"],
        before: geometry.EncounterGeometry,
        moved: Bool[Tensor, "N"],
    ) -> geometry.EncounterGeometry:
        """The closest approach of each encounter, of all at once; as ``geometry.Encounters``."""
        ends = self.relative(states)
        active = moved[self.first] | moved[self.second]
        share, minimum = before.share.masked_fill(active, 0.0), before.is_minimum & ~active
        distance = before.distance.masked_fill(active, torch.inf)
        which = (active & ~stays_beyond(ends, within)).nonzero()[:, 0]
        share[which] = nearest(ends[which])
        distance[which] = torch.linalg.vector_norm(positions(ends[which], share[which]), dim=1)
        minimum[which] = is_minimum(ends[which], share[which])
        return geometry.EncounterGeometry(share, distance, minimum)


def encounters(states: Float[Tensor, "N T 6"], n: int) -> TensorEncounters:
    """As ``geometry.encounters``, some swarms at a time."""
    within = geometry.considered(states, n)
    i, j = torch.triu_indices(n, n, 1, device=states.device)
    swarms, T = states.reshape(-1, n, *states.shape[1:]), states.shape[1]
    found, step = [], max(1, PAIRS_AT_ONCE // max(1, len(i) * T))
    for k in range(0, len(swarms), step):
        some = swarms[k : k + step]
        relative = some[:, i] - some[:, j]  # (b, pairs, T, 6)
        ends = torch.stack([relative[:, :, :-1], relative[:, :, 1:]], dim=3)
        reach = within[k : k + step, None, None].expand(ends.shape[:3])
        which = (~stays_beyond(ends.flatten(0, 2), reach.flatten())).nonzero()[:, 0]
        near = ends.flatten(0, 2)[which]
        closest = torch.linalg.vector_norm(positions(near, nearest(near)), dim=1)
        which = which[closest <= reach.flatten()[which]]
        swarm, pair = k + which // (len(i) * (T - 1)), which // (T - 1) % max(1, len(i))
        found.append(torch.stack([swarm * n + i[pair], swarm * n + j[pair], which % (T - 1)]))
    return TensorEncounters(*torch.cat(found, dim=1))


def stays_beyond(ends: Float[Tensor, "L 2 6"], within: Float[Tensor, "L"]) -> Bool[Tensor, "L"]:
    """Whether a lower bound of each pair's distance is beyond ``within``, as in ``geometry``."""
    (here, go), (there, arrive) = ends.reshape(-1, 2, 2, 3).permute(1, 2, 0, 3)
    middle = here + there
    corners = (here, here + geometry.THIRD * go, there - geometry.THIRD * arrive, there)
    least = torch.stack([(corner * middle).sum(dim=1) for corner in corners]).amin(dim=0)
    return (least > 0) & (least.square() > within.square() * middle.square().sum(dim=1))


def is_minimum(ends: Float[Tensor, "L 2 6"], share: Float[Tensor, "L"]) -> Bool[Tensor, "L"]:
    """Whether each pair's distance has a local minimum at its closest approach."""
    motion = Cubic.of(ends)
    gap, speed = motion.position(share), motion.velocity(share)
    along = (gap * speed).sum(dim=1) ** 2
    stationary = along <= geometry.LEVEL**2 * (gap**2).sum(dim=1) * (speed**2).sum(dim=1)
    return ((share > 0) & (share < 1)) | stationary


class Cubic(NamedTuple):
    """Coefficients of relative motion in an interval: p0 + v0 s + a2 s² + a3 s³, s from 0 to 1."""

    p0: Float[Tensor, "L 3"]
    v0: Float[Tensor, "L 3"]
    a2: Float[Tensor, "L 3"]
    a3: Float[Tensor, "L 3"]

    @classmethod
    def of(cls, ends: Float[Tensor, "L 2 6"]) -> "Cubic":
        """The cubic with these states at both ends."""
        (here, go), (there, arrive) = ends.reshape(-1, 2, 2, 3).permute(1, 2, 0, 3)
        way, faster = there - here, go + arrive
        return cls(here, go, 3 * way - go - faster, faster - 2 * way)

    def position(self, share: Float[Tensor, "*k L"]) -> Float[Tensor, "*k L 3"]:
        """Relative positions at shares of the interval."""
        s = share[..., None]
        return self.p0 + s * (self.v0 + s * (self.a2 + s * self.a3))

    def velocity(self, share: Float[Tensor, "L"]) -> Float[Tensor, "L 3"]:
        """Relative velocities at a share of the interval."""
        s = share[:, None]
        return self.v0 + s * (2 * self.a2 + s * (3 * self.a3))

    def acceleration(self, share: Float[Tensor, "L"]) -> Float[Tensor, "L 3"]:
        """Relative accelerations at a share of the interval."""
        return 2 * self.a2 + share[:, None] * (6 * self.a3)


def nearest(ends: Float[Tensor, "L 2 6"]) -> Float[Tensor, "L"]:
    """When each relative position is closest to 0, as a share of the interval."""
    motion, stretches = Cubic.of(ends), geometry.STRETCHES
    knots = torch.arange(stretches + 1, dtype=ends.dtype, device=ends.device)[:, None] / stretches
    knots = knots.expand(-1, ends.shape[0])
    here = motion.position(knots)
    way = here[1:] - here[:-1]
    length = way.square().sum(dim=2).clamp(min=torch.finfo(ends.dtype).tiny)
    share = (-(here[:-1] * way).sum(dim=2) / length).clamp(0.0, 1.0)
    times = torch.cat([knots, knots[:-1] + share / stretches])
    squares = motion.position(times).square().sum(dim=2)
    least = squares.amin(dim=0)
    s = when = times.gather(0, squares.argmin(dim=0, keepdim=True))[0]
    low, high = (when - 1 / stretches).clamp(min=0.0), (when + 1 / stretches).clamp(max=1.0)
    quarter, gap = (high - low) / 4, motion.position(s)
    for _ in range(geometry.NEWTON_STEPS):
        speed = motion.velocity(s)
        slope = (gap * speed).sum(dim=1)
        curvature = (speed.square() + gap * motion.acceleration(s)).sum(dim=1)
        step = torch.where(curvature > 0, slope / curvature, torch.sign(slope) * quarter)
        s = torch.minimum(torch.maximum(s - step, low), high)
        gap = motion.position(s)
        square = gap.square().sum(dim=1)
        when = torch.where(square <= least * geometry.EQUAL, s, when)
        least = torch.minimum(square, least)
    return when


# Sums over the planes of a craft.


class PaddedSides(Sides):
    """Sides in a table with a row for each craft, as long as the longest."""

    @cached_property
    def table(self) -> tuple[Int[Tensor, "C P"], Bool[Tensor, "C P"]]:
        """The sides of each craft, and which entries are sides and not padding."""
        most = int((self.start[1:] - self.start[:-1]).max())
        slot = self.start[:-1, None] + torch.arange(most, device=self.start.device)
        real = slot < self.start[1:, None]
        return self.order[slot.clamp(max=len(self.order) - 1)], real

    def by_craft(self, values: Float[Tensor, "S *k"]) -> Float[Tensor, "C P *k"]:
        """Values of sides as a table with a row for each craft, padded with 0."""
        side, real = self.table
        return values[side] * real.reshape(*real.shape, *[1] * (values.dim() - 1))

    def totals(self, values: Float[Tensor, "L 2"]) -> Float[Tensor, "L 2"]:
        """As ``Sides.totals``."""
        return self.by_craft(values.reshape(-1)).sum(dim=1)[self.place].reshape(values.shape)

    def aggregate(
        self, messages: Float[Tensor, "L 2 H"], free: Float[Tensor, "L m"]
    ) -> Float[Tensor, "L 2 _"]:
        """As ``Sides.aggregate``."""
        sent = self.by_craft(messages.flatten(0, 1))  # (C, P, H)
        plane = self.by_craft(torch.stack([free, -free], dim=1).flatten(0, 1))  # (C, P, m)
        weighted = plane @ (plane.mT @ sent)
        total = sent.sum(dim=1, keepdim=True).expand_as(weighted)
        received = torch.cat([weighted, total], dim=2)
        side, real = self.table
        result = received.new_zeros(len(self.order), received.shape[2])
        result[side[real]] = received[real]
        return result.reshape(*messages.shape[:2], -1)


# The decoupled optimum of each craft, by the table, and each craft's own program from there.


@dataclass(frozen=True, eq=False)
class TensorDecoupled(programs.Decoupled):
    """Decoupled optima from which programs are solved all at once."""

    def optima(
        self, sides: Sides, gain: Float[Tensor, "L m"], required: Float[Tensor, "L 2"]
    ) -> tuple[Float[Tensor, "C m"], Float[Tensor, "L 2"]]:
        """As ``programs.Decoupled.optima``."""
        assert isinstance(sides, PaddedSides)
        side, real = sides.table
        row = sides.by_craft(torch.stack([gain, -gain], dim=1).flatten(0, 1))
        controls, duals = self[sides.craft].solved(row, required.reshape(-1)[side], real)
        dual = torch.zeros_like(required).reshape(-1)
        dual[side[real]] = duals[real]
        return controls, dual.reshape(required.shape)

    def first_duals(
        self, craft: Int[Tensor, "k"], gain: Float[Tensor, "k m"]
    ) -> Float[Tensor, "k"]:
        """As ``programs.Decoupled.first_duals``."""
        return self[craft].first_ratios(gain[:, None])[:, 0]

    def first_ratios(self, row: Float[Tensor, "C p m"]) -> Float[Tensor, "C p"]:
        """The cost to each craft of the first unit along its rows: the dual simplex ratio."""
        moved, cost = -self._reduced(row), self.cost[:, None]
        rise = torch.where(moved > 0, 1 - cost, 1 + cost)
        # The sign of a rounding error has no meaning.
        rise = torch.where(moved.abs() < programs.SMALL, 1.0, rise)
        return (rise / moved.abs().clamp(min=programs.SMALL)).amin(dim=2)

    def _reduced(self, row: Float[Tensor, "C p m"]) -> Float[Tensor, "C p o"]:
        """Rows in terms of the nonbasic controls, negated as in a tableau."""
        basic, other = (_gather(row, one) for one in (self.basis, self.others))
        return basic @ self.tableau - other

    def solved(
        self, row: Float[Tensor, "C p m"], required: Float[Tensor, "C p"], real: Bool[Tensor, "C p"]
    ) -> tuple[Float[Tensor, "C m"], Float[Tensor, "C p"]]:
        """Controls and duals of each program, with planes g·u ≥ d where they are ``real``.

        The pivots are those of ``programs.solve_all``, in their order.
        """
        (C, p, m), new = row.shape, row.new_ones
        row = torch.where(real[..., None], row, 0.0)
        left = torch.where(real, (row @ self.controls[..., None])[..., 0] - required, 1.0)
        planes = torch.arange(m, m + p, device=row.device).expand(C, -1)
        begun = Tableau(
            torch.cat([self.tableau, self._reduced(row)], dim=1),
            torch.cat([self.controls.gather(1, self.basis), left], dim=1),
            torch.cat([self.side, torch.ones_like(left)], dim=1),
            torch.cat([self.basis, planes], dim=1),
            self.others.clone(),
            self.cost.clone(),
            torch.cat([self.basis >= 0, torch.zeros_like(real)], dim=1),
            torch.zeros(1, dtype=torch.long, device=row.device),
        )
        low = torch.cat([-new(m), -programs.LARGEST_DUAL * new(p)])
        high = torch.cat([new(m), 0 * new(p)])
        found = _repeat(lambda *parts: _pivot(Tableau(*parts), low, high), begun)
        slope = torch.where(found.side > 0, high[found.basic], low[found.basic])
        none = torch.zeros_like(low).expand(C, -1)
        every = none.scatter(1, found.basic, slope).scatter(1, found.other, found.cost)
        dual = -every[:, m:]
        controls = none.scatter(1, found.basic, found.value)[:, :m]
        return controls, dual.clamp(0.0, programs.LARGEST_DUAL)  # ties may take it beyond


def decoupled_optima(
    initial: Float[Tensor, "C 6"], goal: Float[Tensor, "C 6"], grid: Grid, problem: Problem
) -> TensorDecoupled:
    """As ``programs.decoupled_optima``."""
    device = initial.device
    units = initial.new_tensor([1.0] * 3 + [1 / problem.time_step] * 3)
    miss = (goal - initial @ grid.drift[-6:].T) * units
    (C, _), m = miss.shape, grid.reach.shape[1]
    table = facets_of(problem)
    inverse, side, basic = (
        _bases_by_programs(miss, problem) if table is None else _bases_by_table(miss, table)
    )
    inverse = inverse * problem.time_step**2
    is_basic = torch.zeros(C, m, dtype=torch.long, device=device).scatter(1, basic, 1)
    every = torch.arange(m, device=device)
    other = (every + m * is_basic).sort(dim=1).values.index_select(1, every[: m - 6])
    tableau = (inverse * units) @ grid.reach[-6:].T[other].mT
    value = (inverse @ miss[..., None])[..., 0]
    controls = miss.new_zeros(C, m).scatter(1, basic, value)
    return TensorDecoupled(controls, basic, other, side, tableau, (side[:, None] @ tableau)[:, 0])


def _bases_by_table(
    miss: Float[Tensor, "C 6"], table: Sequence[Facets]
) -> tuple[Float[Tensor, "C 6 6"], Float[Tensor, "C 6"], Int[Tensor, "C 6"]]:
    """Inverse of each craft's optimal basis, the sign of each basic control, and its index."""
    (C, _), device = miss.shape, miss.device
    inverse, side = miss.new_zeros(C, 6, 6), torch.zeros_like(miss)
    basic = torch.zeros_like(miss, dtype=torch.long)
    for facets in table:
        component = tensor(facets.component, device)
        facet, weights = _facet_met(facets, miss[:, component])
        its_side = tensor(facets.sign, device)[facet]
        part = miss.new_zeros(C, len(component), 6).index_copy(2, component, weights)
        inverse = inverse.index_copy(1, component, its_side[..., None] * part)
        basic = basic.index_copy(1, component, tensor(facets.column, device)[facet])
        side = side.index_copy(1, component, its_side)
    return inverse, side, basic


def _bases_by_programs(
    miss: Float[Tensor, "C 6"], problem: Problem
) -> tuple[Float[Tensor, "C 6 6"], Float[Tensor, "C 6"], Int[Tensor, "C 6"]]:
    """As ``_bases_by_table``, where the table would be too large."""
    reach, basis = transfer_maps(problem).reach[-1], programs.reaching(plain(miss), problem).basis
    m = reach.shape[1]
    inverse = np.linalg.inv(reach.T[basis % m].mT)
    side = np.where(basis < m, 1.0, -1.0)
    inverse, side, basic = (tensor(one, miss.device) for one in (inverse, side, basis % m))
    return inverse, side, basic


def _facet_met(
    facets: Facets, part: Float[Tensor, "C d"]
) -> tuple[Int[Tensor, "C"], Float[Tensor, "C d d"]]:
    """Index and weights of the facet of the hull that each craft's change of state meets."""
    table, dual = (tensor(one, part.device) for one in (facets.weights, facets.dual))
    value = part @ dual.T  # (C, F)
    first = value.argmax(dim=1)
    best = value.gather(1, first[:, None])
    # By an index an ONNX file would keep a transposed copy of the table for each use.
    weight = (table.index_select(0, first) @ part[..., None])[..., 0]
    wrong = weight.amin(dim=1) < -ROUNDING * weight.abs().sum(dim=1)

    def inner() -> Tensor:
        """Index of the facet with no negative weight, among those that meet the ray equally."""
        least = torch.einsum("fij,cj->cfi", table, part).amin(dim=2)
        near = value >= best - ROUNDING * best.abs()
        return torch.where(near, least, -torch.inf).argmax(dim=1)

    facet = where(wrong, inner, first)
    return facet, table.index_select(0, facet)


class Tableau(NamedTuple):
    """Simplex tableaus of C programs with b basic and o nonbasic variables."""

    body: Float[Tensor, "C b o"]
    value: Float[Tensor, "C b"]
    side: Float[Tensor, "C b"]
    basic: Int[Tensor, "C b"]
    other: Int[Tensor, "C o"]
    cost: Float[Tensor, "C o"]
    there: Bool[Tensor, "C b"]  # rows of controls, and of planes once an optimum violated them
    pivots: Int[Tensor, "1"]  # number of pivots so far


def _gather(values: Tensor, index: Int[Tensor, "C k"]) -> Tensor:
    """The entries of each program's rows in the given columns."""
    return values.gather(2, index[:, None].expand(-1, values.shape[1], -1))


def _repeat(pivot: Callable[..., Tableau], now: Tableau) -> Tableau:
    """Pivots until every program is solved; in a traced graph, as one loop."""
    if torch.compiler.is_exporting():
        loop = torch.while_loop(_any_infeasible, lambda *parts: tuple(pivot(*parts)), tuple(now))  # type: ignore[no-untyped-call]
        return Tableau(*loop)
    each, pivots = now[:-1], now.pivots
    going = _infeasible(now).nonzero()[:, 0]
    while len(going) and pivots < programs.MOST_PIVOTS:
        some = Tableau(*[*(values[going] for values in each), pivots])
        for _ in range(PIVOTS_AT_ONCE):
            some = pivot(*some)
        for values, changed in zip(each, some, strict=False):
            values[going] = changed
        going, pivots = going[_infeasible(some)], some.pivots
    return Tableau(*each, pivots)


def _infeasible(now: Tableau) -> Bool[Tensor, "C"]:
    """Whether each program has a basic variable on the wrong side of its kink."""
    return (-now.value * now.side).amax(dim=1) > programs.SMALL


def _any_infeasible(*parts: Tensor) -> Tensor:
    now = Tableau(*parts)
    return _infeasible(now).any() & (now.pivots[0] < programs.MOST_PIVOTS)


def _pivot(now: Tableau, low: Tensor, high: Tensor) -> Tableau:
    """One step: the worst infeasible variable changes side or leaves; solved programs stay."""
    body, value, side, basic, other, cost, there, count = now
    off = -value * side
    wrong = off > programs.SMALL
    there = there | (wrong & ~(wrong & there).any(dim=1, keepdim=True))
    worst, leaving = off.masked_fill(~there, -torch.inf).max(dim=1, keepdim=True)  # (C, 1)
    infeasible = worst > programs.SMALL
    row = body.gather(1, leaving[..., None].expand(-1, -1, body.shape[2]))[:, 0]  # (C, o)
    gone, its_side = basic.gather(1, leaving), side.gather(1, leaving)
    slope, size = its_side * row, row.abs()
    bound = torch.where(slope > 0, low[other], high[other])
    ratio = ((cost - bound) / slope).clamp(min=0)
    ratio = ratio.masked_fill(size < programs.NO_PIVOT, torch.inf)
    tied = ratio <= ratio.amin(dim=1, keepdim=True) + programs.TIE
    steepest = (size * tied).amax(dim=1, keepdim=True)
    tied = tied & (size >= programs.STEEP * steepest)
    come, entering = other.masked_fill(~tied, len(low)).min(dim=1, keepdim=True)
    here, span = ratio.gather(1, entering), high[gone] - low[gone]
    over, step = span <= here, torch.minimum(span, here)
    exchanged = infeasible & ~over
    cost = torch.where(infeasible, cost - step * slope, cost)
    pivot = row.gather(1, entering).masked_fill(~exchanged, 1.0)
    out = torch.where(over, -its_side, -torch.sign(its_side * pivot))
    kept = torch.where(its_side > 0, high[gone] - step, low[gone] + step)
    # An exchange is a change of the tableau by one product, once 1 is taken and added at the pivot.
    share = _gather(body, entering)[..., 0].scatter_add(1, leaving, -torch.ones_like(pivot)) / pivot
    share = share * exchanged
    line = row.scatter_add(1, entering, torch.ones_like(pivot))
    return Tableau(
        body - share[..., None] * line[:, None],
        value - share * value.gather(1, leaving),
        side.scatter(1, leaving, torch.where(infeasible, out, its_side)),
        basic.scatter(1, leaving, torch.where(exchanged, come, gone)),
        other.scatter(1, entering, torch.where(exchanged, gone, other.gather(1, entering))),
        cost.scatter(1, entering, torch.where(exchanged, kept, cost.gather(1, entering))),
        there,
        count + 1,
    )


# Plans on a device.


def planned_on(
    trained: model.TrainedRefiner,
    initial: Float[Any, "b n 6"],
    goal: Float[Any, "b n 6"],
    radius: Float[Any, "b"],
) -> Float[Array, "N m"]:
    """Controls that the refiner finds on its device for all craft of several swarms, in r_col/Δt².

    By ``model.cheapest_safe``. InputError where that is not available, or has too little memory.
    """
    device, weights = trained.device or "cpu", trained.weights
    try:
        data = problem_data(trained.problem, initial, goal, radius, torch_device(device))
        if weights is not None:
            weights = {name: like(values, data.initial) for name, values in weights.items()}
        return plain(model.cheapest_safe(weights, data, trained.rounds)[0])
    except torch.OutOfMemoryError as error:
        raise InputError(
            f"device {device} has too little memory left for {len(initial)} swarms of "
            f"{initial.shape[1]} craft; expected more: end what else runs there, or leave it out."
        ) from error


def problem_data(
    problem: Problem,
    initial: Float[Any, "b n 6"],
    goal: Float[Any, "b n 6"],
    radius: Float[Any, "b"],
    device: torch.device,
) -> model.ProblemData:
    """As ``model.problem_data``, all of which is on a device."""
    grid, n = geometry.grid_of(problem, device), initial.shape[1]
    ends = (geometry.in_units(states, radius, problem) for states in (initial, goal))
    begin, end = (tensor(states, device) for states in ends)
    own = decoupled_optima(begin, end, grid, problem)
    met = encounters(grid.fly(begin, own.controls), n)
    return model.ProblemData(grid, n, begin, own, met, met.first // n)
