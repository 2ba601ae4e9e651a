"""The steps of a refiner that one craft runs on board, and what it sends to others after each.

``Begin`` and ``Meet`` come once a transfer; ``Look``, ``Speak``, ``Listen`` and ``Settle`` are a
round. The P encounters of the craft keep their order over the rounds; those that are not live get
no plane, and only ``Settle`` sends values of them. The formulas are those of
``refiner.model``, of which a craft runs its own side: it is the first craft of each pair. Names of
inputs and outputs are those of the files that are exported, and do not change.

What compiled code computes for a swarm, ``refiner.tensors`` computes here, which can be traced, for
a batch of one craft.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import prod
from types import SimpleNamespace

import torch
from torch import Tensor, nn

from pipeline.arrays import Float
from pipeline.networks.refiner import geometry, model
from pipeline.networks.refiner.geometry import Scene, positions
from pipeline.networks.refiner.refiner import MessagePassing
from pipeline.networks.refiner.tensors import TensorDecoupled, decoupled_optima, is_minimum, nearest
from pipeline.orbit.problem import Problem

# Inputs and outputs of steps, and the steps.

TOLD = "told_"  # prefix of the names of values that the other side of an encounter sent
NEW = "new_"  # prefix of the name of an output that replaces the input of the same name
STATE, LENGTH, ACCELERATION = "x y z (m), vx vy vz (m/s)", "m", "m/s²"


@dataclass(frozen=True)
class Value:
    """One input or output."""

    # sizes; by letter where they differ: T nodes, m = 3(T-1) controls, P encounters, Q other craft,
    # H numbers of a message
    shape: tuple[int | str, ...]
    meaning: str  # with its unit
    dtype: torch.dtype = torch.float64  # its type
    unit: str = ""  # STATE, LENGTH or ACCELERATION, where steps convert it to r_col and Δt

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
    "price": Value(("P",), "dual of the plane in the last round, m/s² per metre, times Δt²"),
    "first_price": Value(("P",), "dual of the plane's first metre, times Δt²; 0 before it is live"),
    "distance": Value(("P",), "closest approach, m", unit=LENGTH),
    "share": Value(("P",), "when that is, as a share of the interval"),
    "live": Value(("P",), "whether the encounter gets a plane in this round", torch.bool),
    "standing": Value(
        ("P", 3),
        "number of live encounters, sum of their prices, fuel over the decoupled (r_col/Δt²)",
    ),
    "offer": Value(("P",), "the craft's offer, from which both compute the trade", FLOAT),
    "said": Value(("P", "H"), "embedding of the edge features of both sides", FLOAT),
    "heard": Value(("P", "2H"), "aggregated messages: cosine-weighted sum, sum", FLOAT),
}
"""By name; a value that the other side sent has the same shape, unless it is listed itself."""


def value(name: str) -> Value:
    """The value of a name, which may have the prefix NEW or TOLD."""
    plain = name.removeprefix(NEW)
    if plain in VALUES:
        return VALUES[plain]
    own = plain.removeprefix(TOLD)
    return replace(VALUES[own], meaning=f"`{own}` of the other side")


def sizes_of(nodes: int, message: int, encounters: int, others: int) -> dict[str, int]:
    """The letters of shapes in numbers."""
    m = 3 * (nodes - 1)
    letters = {"T": nodes, "m": m, "T-1": nodes - 1, "H": message, "2H": 2 * message}
    return {**letters, "P": encounters, "Q": others}


class Step(nn.Module):
    """An ONNX graph of one step of one craft: named inputs to named outputs."""

    takes: tuple[str, ...] = ()  # names of the inputs, in order
    gives: tuple[str, ...] = ()  # names of the outputs
    tells: tuple[str, ...] = ()  # outputs that are sent to other craft before the next step
    tells_all = False  # whether they are sent for encounters that are not live, too

    def __init__(self, network: MessagePassing, problem: Problem) -> None:
        super().__init__()
        self.problem, self.grid = problem, geometry.grid_of(problem, torch.device("cpu"))
        self.weights = {name: weight.detach() for name, weight in network.weights.items()}
        units = torch.from_numpy(1 / geometry.per_step(problem))
        self.units = {STATE: units, LENGTH: units[0], ACCELERATION: units[-1] ** 2}

    def forward(self, *given: Tensor) -> tuple[Tensor, ...]:
        """The outputs, from the inputs, all in m, m/s and m/s²; inside they are in r_col and Δt."""
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
        """The outputs, from the craft's values by name, in r_col and Δt."""
        raise NotImplementedError

    def own(self, craft: SimpleNamespace) -> TensorDecoupled:
        """The decoupled optimum, in a batch of one."""
        return decoupled_optima(craft.initial[None], craft.goal[None], self.grid, self.problem)

    def scene(self, craft: SimpleNamespace) -> Scene:
        """Geometry of P encounters at closest approach: distances, normals and gains."""
        ends = craft.nodes - craft.told_nodes
        return geometry.scene_of(craft.interval, craft.share, ends, self.grid)


def _both(craft: SimpleNamespace, name: str) -> Float[Tensor, "P 2 *_"]:
    """The values of this name of the craft and of the other side of each encounter."""
    return torch.stack([getattr(craft, name), getattr(craft, TOLD + name)], dim=1)


ENDS = ("initial", "goal", "r_col")
NODES = ("nodes", "told_nodes")
MET = ("interval", *NODES, "share")
PRICES = ("price", "told_price", "first_price", "told_first_price")


class Begin(Step):
    """The decoupled optimum and its states, by which other craft find their encounters."""

    takes, gives, tells = ENDS, ("controls", "states"), ("states",)

    def _step(self, craft: SimpleNamespace) -> tuple[Tensor, ...]:
        controls = self.own(craft).controls
        return controls[0], self.grid.fly(craft.initial[None], controls)[0]


class Meet(Step):
    """A craft's encounters: other craft and intervals that ``geometry.encounters`` finds."""

    takes, gives = ("states", "told_states", "r_col"), ("met",)

    def _step(self, craft: SimpleNamespace) -> tuple[Tensor, ...]:
        every = torch.cat([craft.states[None], craft.told_states])
        relative = every[:1] - every[1:]
        each = torch.stack([relative[:, :-1], relative[:, 1:]], dim=2)  # (Q, T-1, 2, 6)
        ends = each.reshape(-1, 2, 6)
        closest = torch.linalg.vector_norm(positions(ends, nearest(ends)), dim=1)
        within = geometry.considered(every, every.shape[0])  # (1,)
        return (closest.reshape(each.shape[:2]) <= within,)


class Look(Step):
    """Closest approaches of the encounters, which of them are live, and node features."""

    takes = ("number", *ENDS, "interval", "controls", *NODES, "price", "first_price")
    gives = ("distance", "share", "live", "first_price", "standing")
    tells = ("first_price", "standing")

    def _step(self, craft: SimpleNamespace) -> tuple[Tensor, ...]:
        craft.share = nearest(craft.nodes - craft.told_nodes)
        own, scene = self.own(craft), self.scene(craft)
        first, price = craft.first_price, craft.price
        live = model.gets_plane(scene.distance, is_minimum(scene.ends, scene.share), craft.number)
        live = live | (first > 0)
        asked = own.first_ratios(scene.gain[None])[0].clamp(min=model.LEAST_DUAL)
        first = torch.where(live & (first == 0), asked, first)
        spent = craft.controls.abs().sum() - own.controls.abs().sum()
        standing = torch.stack([live.sum().to(price.dtype), price.sum(), spent])
        return scene.distance, scene.share, live, first, standing.expand(price.shape[0], 3)


class Speak(Step):
    """Messages of the encounters, and their aggregation for each of them."""

    takes = ("number", "r_col", *MET, "live", *PRICES, "standing", "told_standing")
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

    takes = (*ENDS, "controls", *MET, "live", *PRICES, "offer", "told_offer")
    gives, tells = ("controls", "nodes", "price"), ("nodes", "price")
    tells_all = True

    def _step(self, craft: SimpleNamespace) -> tuple[Tensor, ...]:
        scene, now, t = self.scene(craft), craft.controls, craft.interval
        trade = model.trade_of(craft.offer, craft.told_offer)
        prices = _both(craft, "price"), _both(craft, "first_price")
        give = model.separation_shares(scene.distance, *prices, trade)[:, 0]
        programs = scene.gain[None], (scene.gain @ now + give)[None], craft.live[None]
        best, paid = self.own(craft).solved(*programs)
        best = torch.where(craft.live.any(), best, now[None])
        states = self.grid.fly(craft.initial[None], best)[0]
        return best[0], torch.stack([states[t], states[t + 1]], dim=1), paid[0]


# Steps of a round, and all steps, by name, in order
ROUND = {"look": Look, "speak": Speak, "listen": Listen, "settle": Settle}
STEPS: Mapping[str, type[Step]] = {"begin": Begin, "meet": Meet, **ROUND}


def outputs(step: type[Step]) -> tuple[str, ...]:
    """The names of its outputs in a file, where no output may have the name of an input."""
    return tuple(NEW + name if name in step.takes else name for name in step.gives)


def told_each_round(message: int) -> dict[str, int]:
    """How many numbers a craft sends per active encounter and round, by message name."""
    sizes = sizes_of(0, message, 1, 1)
    names = [name for step in ROUND.values() for name in step.tells]
    return {name: prod(VALUES[name].sized(sizes)) for name in names}
