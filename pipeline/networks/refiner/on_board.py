"""The part of a refiner that one craft runs, in steps, after which it tells others some results.

``Begin`` and ``Meet`` come once a transfer; ``Look``, ``Speak``, ``Listen`` and ``Settle`` are a
round. All encounters of the craft, P in all, stay in their places over the rounds; those that are
not live get no plane, and of them only ``Settle`` tells anything. The formulas are those of
``refiner.model``, of which a craft runs its own side: it is the first craft of each pair. Names of
inputs and outputs are those of the files that are exported, and do not change.

What is compiled for a swarm stands here once more by torch alone, so that it can be traced:
``nearest`` of ``refiner.geometry``, the table of ``orbit.decoupled`` in ``decoupled_optimum``, and
the pivots of ``refiner.programs`` in ``solve_one``. A graph has no branches, so each computes all
cases and chooses among them; for many craft that would be slower than the compiled code by far.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import prod
from types import SimpleNamespace
from typing import NamedTuple

import torch
from torch import Tensor, nn

from pipeline.arrays import Bool, Float
from pipeline.errors import InputError
from pipeline.networks.refiner import geometry, model, programs
from pipeline.networks.refiner.geometry import Grid, Scene, accelerations, positions, velocities
from pipeline.networks.refiner.refiner import MessagePassing
from pipeline.orbit.decoupled import ROUNDING, Facets, facets_of
from pipeline.orbit.problem import Problem

# What is compiled for a swarm, for one craft and by torch alone.


def turns(ends: Float[Tensor, "L 2 6"], share: Float[Tensor, "L"]) -> Bool[Tensor, "L"]:
    """Whether each pair comes closer before and parts after its closest approach."""
    gap, speed = positions(ends, share), velocities(ends, share)
    along = (gap * speed).sum(dim=1) ** 2
    level = along <= geometry.LEVEL**2 * (gap**2).sum(dim=1) * (speed**2).sum(dim=1)
    return ((share > 0) & (share < 1)) | level


def nearest(ends: Float[Tensor, "L 2 6"]) -> Float[Tensor, "L"]:
    """When each relative position is closest to 0, as a share of the interval."""
    stretches = geometry.STRETCHES
    knots = torch.arange(stretches + 1, dtype=ends.dtype)[:, None] / stretches
    knots = knots.expand(-1, ends.shape[0])
    here = positions(ends, knots)
    way = here[1:] - here[:-1]
    length = way.square().sum(dim=2).clamp(min=torch.finfo(ends.dtype).tiny)
    share = (-(here[:-1] * way).sum(dim=2) / length).clamp(0.0, 1.0)
    times = torch.cat([knots, knots[:-1] + share / stretches])
    squares = positions(ends, times).square().sum(dim=2)
    least = squares.amin(dim=0)
    s = when = times.gather(0, squares.argmin(dim=0, keepdim=True))[0]
    low, high = (when - 1 / stretches).clamp(min=0.0), (when + 1 / stretches).clamp(max=1.0)
    for _ in range(geometry.NEWTON_STEPS):
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
    """A craft's program with b basic and o other variables, as in ``refiner.programs``."""

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
    """Index (1,) and weights of the facet that a ray meets, chosen as in ``orbit.decoupled``."""
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
    rise = torch.where(moved.abs() < programs.SMALL, 1.0, rise)  # the sign of rounding says nothing
    return (rise / moved.abs().clamp(min=programs.SMALL)).amin(dim=1)


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
    low = torch.cat([row.new_full((m,), -1.0), row.new_full((p,), -programs.LARGEST_DUAL)])
    high = torch.cat([row.new_ones(m), row.new_zeros(p)])
    found = _repeat(_goes_on, lambda *parts: _pivot(Tableau(*parts), low, high), now)
    slope = torch.where(found.side > 0, high[found.basic], low[found.basic])
    every = torch.zeros_like(low).scatter(0, found.basic, slope)
    dual = -every.scatter(0, found.other, found.cost)[m:]
    return found.controls(m), dual.clamp(0.0, programs.LARGEST_DUAL)  # ties may take it beyond


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
    return ((-now.value * now.side).max() > programs.SMALL) & (now.pivots[0] < programs.MOST_PIVOTS)


def _pivot(now: Tableau, low: Tensor, high: Tensor) -> Tableau:
    """One step: the worst variable goes over to its other side, or another takes its place."""
    body, value, side, basic, other, cost, count = now
    leaving = (-value * side).argmax(dim=0, keepdim=True)  # (1,)
    row, gone, its_side = body[leaving][0], basic[leaving], side[leaving]
    slope = its_side * row
    bound = torch.where(slope > 0, low[other], high[other])
    ratio = ((cost - bound) / slope).clamp(min=0)
    ratio = torch.where(slope.abs() < programs.NO_PIVOT, torch.inf, ratio)
    tied = ratio <= ratio.amin(dim=0) + programs.TIE
    tied = tied & (slope.abs() >= programs.STEEP * torch.where(tied, slope.abs(), 0.0).amax(dim=0))
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


# Inputs and outputs of steps, and the steps.

TOLD = "told_"
"""Begins the name of what the craft of the other side told, under the name that it has there."""

NEW = "new_"  # begins the name of an output that takes the place of the input of the same name

STATE, LENGTH, ACCELERATION = "x y z (m), vx vy vz (m/s)", "m", "m/s²"


@dataclass(frozen=True)
class Value:
    """One input or output."""

    # sizes; by letter where they differ: T nodes, m = 3(T-1) controls, P encounters, Q other craft,
    # H numbers of a message
    shape: tuple[int | str, ...]
    what: str  # unit and meaning
    dtype: torch.dtype = torch.float64  # its type
    unit: str = ""  # STATE, LENGTH or ACCELERATION, where steps have it in r_col and Δt

    def sized(self, sizes: Mapping[str, int]) -> tuple[int, ...]:
        """The shape in numbers."""
        return tuple(size if isinstance(size, int) else sizes[size] for size in self.shape)


def _states(*shape: int | str, at: str) -> Value:
    return Value(shape, f"{STATE} at {at}", unit=STATE)


FLOAT, WHOLE = torch.float32, torch.int64

VALUES: Mapping[str, Value] = {
    "initial": _states(6, at="the first node"),
    "goal": _states(6, at="the last node"),
    "r_col": Value((), "collision radius, m"),
    "states": _states("T", 6, at="each node of the decoupled optimum"),
    "told_states": Value(("Q", "T", 6), "the same of all other craft", unit=STATE),
    "met": Value(("Q", "T-1"), "whether it is an encounter, by craft and interval", torch.bool),
    "interval": Value(("P",), "in which interval each encounter is, from 0", WHOLE),
    "number": Value((), "of the round, from 0", WHOLE),
    "controls": Value(
        ("m",), "x y z of the first interval (m/s²), then of the next", unit=ACCELERATION
    ),
    "nodes": _states("P", 2, 6, at="both ends of the interval"),
    "price": Value(("P",), "what the plane cost in the last round, m/s² a metre, times Δt²"),
    "first_price": Value(("P",), "what its first metre costs, likewise; 0 before it is live"),
    "distance": Value(("P",), "closest approach, m", unit=LENGTH),
    "live": Value(("P",), "whether the encounter gets a plane in this round", torch.bool),
    "standing": Value(
        ("P", 3),
        "number of live encounters, sum of their prices, fuel over the decoupled (r_col/Δt²)",
    ),
    "offer": Value(("P",), "what the craft offers", FLOAT),
    "said": Value(("P", "H"), "what it makes of both sides", FLOAT),
    "heard": Value(("P", "2H"), "what its encounters say: by likeness of planes, and all", FLOAT),
}
"""By name; what the other side told has the same shape, unless it is here itself."""


def value(name: str) -> Value:
    """The value of a name, also of what is new or was told."""
    plain = name.removeprefix(NEW)
    if plain in VALUES:
        return VALUES[plain]
    own = plain.removeprefix(TOLD)
    return replace(VALUES[own], what=f"`{own}` of the other side")


def sizes_of(nodes: int, message: int, encounters: int, others: int) -> dict[str, int]:
    """The letters of shapes in numbers."""
    m = 3 * (nodes - 1)
    letters = {"T": nodes, "m": m, "T-1": nodes - 1, "H": message, "2H": 2 * message}
    return {**letters, "P": encounters, "Q": others}


class Step(nn.Module):
    """An ONNX graph of one step of one craft: named inputs to named outputs."""

    takes: tuple[str, ...] = ()  # names of the inputs, in order
    gives: tuple[str, ...] = ()  # names of the outputs
    tells: tuple[str, ...] = ()  # those that the other craft must have before the next step
    tells_all = False  # whether also of encounters that are not live

    def __init__(self, network: MessagePassing, problem: Problem) -> None:
        super().__init__()
        self.problem, self.grid = problem, geometry.grid_of(problem, torch.device("cpu"))
        self.weights = {name: weight.detach() for name, weight in network.weights.items()}
        of_time = torch.tensor([1.0, 1 / problem.time_step], dtype=torch.float64)
        self.units = {
            STATE: of_time.repeat_interleave(3),
            LENGTH: of_time[0],
            ACCELERATION: of_time[1] ** 2,
        }

    def forward(self, *given: Tensor) -> tuple[Tensor, ...]:
        """The outputs, from the inputs: m, m/s and m/s² outside and r_col and Δt inside."""
        known = dict(zip(self.takes, given, strict=True))
        for name in self.takes:
            if unit := value(name).unit:
                known[name] = known[name] / (known["r_col"] * self.units[unit])
        found = dict(zip(self.gives, self._step(SimpleNamespace(**known)), strict=True))
        for name in self.gives:
            if unit := value(name).unit:
                found[name] = found[name] * (known["r_col"] * self.units[unit])
        return tuple(found.values())

    def _step(self, craft: SimpleNamespace) -> tuple[Tensor, ...]:
        """The outputs of what a craft knows, by the names of ``VALUES``, in r_col and Δt."""
        raise NotImplementedError

    def own(self, craft: SimpleNamespace) -> Tableau:
        """The decoupled optimum."""
        return decoupled_optimum(craft.initial, craft.goal, self.grid, self.problem)

    def scene(self, craft: SimpleNamespace) -> Scene:
        """The closest approaches of the P encounters."""
        ends = craft.nodes - craft.told_nodes
        return geometry.scene_of(craft.interval, nearest(ends), ends, self.grid)


def _both(craft: SimpleNamespace, name: str) -> Float[Tensor, "P 2 *_"]:
    """What the craft and the other side of each encounter know by this name."""
    return torch.stack([getattr(craft, name), getattr(craft, TOLD + name)], dim=1)


ENDS = ("initial", "goal", "r_col")
NODES = ("nodes", "told_nodes")
PRICES = ("price", "told_price", "first_price", "told_first_price")


class Begin(Step):
    """The decoupled optimum, and where it leads: who has its states can tell whom it meets."""

    takes, gives, tells = ENDS, ("controls", "states"), ("states",)

    def _step(self, craft: SimpleNamespace) -> tuple[Tensor, ...]:
        controls = self.own(craft).controls(self.grid.reach.shape[1])
        return controls, self.grid.fly(craft.initial[None], controls[None])[0]


class Meet(Step):
    """A craft's encounters: other craft and intervals that ``geometry.encounters`` finds."""

    takes, gives = ("states", "told_states", "r_col"), ("met",)

    def _step(self, craft: SimpleNamespace) -> tuple[Tensor, ...]:
        every = torch.cat([craft.states[None], craft.told_states])
        relative = every[:1] - every[1:]
        each = torch.stack([relative[:, :-1], relative[:, 1:]], dim=2)  # (Q, T-1, 2, 6)
        ends = each.reshape(-1, 2, 6)
        closest = torch.linalg.vector_norm(positions(ends, nearest(ends)), dim=1)
        share = geometry.NEAR_OF_EXTENT * geometry.extents(every, every.shape[0])
        within = share.clamp(min=geometry.NEAR)  # (1,)
        return (closest.reshape(each.shape[:2]) <= within,)


class Look(Step):
    """Closest approaches of the encounters, which of them are live, and node features."""

    takes = ("number", *ENDS, "interval", "controls", *NODES, "price", "first_price")
    gives = ("distance", "live", "first_price", "standing")
    tells = ("first_price", "standing")

    def _step(self, craft: SimpleNamespace) -> tuple[Tensor, ...]:
        own, scene = self.own(craft), self.scene(craft)
        first, price = craft.first_price, craft.price
        live = model.gets_plane(scene.distance, turns(scene.ends, scene.share), craft.number)
        live = live | (first > 0)
        asked = first_duals(own, scene.gain).clamp(min=model.LEAST_DUAL)
        first = torch.where(live & (first == 0), asked, first)
        spent = craft.controls.abs().sum() - own.value.abs().sum()
        standing = torch.stack([live.sum().to(price.dtype), price.sum(), spent])
        return scene.distance, live, first, standing.expand(price.shape[0], 3)


class Speak(Step):
    """Messages of the encounters, and their aggregation for each of them."""

    takes = ("number", "r_col", "interval", *NODES, "live", *PRICES, "standing", "told_standing")
    gives, tells = ("said", "heard"), ("heard",)

    def _step(self, craft: SimpleNamespace) -> tuple[Tensor, ...]:
        scene, live = self.scene(craft), craft.live[:, None]
        price, first, load = (_both(craft, x) for x in ("price", "first_price", "standing"))
        at = self.grid.nodes, price, first, load, craft.number
        features = model.edge_features(scene, *at).float()
        said = model.two_layers(self.weights, "read", torch.where(live, features.flatten(1), 0.0))
        told = torch.where(live, model.linear(self.weights, "tell", said), 0.0)
        free = model.free_directions(scene.gain, self.grid).float()
        every = told.sum(dim=0).expand(told.shape)
        heard = torch.cat([free @ (free.T @ told), every], dim=1)
        return said, self.weights["hears"] * heard


class Listen(Step):
    """The craft's offers, from the aggregated messages of both craft."""

    takes, gives, tells = ("said", "heard", "told_heard"), ("offer",), ("offer",)

    def _step(self, craft: SimpleNamespace) -> tuple[Tensor, ...]:
        return (model.offers(self.weights, craft.said, craft.heard, craft.told_heard),)


class Settle(Step):
    """The trade, computed alike by both sides, and the craft's own program under it."""

    takes = (*ENDS, "interval", "controls", *NODES, "live", *PRICES, "offer", "told_offer")
    gives, tells = ("controls", "nodes", "price"), ("nodes", "price")
    tells_all = True

    def _step(self, craft: SimpleNamespace) -> tuple[Tensor, ...]:
        scene, now, t = self.scene(craft), craft.controls, craft.interval
        trade = model.trade_of(craft.offer, craft.told_offer)
        prices = _both(craft, "price"), _both(craft, "first_price")
        give = model.way_to_give(scene.distance, *prices, trade)[:, 0]
        best, paid = solve_one(self.own(craft), scene.gain, scene.gain @ now + give, craft.live)
        best = torch.where(craft.live.any(), best, now)
        states = self.grid.fly(craft.initial[None], best[None])[0]
        return best, torch.stack([states[t], states[t + 1]], dim=1), paid


ROUND = {"look": Look, "speak": Speak, "listen": Listen, "settle": Settle}
"""Steps of a round by name, in order."""

STEPS: Mapping[str, type[Step]] = {"begin": Begin, "meet": Meet, **ROUND}  # all steps, in order


def outputs(step: type[Step]) -> tuple[str, ...]:
    """The names of its outputs in a file, where no output may have the name of an input."""
    return tuple(NEW + name if name in step.takes else name for name in step.gives)


def told_each_round(message: int) -> dict[str, int]:
    """How many numbers a craft sends per active encounter and round, by message name."""
    sizes = sizes_of(0, message, 1, 1)
    names = [name for step in ROUND.values() for name in step.tells]
    return {name: prod(VALUES[name].sized(sizes)) for name in names}
