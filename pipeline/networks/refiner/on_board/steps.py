"""One craft's part in a round, in steps: after each it tells the craft that it meets some results.

``Begin`` and ``Meet`` come once a transfer; ``Look``, ``Speak``, ``Listen`` and ``Settle`` are a
round. All encounters of the craft, P in all, stay in their places over the rounds; those that are
not live get no plane, and of them only ``Settle`` tells anything. The formulas are those of
``refiner.model``, of which a craft runs its own side: it is the first craft of each pair. Names of
inputs and outputs are those of the files that are exported, and do not change.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from inspect import signature
from math import prod

import torch
from jaxtyping import Bool, Float, Float32, Int
from torch import Tensor, nn

from pipeline.networks.refiner.geometry import (
    NEAR,
    NEAR_OF_EXTENT,
    Grid,
    extents,
    gains,
    grid_of,
    in_units,
    normals,
    passing,
)
from pipeline.networks.refiner.model import (
    LEAST_DUAL,
    edge_features,
    free_directions,
    gets_plane,
    linear,
    offers,
    to_give,
    trade_of,
    two_layers,
)
from pipeline.networks.refiner.on_board.traced import (
    cubic,
    decoupled_optimum,
    first_duals,
    nearest,
    position,
    solve_one,
    turns,
)
from pipeline.networks.refiner.programs import Decoupled
from pipeline.networks.refiner.refiner import MessagePassing
from pipeline.orbit.problem import Problem

TOLD = "told_"
"""Begins the name of what the craft of the other side told, under the name that it has there."""

NEW = "new_"  # begins the name of an output that takes the place of the input of the same name

STATE = "x y z (m), vx vy vz (m/s)"


@dataclass(frozen=True)
class Value:
    """One input or output.

    Attributes:
        shape: sizes; by letter where they differ: T nodes, m = 3(T-1) controls, P encounters, Q
            other craft, H numbers of a message.
    """

    shape: tuple[int | str, ...]
    what: str  # unit and meaning
    dtype: torch.dtype = torch.float64  # its type

    def sized(self, sizes: Mapping[str, int]) -> tuple[int, ...]:
        """The shape in numbers."""
        return tuple(size if isinstance(size, int) else sizes[size] for size in self.shape)

    def example(self, sizes: Mapping[str, int]) -> Tensor:
        """Ones of that shape and type."""
        return torch.ones(self.sized(sizes), dtype=self.dtype)


FLOAT, WHOLE = torch.float32, torch.int64

VALUES: Mapping[str, Value] = {
    "initial": Value((6,), f"{STATE} at the first node"),
    "goal": Value((6,), f"{STATE} at the last node"),
    "r_col": Value((), "collision radius, m"),
    "states": Value(("T", 6), f"{STATE} at each node of the decoupled optimum"),
    "told_states": Value(("Q", "T", 6), "the same of all other craft"),
    "met": Value(("Q", "T-1"), "whether it is an encounter, by craft and interval", torch.bool),
    "interval": Value(("P",), "in which interval each encounter is, from 0", WHOLE),
    "number": Value((), "of the round, from 0", WHOLE),
    "controls": Value(("m",), "x y z of the first interval (m/s²), then of the next"),
    "nodes": Value(("P", 2, 6), f"{STATE} at both ends of the interval"),
    "price": Value(("P",), "what the plane cost in the last round, m/s² a metre, times Δt²"),
    "first_price": Value(("P",), "what its first metre costs, likewise; 0 before it is live"),
    "distance": Value(("P",), "closest approach, m"),
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


@dataclass(frozen=True, eq=False)
class Scene:
    """The P encounters of a craft as they are, in r_col and Δt."""

    ends: Float[Tensor, "P 2 6"]  # states relative to the other craft at both ends of the interval
    share: Float[Tensor, "P"]  # when they are closest, as a share of the interval
    turns: Bool[Tensor, "P"]  # whether they come closer before and part after it
    distance: Float[Tensor, "P"]  # then
    along: Float[Tensor, "P 3"]  # normal of the plane
    gain: Float[Tensor, "P m"]  # how the craft's controls move it along the normal


class Step(nn.Module):
    """One graph: ``forward`` has the inputs by name, m, m/s and m/s².

    Attributes:
        tells_all: whether also of encounters that are not live.
    """

    gives: tuple[str, ...] = ()  # names of the outputs
    tells: tuple[str, ...] = ()  # those of them that the other craft must have before the next step
    tells_all = False

    def __init__(self, network: MessagePassing, problem: Problem) -> None:
        super().__init__()
        self.problem = problem
        self.grid: Grid = grid_of(problem, torch.device("cpu"))
        self.weights = {name: weight.detach() for name, weight in network.weights.items()}

    def scaled(
        self, states: Float[Tensor, "*batch 6"], r_col: Float[Tensor, ""]
    ) -> Float[Tensor, "*batch 6"]:
        """States in r_col and Δt."""
        return in_units(states.reshape(1, -1, 6), r_col[None], self.problem).reshape(states.shape)

    def own(
        self, initial: Float[Tensor, "6"], goal: Float[Tensor, "6"], r_col: Float[Tensor, ""]
    ) -> Decoupled:
        """The decoupled optimum in r_col and Δt."""
        start, end = self.scaled(initial[None], r_col), self.scaled(goal[None], r_col)
        return decoupled_optimum(start, end, self.grid, self.problem)

    def acceleration(self, r_col: Float[Tensor, ""]) -> Float[Tensor, ""]:
        """What a control of 1 r_col/Δt² is, m/s²."""
        return r_col / self.grid.step**2

    def fly(
        self, initial: Float[Tensor, "6"], controls: Float[Tensor, "m"], r_col: Float[Tensor, ""]
    ) -> Float[Tensor, "T 6"]:
        """Node states in m and m/s, from controls in r_col/Δt²."""
        flown = self.grid.fly(self.scaled(initial[None], r_col), controls[None])[0]
        return flown / self.scaled(torch.ones_like(flown), r_col)

    def scene(
        self,
        interval: Int[Tensor, "P"],
        nodes: Float[Tensor, "P 2 6"],
        told_nodes: Float[Tensor, "P 2 6"],
        r_col: Float[Tensor, ""],
    ) -> Scene:
        """The encounters."""
        ends = self.scaled(nodes, r_col) - self.scaled(told_nodes, r_col)
        motion = cubic(ends)
        share = nearest(motion)
        distance, along = normals(ends, share)
        gain = gains(interval, share, along, self.grid)
        return Scene(ends, share, turns(motion, share), distance, along, gain)


class Begin(Step):
    """The decoupled optimum, and where it leads: who has its states can tell whom it meets."""

    gives, tells = ("controls", "states"), ("states",)

    def forward(
        self, initial: Float[Tensor, "6"], goal: Float[Tensor, "6"], r_col: Float[Tensor, ""]
    ) -> tuple[Tensor, ...]:
        """Controls (m,) and node states (T, 6)."""
        controls = self.own(initial, goal, r_col).controls[0]
        return controls * self.acceleration(r_col), self.fly(initial, controls, r_col)


class Meet(Step):
    """Which other craft, and in which intervals, this craft must look at in all rounds."""

    gives = ("met",)

    def forward(
        self,
        states: Float[Tensor, "T 6"],
        told_states: Float[Tensor, "Q T 6"],
        r_col: Float[Tensor, ""],
    ) -> tuple[Tensor, ...]:
        """By craft and interval, (Q, T-1); as ``geometry.encounters`` finds them."""
        every = self.scaled(torch.cat([states[None], told_states]), r_col)
        relative = every[:1] - every[1:]
        each = torch.stack([relative[:, :-1], relative[:, 1:]], dim=2)  # (Q, T-1, 2, 6)
        ends = each.reshape(-1, 2, 6)
        motion = cubic(ends)
        gap = position(motion, nearest(motion))
        closest = torch.linalg.vector_norm(gap, dim=1).reshape(each.shape[:2])
        within = (NEAR_OF_EXTENT * extents(every, every.shape[0])).clamp(min=NEAR)  # (1,)
        return (closest <= within,)


class Look(Step):
    """How close encounters come, which are live, and how the craft stands."""

    gives = ("distance", "live", "first_price", "standing")
    tells = ("first_price", "standing")

    def forward(
        self,
        number: Int[Tensor, ""],
        initial: Float[Tensor, "6"],
        goal: Float[Tensor, "6"],
        r_col: Float[Tensor, ""],
        interval: Int[Tensor, "P"],
        controls: Float[Tensor, "m"],
        nodes: Float[Tensor, "P 2 6"],
        told_nodes: Float[Tensor, "P 2 6"],
        price: Float[Tensor, "P"],
        first_price: Float[Tensor, "P"],
    ) -> tuple[Tensor, ...]:
        """Distances (P,), which encounters are live (P,), first prices (P,), standing (P, 3)."""
        own, scene = self.own(initial, goal, r_col), self.scene(interval, nodes, told_nodes, r_col)
        distance = scene.distance
        live = gets_plane(distance, scene.turns, number) | (first_price > 0)
        asked = first_duals(own, scene.gain).clamp(min=LEAST_DUAL)
        first_price = torch.where(live & (first_price == 0), asked, first_price)
        spent = (controls / self.acceleration(r_col)).abs().sum() - own.controls.abs().sum()
        standing = torch.stack([live.sum().to(price.dtype), price.sum(), spent])
        return distance * r_col, live, first_price, standing.expand(price.shape[0], 3)


class Speak(Step):
    """What the network makes of both sides, and the sums of that which each encounter hears."""

    gives, tells = ("said", "heard"), ("heard",)

    def forward(
        self,
        number: Int[Tensor, ""],
        r_col: Float[Tensor, ""],
        interval: Int[Tensor, "P"],
        nodes: Float[Tensor, "P 2 6"],
        told_nodes: Float[Tensor, "P 2 6"],
        live: Bool[Tensor, "P"],
        price: Float[Tensor, "P"],
        told_price: Float[Tensor, "P"],
        first_price: Float[Tensor, "P"],
        told_first_price: Float[Tensor, "P"],
        standing: Float[Tensor, "P 3"],
        told_standing: Float[Tensor, "P 3"],
    ) -> tuple[Tensor, ...]:
        """What is said, (P, H), and heard, (P, 2H)."""
        scene = self.scene(interval, nodes, told_nodes, r_col)
        features = edge_features(
            scene.distance,
            scene.gain,
            scene.along,
            passing(scene.ends, scene.share, scene.along),
            (interval + scene.share) / (self.grid.nodes - 1),
            torch.stack([price, told_price], dim=1),
            torch.stack([first_price, told_first_price], dim=1),
            torch.stack([standing, told_standing], dim=1),
            number,
        ).float()
        features = torch.where(live[:, None, None], features, 0.0)
        said = two_layers(self.weights, "read", features.flatten(1))
        told = torch.where(live[:, None], linear(self.weights, "tell", said), 0.0)
        free = free_directions(scene.gain, self.grid).float()
        every = told.sum(dim=0).expand(told.shape)
        heard = torch.cat([free @ (free.T @ told), every], dim=1)
        return said, self.weights["hears"] * heard


class Listen(Step):
    """What the craft offers, after hearing what the other one has heard."""

    gives, tells = ("offer",), ("offer",)

    def forward(
        self,
        said: Float32[Tensor, "P H"],
        heard: Float32[Tensor, "P _"],
        told_heard: Float32[Tensor, "P _"],
    ) -> tuple[Tensor, ...]:
        """Offers (P,)."""
        return (offers(self.weights, said, heard, told_heard),)


class Settle(Step):
    """The trade that both sides find by themselves, and the craft's own program under it."""

    gives, tells = ("controls", "nodes", "price"), ("nodes", "price")
    tells_all = True

    def forward(
        self,
        initial: Float[Tensor, "6"],
        goal: Float[Tensor, "6"],
        r_col: Float[Tensor, ""],
        interval: Int[Tensor, "P"],
        controls: Float[Tensor, "m"],
        nodes: Float[Tensor, "P 2 6"],
        told_nodes: Float[Tensor, "P 2 6"],
        live: Bool[Tensor, "P"],
        price: Float[Tensor, "P"],
        told_price: Float[Tensor, "P"],
        first_price: Float[Tensor, "P"],
        told_first_price: Float[Tensor, "P"],
        offer: Float32[Tensor, "P"],
        told_offer: Float32[Tensor, "P"],
    ) -> tuple[Tensor, ...]:
        """Controls (m,), states at the encounters' nodes (P, 2, 6), prices of the planes (P,)."""
        scene = self.scene(interval, nodes, told_nodes, r_col)
        prices = torch.stack([price, told_price], dim=1)
        first_prices = torch.stack([first_price, told_first_price], dim=1)
        trade = trade_of(offer, told_offer)
        give = to_give(scene.distance, prices, first_prices, trade)[:, 0]
        now = controls / self.acceleration(r_col)
        own = self.own(initial, goal, r_col)
        best, paid = solve_one(own, scene.gain, scene.gain @ now + give, live)
        best = torch.where(live.any(), best, now)
        states = self.fly(initial, best, r_col)
        both = torch.stack([states[interval], states[interval + 1]], dim=1)
        return best * self.acceleration(r_col), both, paid


ROUND: Mapping[str, type[Step]] = {
    "look": Look,
    "speak": Speak,
    "listen": Listen,
    "settle": Settle,
}
"""Steps of a round by name, in order."""

STEPS: Mapping[str, type[Step]] = {"begin": Begin, "meet": Meet, **ROUND}  # all steps, in order


def takes(step: type[Step]) -> tuple[str, ...]:
    """The names of a step's inputs, in order."""
    return tuple(signature(step.forward).parameters)[1:]


def outputs(step: type[Step]) -> tuple[str, ...]:
    """The names of its outputs in a file, where no output may have the name of an input."""
    return tuple(NEW + name if name in takes(step) else name for name in step.gives)


def told_each_round(message: int) -> dict[str, int]:
    """How many numbers a craft tells in a round for each live encounter, by name."""
    sizes = sizes_of(0, message, 1, 1)
    names = [name for step in ROUND.values() for name in step.tells]
    return {name: prod(VALUES[name].sized(sizes)) for name in names}
