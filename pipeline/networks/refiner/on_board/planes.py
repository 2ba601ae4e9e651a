"""One craft's encounters and the planes there, on tensors: ``refiner.planes`` without a branch."""

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from pipeline.networks.refiner.grid import Grid
from pipeline.networks.refiner.nearest import LEVEL
from pipeline.networks.refiner.planes import STILL, TOUCHING, Planes

Cubic = tuple[Tensor, Tensor, Tensor, Tensor]
"""p0, v0, a2, a3 of p0 + v0 s + a2 s² + a3 s³, each (k, 3)."""


def cubic(ends: Float[Tensor, "k 2 6"]) -> Cubic:
    """The cubic of relative motion between states at both ends of an interval."""
    p0, v0, p1, v1 = ends.reshape(-1, 4, 3).unbind(dim=1)
    return p0, v0, 3 * (p1 - p0) - 2 * v0 - v1, 2 * (p0 - p1) + v0 + v1


def position(motion: Cubic, share: Float[Tensor, "k"]) -> Float[Tensor, "k 3"]:
    """Where the cubic is."""
    (p0, v0, a2, a3), s = motion, share[:, None]
    return p0 + s * (v0 + s * (a2 + s * a3))


def velocity(motion: Cubic, share: Float[Tensor, "k"]) -> Float[Tensor, "k 3"]:
    """How fast it moves."""
    (_, v0, a2, a3), s = motion, share[:, None]
    return v0 + s * (2 * a2 + 3 * s * a3)


def turns(motion: Cubic, share: Float[Tensor, "k"]) -> Bool[Tensor, "k"]:
    """Whether 0 comes closer before and parts after, where the cubic is closest to it."""
    gap, speed = position(motion, share), velocity(motion, share)
    level = (gap * speed).sum(dim=1).square() <= LEVEL**2 * (
        gap.square().sum(dim=1) * speed.square().sum(dim=1)
    )
    return ((share > 0) & (share < 1)) | level


def planes(
    interval: Int[Tensor, "k"],
    share: Float[Tensor, "k"],
    motion: Cubic,
    grid: Grid,
) -> Planes:
    """The planes between craft whose relative motion is a cubic."""
    gap, speed = position(motion, share), velocity(motion, share)
    touching = (torch.linalg.vector_norm(gap, dim=1) < TOUCHING)[:, None]
    along = _unit(torch.where(touching, _across(speed), gap))
    past = speed - (speed * along).sum(dim=1, keepdim=True) * along
    still = torch.linalg.vector_norm(past, dim=1, keepdim=True) < STILL
    return Planes(
        distance=(gap * along).sum(dim=1),
        gain=_rows(interval, share, along, grid.nodes) @ grid.reach,
        along=along,
        motion=_unit(torch.where(still, _across(along), past)),
        speed=torch.linalg.vector_norm(speed, dim=1),
    )


def _across(vector: Float[Tensor, "k 3"]) -> Float[Tensor, "k 3"]:
    """Some vector at right angles to each, also to none."""
    axis = torch.eye(3, dtype=vector.dtype)[vector.abs().argmin(dim=1)]
    across = torch.linalg.cross(vector, axis)
    none = torch.linalg.vector_norm(across, dim=1, keepdim=True) < STILL
    return torch.where(none, axis, across)


def _unit(vector: Float[Tensor, "k 3"]) -> Float[Tensor, "k 3"]:
    """Vectors of length 1."""
    return vector / torch.linalg.vector_norm(vector, dim=1, keepdim=True).clamp(min=1e-12)


def _rows(
    interval: Int[Tensor, "k"],
    share: Float[Tensor, "k"],
    normal: Float[Tensor, "k 3"],
    nodes: int,
) -> Float[Tensor, "k _"]:
    """A plane's normal times the position there and then, as a row over the states of all nodes."""
    s, r = share, 1 - share
    weights = torch.stack([r * r * (1 + 2 * s), s * r * r, s * s * (1 + 2 * r), -s * s * r], dim=1)
    both = (weights[:, :, None] * normal[:, None, :]).reshape(-1, 12)
    columns = 6 * interval[:, None] + torch.arange(12)
    return normal.new_zeros(normal.shape[0], 6 * nodes).scatter(1, columns, both)
