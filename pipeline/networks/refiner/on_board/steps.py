"""One craft's round, in steps: after each it tells the craft that it meets what it ``tells``.

``Begin`` and ``Meet`` come once a transfer; ``Look``, ``Speak``, ``Listen`` and ``Settle`` are a
round. All encounters of the craft, P in all, stay in their places over the rounds; those that are
not live get no plane, and of them only ``Settle`` tells anything.
The formulas are those of ``rounds``, ``seen`` and ``bargain``, of which a craft runs its own side:
it is the first craft of each pair.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from inspect import signature
from math import prod

import torch
from jaxtyping import Bool, Float, Float32, Int
from torch import Tensor, nn

from pipeline.networks.refiner.bargain import Bargain, trade_of
from pipeline.networks.refiner.encounters import Encounters, extents
from pipeline.networks.refiner.grid import Grid, grid_of, in_units
from pipeline.networks.refiner.on_board.nearest import nearest
from pipeline.networks.refiner.on_board.own_optimum import own_optimum, price_of_first
from pipeline.networks.refiner.on_board.pivots import solve_one
from pipeline.networks.refiner.on_board.planes import cubic, planes, position, turns
from pipeline.networks.refiner.on_board.seen import Standing, seen
from pipeline.networks.refiner.on_board.values import NEW, VALUES, sizes_of
from pipeline.networks.refiner.planes import Planes
from pipeline.networks.refiner.program import Own
from pipeline.networks.refiner.rounds import (
    LEAST_PRICE,
    NEAR,
    NEAR_OF_EXTENT,
    meets,
    to_give,
)
from pipeline.networks.refiner.seen import Meeting, free_directions
from pipeline.orbit.problem import Problem


@dataclass(frozen=True, eq=False)
class Scene:
    """The P encounters as they are, seen from this craft, in r_col and Δt.

    Attributes:
        met: their intervals; this craft is the first of each pair.
        share: when they are closest, as a share of the interval, (P,).
        turns: whether they come closer before and part after it, (P,).
        planes: between this craft and the others.
    """

    met: Encounters
    share: Float[Tensor, "P"]
    turns: Bool[Tensor, "P"]
    planes: Planes

    def meeting(self, price: Float[Tensor, "P 2"], first_price: Float[Tensor, "P 2"]) -> Meeting:
        """With the prices of both sides."""
        return Meeting(self.met, self.share, self.planes, price, first_price)


class Step(nn.Module):
    """One graph: ``forward`` has the inputs by name, m, m/s and m/s².

    Attributes:
        gives: names of the outputs.
        tells: those of them that the other craft must have before the next step.
        tells_all: whether also of encounters that are not live.
    """

    gives: tuple[str, ...] = ()
    tells: tuple[str, ...] = ()
    tells_all = False

    def __init__(self, network: Bargain, problem: Problem) -> None:
        super().__init__()
        self.network, self.problem = network, problem
        self.grid: Grid = grid_of(problem, torch.device("cpu"))

    def scaled(
        self, states: Float[Tensor, "*batch 6"], r_col: Float[Tensor, ""]
    ) -> Float[Tensor, "*batch 6"]:
        """States in r_col and Δt."""
        return in_units(states.reshape(1, -1, 6), r_col[None], self.problem).reshape(states.shape)

    def own(
        self, initial: Float[Tensor, "6"], goal: Float[Tensor, "6"], r_col: Float[Tensor, ""]
    ) -> Own:
        """The own optimum in r_col and Δt."""
        start, end = self.scaled(initial[None], r_col), self.scaled(goal[None], r_col)
        return own_optimum(start, end, self.grid, self.problem)

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
        motion, here = cubic(ends), torch.zeros_like(interval)
        share, met = nearest(motion), Encounters(here, here + 1, interval)
        between = planes(interval, share, motion, self.grid)
        return Scene(met, share, turns(motion, share), between)


class Begin(Step):
    """The own optimum, and where it leads: who has its states can tell whom it meets."""

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
        """By craft and interval, (Q, T-1); as ``encounters.candidates`` finds them."""
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
        distance = scene.planes.distance
        live = meets(distance, scene.turns, number) | (first_price > 0)
        asked = price_of_first(own, scene.planes.gain).clamp(min=LEAST_PRICE)
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
        prices = torch.stack([price, told_price], dim=1)
        first_prices = torch.stack([first_price, told_first_price], dim=1)
        both = Standing(*torch.stack([standing, told_standing], dim=1).unbind(dim=2))
        sight = seen(scene.meeting(prices, first_prices), both, self.grid, number)
        sight = torch.where(live[:, None, None], sight, 0.0)
        said = self.network.read(sight.flatten(1))
        told = torch.where(live[:, None], self.network.tell(said), 0.0)
        free = free_directions(scene.planes.gain, self.grid)
        every = told.sum(dim=0).expand(told.shape)
        return said, self.network.hears * torch.cat([free @ free.T @ told, every], dim=1)


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
        return (self.network.offers(said, heard, told_heard),)


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
        meeting = scene.meeting(prices, first_prices)
        give = to_give(meeting, trade_of(offer, told_offer))[:, 0]
        now = controls / self.acceleration(r_col)
        own = self.own(initial, goal, r_col)
        best, paid = solve_one(own, scene.planes.gain, scene.planes.gain @ now + give, live)
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

STEPS: Mapping[str, type[Step]] = {"begin": Begin, "meet": Meet, **ROUND}
"""All steps, in order."""


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
