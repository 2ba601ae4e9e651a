"""What the refiner can be trained without, so that it shows what each idea in it is worth.

Every ablation is the tuned recipe but for one thing and for its epochs, of which it has fewer;
``short`` has as few and lacks nothing, so it is what ablations are compared with.
"""

from typing import Literal, get_args

REFINER = "refiner"
"""The architecture's name."""

Part = Literal["share", "trade", "margin", "tilt", "third", "memory"]

PARTS: tuple[Part, ...] = get_args(Part)
"""Parts of the network that can be left out: what two craft agree on, what a side hears from the
other sides of both craft, and what it remembers of rounds before."""

TUNED, SHORT, UNCROWDED = "tuned", "short", "uncrowded"

EPOCHS = 4
"""Of ``short`` and of every ablation."""

WITHOUT: dict[str, Part] = {f"no-{part}": part for part in PARTS}
"""By recipe, the part that it leaves out."""

ABLATIONS = (*WITHOUT, UNCROWDED)
"""Recipes that lack one thing; the last lacks crowded swarms to learn from."""

UNSAFE = 0.1
"""What an unsafe swarm counts as in the score, as fuel over the lower bound."""


def for_comparison(arch: str, recipe: str) -> bool:
    """Whether a recipe is there to be compared with, and not to plan with."""
    return arch == REFINER and recipe in (SHORT, *ABLATIONS)
