"""What one craft and its encounters see, on tensors: ``refiner.seen`` as formulas."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Float32, Int
from torch import Tensor

from pipeline.networks.refiner.grid import Grid
from pipeline.networks.refiner.seen import Meeting


@dataclass(frozen=True, eq=False)
class Standing:
    """How much else there is to either craft of L encounters.

    Attributes:
        sides: number of its encounters, (L, 2).
        price: the sum of their prices, (L, 2).
        spent: fuel over its own optimum, (L, 2).
    """

    sides: Float[Tensor, "L 2"]
    price: Float[Tensor, "L 2"]
    spent: Float[Tensor, "L 2"]


def seen(
    meeting: Meeting, standing: Standing, grid: Grid, number: int | Int[Tensor, ""]
) -> Float32[Tensor, "L 2 F"]:
    """Prices and fuel of each side's craft, the encounter, and directions from there."""
    planes, price = meeting.planes, meeting.price
    shared = [
        3 * (1 - planes.distance).clamp(-2, 2),
        (planes.distance < 1).to(price.dtype),
        (meeting.met.interval + meeting.share) / (grid.nodes - 1),
        (planes.speed + 0.1).log(),
        (torch.linalg.vector_norm(planes.gain, dim=1) + 1e-3).log(),
        torch.zeros_like(planes.speed) + number / 8,
    ]
    alone = [
        meeting.first_price.log(),
        price.clamp(max=5),
        (price + 1e-3).log(),
        standing.sides / 4,
        standing.price.clamp(max=10),
        standing.spent.clamp(max=5),
    ]
    numbers = torch.stack([*(x[:, None].expand_as(price) for x in shared), *alone], dim=2)
    around = torch.cat([planes.along, planes.motion], dim=1)
    return torch.cat([numbers, torch.stack([around, -around], dim=1)], dim=2).float()
