"""What the refiner can be trained without, so that it shows what each idea in it is worth.

Every ablation is the tuned recipe but for one thing and for its epochs, of which it has fewer;
``short`` has as few and lacks nothing, so it is what ablations are compared with.
"""

REFINER = "refiner"
"""The architecture's name."""

TUNED, SHORT = "tuned", "short"

NO_THIRD, UNCROWDED, LABELLED = "no-third", "uncrowded", "labelled"

RULE, NULL_SPACE = "rule", "rule, null space"
"""Planners without a network: the rule alone, and with steps in the null space."""

EPOCHS = 6
"""Of ``short`` and of every ablation."""

ABLATIONS = (NO_THIRD, UNCROWDED)
"""Recipes that lack one thing: what a side hears from the other sides of both craft, and crowded
swarms to learn from. ``labelled`` lacks nothing, and learns from the expert's plans beside."""

UNSAFE = 0.1
"""What an unsafe swarm counts as in the score, as fuel over the lower bound."""


def for_comparison(arch: str, recipe: str) -> bool:
    """Whether a recipe is there to be compared with, and not to plan with."""
    return arch == REFINER and recipe in (SHORT, *ABLATIONS, LABELLED)
