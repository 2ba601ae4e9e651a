"""What a hyperparameter search may change in a recipe, and between which limits."""

from collections.abc import Mapping
from dataclasses import dataclass

from pipeline.networks.interior import INTERIORS


@dataclass(frozen=True)
class Between:
    """A number between two limits.

    Attributes:
        low: the least.
        high: the greatest.
        log: whether its logarithm is what is drawn evenly.
    """

    low: float
    high: float
    log: bool = False


@dataclass(frozen=True)
class OneOf:
    """One of some values.

    Attributes:
        values: numbers or names.
    """

    values: tuple[int | str, ...]


SPACE: Mapping[str, Between | OneOf] = {
    "learning_rate": Between(1e-4, 2e-2, log=True),
    "batch_size": OneOf((16, 32, 64, 128, 256)),
    "dropout": Between(0.0, 0.5),
    "interior": OneOf(tuple(INTERIORS)),
}
"""By field of a recipe. The collision weight is not in it: the distance from the expert's plans,
which the search makes small, says nothing about collisions."""
