"""What one craft knows, by name: shapes, units and meaning of all that its steps take and give."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import torch
from torch import Tensor

TOLD = "told_"
"""Begins the name of what the craft of the other side told, under the name that it has there."""

NEW = "new_"
"""Begins the name of an output that takes the place of the input of the same name."""

STATE = "x y z (m), vx vy vz (m/s)"


@dataclass(frozen=True)
class Value:
    """One input or output.

    Attributes:
        shape: sizes; by letter where they differ: T nodes, m = 3(T-1) controls, P encounters, Q
            other craft, H numbers of a message.
        what: unit and meaning.
        dtype: its type.
    """

    shape: tuple[int | str, ...]
    what: str
    dtype: torch.dtype = torch.float64

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
    "states": Value(("T", 6), f"{STATE} at each node of the own optimum"),
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
        "number of live encounters, sum of their prices, fuel over the own optimum (r_col/Δt²)",
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
