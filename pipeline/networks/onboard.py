"""A model as one graph from end states to node states in m and m/s, for use on board."""

from functools import lru_cache

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from pipeline.arrays import Array
from pipeline.networks.encoding import Encoding
from pipeline.networks.interior import INTERIORS
from pipeline.networks.model import Model
from pipeline.networks.supervised import Supervised
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import fly, project_to_flyable


class OnBoard(nn.Module):
    """Encoding, network and decoding in float32, all of it torch, for any batch.

    Attributes:
        read: linear map from both end states of a craft to its input trajectory, (12, 6T).
    """

    read: Tensor

    def __init__(self, architecture: Supervised, model: Model) -> None:
        super().__init__()
        self.architecture = architecture
        self.encoding = model.encoding
        self.network = model.network
        self.register_buffer("read", torch.from_numpy(input_map(model.encoding)).float())

    def forward(
        self, initial: Float[Tensor, "b n 6"], goal: Float[Tensor, "b n 6"]
    ) -> tuple[Tensor, ...]:
        """Node states (b, n, T, 6), m and m/s, as the network predicts them."""
        ends = torch.cat([initial, goal], dim=-1)  # (b, n, 12)
        inputs = (ends @ self.read).reshape(*initial.shape[:2], -1, 6)  # (b, n, T, 6)
        output = self.architecture.forward(self.network, inputs, self.encoding)
        return (self.encoding.decode(output, inputs),)


class OnBoardFlown(OnBoard):
    """The same, then projected onto the transfers that obey the dynamics and both ends.

    Attributes:
        flyable: linear map from predicted states and both ends of a craft to flown states and
            controls, (6T + 12, 6T + 3(T-1)).
    """

    flyable: Tensor

    def __init__(self, architecture: Supervised, model: Model) -> None:
        super().__init__(architecture, model)
        self.register_buffer("flyable", torch.from_numpy(flyable_map(model.problem)))

    def forward(
        self, initial: Float[Tensor, "b n 6"], goal: Float[Tensor, "b n 6"]
    ) -> tuple[Tensor, ...]:
        """Node states (b, n, T, 6) that can be flown, and their controls (b, n, T-1, 3), m/s²."""
        (predicted,) = super().forward(initial, goal)
        T = self.encoding.problem.nodes
        known = torch.cat([predicted.flatten(2), initial, goal], dim=-1).double()
        # In float64: what the controls reach is a small difference of large terms.
        flown = (known @ self.flyable).float()  # (b, n, 6T + 3(T-1))
        states, controls = flown[..., : 6 * T], flown[..., 6 * T :]
        return states.reshape(predicted.shape), controls.reshape(*initial.shape[:2], T - 1, 3)


def input_map(encoding: Encoding) -> Float[Array, "12 _"]:
    """What a craft's encoded input is of its initial and goal state: every interior is linear."""
    unit = np.eye(12)
    given = INTERIORS[encoding.interior](unit[:, :6], unit[:, 6:], encoding.problem)
    return (given / np.array(encoding.input_scale)).reshape(12, -1)


@lru_cache(maxsize=8)
def flyable_map(problem: Problem) -> Float[Array, "_ _"]:
    """Flown states and controls of a craft from its predicted states and both ends: linear too."""
    T = problem.nodes
    unit = np.eye(6 * T + 12)
    states, initial, goal = np.split(unit, [6 * T, 6 * T + 6], axis=1)
    controls = project_to_flyable(states.reshape(-1, T, 6), initial, goal, problem)
    flown = fly(initial, controls, problem)
    return np.hstack([flown.reshape(len(unit), -1), controls.reshape(len(unit), -1)])
