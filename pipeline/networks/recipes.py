"""Names of architectures and recipes for training, without torch."""

import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import EntryPoints, entry_points
from typing import Any

from pipeline.errors import InputError, check_choice, check_range, check_whole

MOST = 1_000_000  # largest count in a recipe, of instances, passes or draws
# Schedules of the learning rate: constant, or cosine annealing to 0
SCHEDULES = CONSTANT, COSINE = "constant", "cosine"


@dataclass(frozen=True)
class Recipe:
    """Hyperparameters of a training; where the default is 0, that part is off."""

    name: str  # of RECIPES or the architecture's, or any other for one of your own
    target: str  # what the network answers: "states", or "offset" from the input's trajectories
    scaling: str  # what the components are divided by: "common" or "component"
    dropout: float  # share of each hidden layer's outputs dropped in training
    learning_rate: float  # of Adam
    batch_size: int  # instances in each step
    epochs: int  # most passes over the training data
    patience: int = 5  # early stopping: passes without a better validation score
    interior: str = "line"  # what stands in the input between initial and goal state
    collision_weight: float = 0.02  # weight of the collision penalty, in networks that have one
    schedule: str = CONSTANT  # of the learning rate over all epochs, of SCHEDULES
    gradient_limit: float = 0.0  # gradient clipping: largest norm of a step's gradient
    averaging: float = 0.0  # decay of the moving average of weights, which is scored and kept
    draws: int = 0  # fresh scenarios in each epoch, without plans, instead of the training split
    crowded: int = 0  # scenarios of the family dense, without plans, added to the training split
    options: Mapping[str, Any] = field(default_factory=dict)  # what only one architecture knows

    def __post_init__(self) -> None:
        leasts = {"batch_size": 1, "epochs": 1, "patience": 1, "draws": 0, "crowded": 0}
        for name, least in leasts.items():
            check_whole(name, getattr(self, name), least, MOST)
        for name in ("dropout", "averaging"):
            if not 0 <= getattr(self, name) < 1:
                raise InputError(f"{name} is {getattr(self, name)}; expected a share in [0, 1).")
        check_range("learning_rate", self.learning_rate, 1e-30, 1e30)
        for name in ("collision_weight", "gradient_limit"):
            check_range(name, getattr(self, name), 0, 1e12)
        check_choice("schedule", self.schedule, SCHEDULES)


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
"""By name; an architecture may depart from them, or add its own (``Architecture.recipes``)."""

REFINER = "refiner"  # name of the architecture of prolearn's own
ARCHITECTURES = "prolearn.architectures"  # group of the entry points that declare them


def architecture_names() -> tuple[str, ...]:
    """Names of all installed architectures, in alphabetical order."""
    return tuple(sorted(_entry_points(tuple(sys.path)).names))


def distribution_of(name: str) -> str | None:
    """The distribution that brings an architecture, where known; InputError for an unknown name."""
    found = getattr(entry_point(name), "dist", None)
    return None if found is None else str(found.name)


def code_of_others(names: Iterable[str]) -> tuple[str, ...]:
    """Distributions and modules of third-party architectures, as ``DecidedBy`` names them."""
    brought = {name: distribution_of(name) for name in sorted({*names})}
    found = (
        f"{distribution}:{entry_point(name).module.partition('.')[0]}"
        for name, distribution in brought.items()
        if distribution not in (None, "prolearn")
    )
    return tuple(dict.fromkeys(found))


def entry_point(name: str) -> Any:
    """The entry point of an architecture; InputError, with the known names, for an unknown one."""
    for found in _entry_points(tuple(sys.path)):
        if found.name == name:
            return found
    known = ", ".join(architecture_names()) or "none: install prolearn again"
    raise InputError(f"architecture is {name!r}; expected one of those installed ({known}).")


@cache
def _entry_points(folders: tuple[str, ...]) -> EntryPoints:
    """Entry points of architectures in the folders of sys.path, cached: a search takes 20 ms."""
    return entry_points(group=ARCHITECTURES)
