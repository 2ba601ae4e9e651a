"""What the sides of an encounter see, and by what the planes of a craft are alike."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from pipeline.networks.refiner.encounters import Approach, Encounters
from pipeline.networks.refiner.grid import Grid
from pipeline.networks.refiner.program import Own


@dataclass(frozen=True, eq=False)
class Meeting:
    """Some encounters as they are in a round.

    Attributes:
        met: pairs and intervals.
        found: their closest approaches.
        along: unit vector along the gap, (L, 3).
        motion: unit vector along the motion past it, (L, 3).
        gain: how the first craft's controls move it along the gap, (L, m).
        price: what the plane cost either craft in the round before, (L, 2).
        first_price: what the first unit costs either craft, (L, 2).
        number: of the round.
    """

    met: Encounters
    found: Approach
    along: Float[Tensor, "L 3"]
    motion: Float[Tensor, "L 3"]
    gain: Float[Tensor, "L m"]
    price: Float[Tensor, "L 2"]
    first_price: Float[Tensor, "L 2"]
    number: int | Int[Tensor, ""]


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


@torch.no_grad()
def seen(
    meeting: Meeting, own: Own, controls: Float[Tensor, "N m"], grid: Grid
) -> Float[Tensor, "L 2 F"]:
    """What each side sees."""
    price, craft, N = meeting.price, meeting.met.craft, len(controls)

    def total(values: Float[Tensor, "L 2"]) -> Float[Tensor, "L 2"]:
        """Sum over all sides of the same craft."""
        return values.new_zeros(N).index_add(0, craft.reshape(-1), values.reshape(-1))[craft]

    spent = (controls.abs() - own.controls.abs()).sum(dim=1)
    standing = Standing(total(torch.ones_like(price)), total(price), spent[craft])
    return features(meeting, standing, grid)


def features(meeting: Meeting, standing: Standing, grid: Grid) -> Float[Tensor, "L 2 F"]:
    """Prices and fuel of each side's craft, the encounter, and directions from there."""
    found, price = meeting.found, meeting.price
    gain = torch.linalg.vector_norm(meeting.gain, dim=1)
    speed = torch.linalg.vector_norm(found.speed, dim=1)
    shared = [
        3 * (1 - found.distance).clamp(-2, 2),
        (found.distance < 1).to(price.dtype),
        (meeting.met.interval + found.share) / (grid.nodes - 1),
        (speed + 0.1).log(),
        (gain + 1e-3).log(),
        torch.zeros_like(speed) + meeting.number / 8,
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
    around = torch.cat([meeting.along, meeting.motion], dim=1)
    return torch.cat([numbers, torch.stack([around, -around], dim=1)], dim=2).float()


def free_directions(gain: Float[Tensor, "L m"], grid: Grid) -> Float[Tensor, "L m"]:
    """How controls that keep the goal move each plane most, as unit vectors."""
    free = gain.detach() @ grid.free
    return (free / torch.linalg.vector_norm(free, dim=1, keepdim=True).clamp(min=1e-9)).float()
