"""The two recipes by which each network is trained: the paper's, and one tuned on validation."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from pipeline.errors import InputError


@dataclass(frozen=True)
class Recipe:
    """How a network is trained.

    Attributes:
        name: of RECIPES, or any other for one of your own.
        target: what the network answers: "states", or "offset" from the input's trajectories.
        scaling: what the components are divided by: "common" or "component".
        dropout: share of each hidden layer's outputs dropped in training.
        learning_rate: of Adam.
        batch_size: instances a step.
        epochs: most passes over the training data.
        patience: passes without a better validation loss after which training ends.
        interior: what stands in the input between initial and goal state.
        collision_weight: weight of the collision penalty, in networks that have one.
    """

    name: str
    target: str
    scaling: str
    dropout: float
    learning_rate: float
    batch_size: int
    epochs: int
    patience: int = 5
    interior: str = "line"
    collision_weight: float = 0.02

    def __post_init__(self) -> None:
        """Refuse numbers that nothing can be trained with."""
        for field in ("batch_size", "epochs", "patience"):
            if getattr(self, field) < 1:
                raise InputError(f"{field} is {getattr(self, field)}; expected at least 1.")
        if not 0 <= self.dropout < 1:
            raise InputError(f"dropout is {self.dropout}; expected a share in [0, 1).")
        if not 0 < self.learning_rate < float("inf"):
            raise InputError(f"learning_rate is {self.learning_rate}; expected a positive number.")
        if not 0 <= self.collision_weight < float("inf"):
            raise InputError(f"collision_weight is {self.collision_weight}; expected 0 or more.")


RECIPES: Mapping[str, Recipe] = {
    "paper": Recipe(
        name="paper",
        target="states",
        scaling="common",
        dropout=0.5,
        learning_rate=1e-3,
        batch_size=128,
        epochs=60,
    ),
    "tuned": Recipe(
        name="tuned",
        target="offset",
        scaling="component",
        dropout=0.0,
        learning_rate=5e-4,
        batch_size=128,
        epochs=100,
    ),
}
"""By name; an architecture may depart from them (``Architecture.recipes``)."""


def recipe_for(arch: str, name: str) -> Recipe:
    """The recipe of a name, with the departures that an architecture declares.

    Raises:
        InputError: for an unknown architecture or recipe.
    """
    from pipeline.networks.architecture import find  # imports torch

    if name not in RECIPES:
        raise InputError(f"recipe is {name!r}; expected one of {', '.join(RECIPES)}.")
    return replace(RECIPES[name], **find(arch).recipes.get(name, {}))
