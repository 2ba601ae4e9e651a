"""When craft are closest within an interval, as ``refiner.nearest`` finds it, on tensors."""

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.networks.refiner.nearest import NEWTON_STEPS, STRETCHES
from pipeline.networks.refiner.on_board.planes import Cubic, position, velocity


def nearest(motion: Cubic) -> Float[Tensor, "k"]:
    """When the cubic is closest to 0, as a share of the interval."""
    times = _looked_at(motion)
    squares = torch.stack([_motion(motion, s)[0] for s in times])
    first, least = squares.argmin(dim=0, keepdim=True), squares.amin(dim=0)
    when = torch.stack(times).gather(0, first)[0]
    low, high = (when - 1 / STRETCHES).clamp(min=0.0), (when + 1 / STRETCHES).clamp(max=1.0)
    s = when
    for _ in range(NEWTON_STEPS):
        _, slope, curvature = _motion(motion, s)
        flat = torch.sign(slope) * (high - low) / 4
        step = torch.where(curvature > 0, slope / curvature, flat)
        s = torch.minimum(torch.maximum(s - step, low), high)
        square, _, _ = _motion(motion, s)
        when = torch.where(square < least, s, when)
        least = torch.minimum(square, least)
    return when


def _looked_at(motion: Cubic) -> list[Float[Tensor, "k"]]:
    """Both ends of every stretch, and where 0 is closest on the straight way between them."""
    zero = torch.zeros_like(motion[0][:, 0])
    times = [zero]
    for stretch in range(STRETCHES):
        begin, end = stretch / STRETCHES, (stretch + 1) / STRETCHES
        here = position(motion, zero + begin)
        way = position(motion, zero + end) - here
        length = way.square().sum(dim=1)
        share = (-(here * way).sum(dim=1) / length).clamp(0.0, 1.0)
        share = torch.where(length > 0, share, 0.0)
        times += [begin + share * (end - begin), zero + end]
    return times


def _motion(motion: Cubic, s: Float[Tensor, "k"]) -> tuple[Tensor, Tensor, Tensor]:
    """|p|² at a time, and half its first two derivatives, each (k,)."""
    _, _, a2, a3 = motion
    p, v = position(motion, s), velocity(motion, s)
    curvature = v.square() + p * (2 * a2 + 6 * s[:, None] * a3)
    return p.square().sum(dim=1), (p * v).sum(dim=1), curvature.sum(dim=1)
