"""Supervised learning of the expert's trajectories, from encoded to encoded states."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

import torch
from torch import Tensor, nn

from pipeline.arrays import Float
from pipeline.errors import InputError
from pipeline.networks.architecture import Swarms, TensorBatch
from pipeline.networks.document import Answer
from pipeline.networks.encoding import Encoding, Trajectories
from pipeline.networks.recipes import Recipe


def collision_penalty(
    positions: Float[Tensor, "b n T 3"], collision_radius: float
) -> Float[Tensor, ""]:
    """Mean over instances of Σ max(0, 1 - d/r_col)² over pairs and nodes, d the distance in m.

    A smooth surrogate of Eq. 5: it is 0 exactly where no pair is within the collision radius at
    a node, and each collision adds up to 1, more where it is deeper.
    """
    n = positions.shape[1]
    i, j = torch.triu_indices(n, n, 1, device=positions.device)
    # Copies whole trajectories, in both passes, while brackets would copy number by number.
    gap = positions.index_select(1, i) - positions.index_select(1, j)  # (b, p, T, 3)
    distance = torch.linalg.vector_norm(gap, dim=-1)
    depth = torch.relu(1 - distance / collision_radius)
    return depth.square().sum(dim=(1, 2)).mean()


class Supervised(ABC):
    """Base of the paper's six: an ``Architecture`` without its network and forward pass."""

    collision: bool = False  # whether the loss has the collision penalty
    answers: ClassVar[Answer] = "states"  # which obey no dynamics
    objective: ClassVar[str] = "valid_position_rmse"  # from the expert's on validation data, m
    recipes: ClassVar[Mapping[str, Mapping[str, Any]]] = {}  # changes of the recipes

    @property
    def config(self) -> Mapping[str, Any]:
        """No sizes."""
        return {}

    @property
    def unused(self) -> frozenset[str]:
        """Recipe fields that training ignores: ``crowded``, and mostly ``collision_weight``."""
        return frozenset({"crowded"} if self.collision else {"crowded", "collision_weight"})

    @abstractmethod
    def network(self, config: Mapping[str, Any], encoding: Encoding, dropout: float) -> nn.Module:
        """As in ``Architecture``."""

    @abstractmethod
    def forward(self, network: nn.Module, inputs: Trajectories, encoding: Encoding) -> Trajectories:
        """The network's output for any number of craft n ≥ 1.

        Both are float32, in the units of the encoding, with axes batch, craft, node and state
        component; in the input the first and last node hold the initial and goal state.
        """

    def prepare(self, swarms: Swarms, encoding: Encoding) -> TensorBatch:
        """Inputs and targets in float32."""
        if swarms.states is None or swarms.states.isnan().any():
            raise InputError(
                "this network learns from the expert's plans, and the scenarios have none; "
                "expected a recipe with draws 0 and crowded 0, and a solved dataset."
            )
        inputs = _inputs(swarms, encoding)
        target = encoding.targets(swarms.states.numpy(), inputs)
        return {"inputs": inputs.float(), "target": target.float()}

    def loss(
        self, network: nn.Module, batch: TensorBatch, encoding: Encoding, recipe: Recipe
    ) -> Float[Tensor, ""]:
        """Mean square error in encoded units, plus the collision penalty if there is one."""
        output = self.forward(network, batch["inputs"], encoding)
        loss = (output - batch["target"]).square().mean()
        if not self.collision or recipe.collision_weight == 0:
            return loss
        positions = encoding.decode(output, batch["inputs"])[..., :3]
        penalty = collision_penalty(positions, encoding.problem.collision_radius)
        return loss + recipe.collision_weight * penalty

    def score(
        self, network: nn.Module, batch: TensorBatch, encoding: Encoding, recipe: Recipe
    ) -> Float[Tensor, ""]:
        """The loss."""
        return self.loss(network, batch, encoding, recipe)

    def answer(self, network: nn.Module, swarms: Swarms, encoding: Encoding) -> Trajectories:
        """States decoded from the network's output."""
        inputs = _inputs(swarms, encoding)
        output = self.forward(network, inputs.float(), encoding)
        return encoding.decode(output.double(), inputs)


def _inputs(swarms: Swarms, encoding: Encoding) -> Trajectories:
    return encoding.inputs(swarms.initial.numpy(), swarms.goal.numpy())
