"""What supervised training makes small: mean square error, and the penalty on collisions."""

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.networks.encoding import Encoding


def collision_penalty(
    positions: Float[Tensor, "b n T 3"], collision_radius: float
) -> Float[Tensor, ""]:
    """Mean over instances of Σ max(0, 1 - d/r_col)² over pairs and nodes, d the distance in m.

    A smooth stand-in for Eq. 5: it is 0 exactly where no pair is within the collision radius at
    a node, and each collision adds up to 1, the more the deeper it is.

    Args:
        positions: predicted positions, m.
        collision_radius: r_col, m.
    """
    n = positions.shape[1]
    i, j = torch.triu_indices(n, n, 1, device=positions.device)
    # Copies whole trajectories, forth and back, where brackets would copy number by number.
    gap = positions.index_select(1, i) - positions.index_select(1, j)  # (b, p, T, 3)
    distance = torch.linalg.vector_norm(gap, dim=-1)
    depth = torch.relu(1 - distance / collision_radius)
    return depth.square().sum(dim=(1, 2)).mean()


def supervised_loss(
    output: Float[Tensor, "b n T 6"],
    inputs: Float[Tensor, "b n T 6"],
    target: Float[Tensor, "b n T 6"],
    encoding: Encoding,
    collision_weight: float,
) -> Float[Tensor, ""]:
    """Mean square error in encoded units plus the weighted collision penalty.

    Args:
        output: the network's answer.
        inputs: what it read.
        target: what it should have answered.
        encoding: decodes the answer into positions.
        collision_weight: weight of the penalty; 0 leaves it out.
    """
    loss = (output - target).square().mean()
    if collision_weight == 0:
        return loss
    positions = encoding.decode(output, inputs)[..., :3]
    return loss + collision_weight * collision_penalty(positions, encoding.problem.collision_radius)
