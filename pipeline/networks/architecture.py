"""The protocol of network architectures, ``Architecture``, whose objects entry points name."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch
from torch import Tensor, nn

from pipeline.arrays import Array, Float, Float64
from pipeline.errors import InputError, ProlearnError, check_choice
from pipeline.networks.document import Answer, EndStates
from pipeline.networks.encoding import Encoding
from pipeline.networks.recipes import RECIPES, Recipe, entry_point
from pipeline.orbit.problem import Problem

TensorBatch = Mapping[str, Tensor]  # inputs of loss and score by name; the batch is the first axis


@dataclass(frozen=True, eq=False)
class Swarms:
    """A batch of swarms of one size on one orbit and time grid, in float64 on the CPU."""

    problem: Problem  # orbit and time grid
    initial: Float64[Tensor, "b n 6"]  # m and m/s
    goal: Float64[Tensor, "b n 6"]  # m and m/s
    collision_radius: Float64[Tensor, "b"]  # of each swarm, m
    # the expert's node states; NaN where it has no plan
    states: Float64[Tensor, "b n T 6"] | None = None
    device: str | None = None  # on which a refiner plans them, as in ``TrainedRefiner``


def swarms(
    problem: Problem,
    initial: EndStates,
    goal: EndStates,
    states: Float[Array, "b n T 6"] | None = None,
) -> Swarms:
    """A batch of swarms with one problem and collision radius; arrays are not copied."""
    radius = torch.full((len(initial),), problem.collision_radius, dtype=torch.float64)
    labels = None if states is None else _tensor(states)
    return Swarms(problem, _tensor(initial), _tensor(goal), radius, labels)


def _tensor(values: Float[Array, "..."]) -> Float64[Tensor, "..."]:
    """A tensor that shares the memory of an array where it can."""
    return torch.from_numpy(np.require(values, np.float64, ["C", "W"]))


@runtime_checkable
class Architecture(Protocol):
    """A kind of network: its inputs, its layers, its loss, and what it predicts."""

    @property
    def config(self) -> Mapping[str, Any]:
        """Sizes as plain JSON values; they are stored with each model."""

    @property
    def recipes(self) -> Mapping[str, Mapping[str, Any]]:
        """By recipe name, the fields of ``pipeline.networks.recipes.Recipe`` that differ."""

    @property
    def answers(self) -> Answer:
        """What it predicts: "states" at the nodes, or "controls" of the intervals."""

    @property
    def objective(self) -> str:
        """The metric of a training that hyperparameter search minimizes."""

    def network(self, config: Mapping[str, Any], encoding: Encoding, dropout: float) -> nn.Module:
        """An untrained module.

        It must be a function of its arguments alone, since a stored model is rebuilt with it: the
        sizes in ``config`` come from a file and may be anything; raise ValueError where they make
        no sense. All that it holds is stored as weights, so what follows from the problem alone
        belongs elsewhere. ``dropout`` is the share of each hidden layer's outputs to drop in
        training.
        """

    def prepare(self, swarms: Swarms, encoding: Encoding) -> TensorBatch:
        """The inputs of loss and score for a batch of swarms, on the CPU.

        It is done once where data stays in memory. InputError where it needs the expert's plans and
        there are none.
        """

    def loss(
        self, network: nn.Module, batch: TensorBatch, encoding: Encoding, recipe: Recipe
    ) -> Float[Tensor, ""]:
        """The training loss: a mean over a batch, on the network's device."""

    def score(
        self, network: nn.Module, batch: TensorBatch, encoding: Encoding, recipe: Recipe
    ) -> Float[Tensor, ""]:
        """The validation score, a mean: weights with the lowest are kept."""

    def answer(
        self, network: nn.Module, swarms: Swarms, encoding: Encoding
    ) -> Float[Tensor, "b n _ _"]:
        """States (b, n, T, 6), m and m/s, or controls (b, n, T-1, 3), m/s², for any n ≥ 1."""


def unused_fields(architecture: Architecture) -> frozenset[str]:
    """Fields of a recipe without effect: the architecture's member ``unused``, if any."""
    return frozenset(getattr(architecture, "unused", ()))


@lru_cache
def find(name: str) -> Architecture:
    """The architecture of a name; InputError if unknown, ProlearnError if not importable."""
    point = entry_point(name)
    try:
        found = point.load()
    except (ImportError, AttributeError) as error:
        raise ProlearnError(
            f"architecture {name!r} cannot be loaded from {point.value} ({error}); install the "
            "distribution that declares it again."
        ) from error
    if not isinstance(found, Architecture):
        raise InputError(
            f"architecture {name!r} is {point.value}, which lacks members of "
            "pipeline.networks.architecture.Architecture; add them."
        )
    return found


def changed_recipe(arch: str, name: str, changes: Mapping[str, Any]) -> Recipe:
    """The recipe of ``recipe_for`` with fields replaced; InputError for one without effect, too."""
    followed = recipe_for(arch, name)
    for field in sorted({*changes} & unused_fields(find(arch))):
        raise InputError(
            f"{field} is given and has no effect on the training of {arch}; expected fields that "
            f"have one: leave --{field.replace('_', '-')} out."
        )
    return replace(followed, **changes)


def recipe_for(arch: str, name: str) -> Recipe:
    """The recipe of a name, with the changes that an architecture declares.

    A recipe that only the architecture has is a change of the tuned one. InputError for an unknown
    architecture or recipe, or changes of fields that a recipe does not have.
    """
    own = find(arch).recipes
    check_choice("recipe", name, {**RECIPES, **own})
    try:
        return replace(RECIPES.get(name, RECIPES["tuned"]), **{"name": name, **own.get(name, {})})
    except TypeError as error:
        raise InputError(
            f"recipe {name!r} of architecture {arch!r} cannot be followed ({error}); expected "
            "fields of pipeline.networks.recipes.Recipe."
        ) from error
