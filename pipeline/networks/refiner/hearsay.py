"""What the sides of a craft tell each other, and the others like them the more."""

from typing import Any, no_type_check

import numpy as np
import torch
from jaxtyping import Float
from numba import njit
from torch import Tensor

from pipeline.networks.refiner.compiled import numbers
from pipeline.networks.refiner.sides import Sides


def heard(
    told: Float[Tensor, "L 2 H"], free: Float[Tensor, "L m"], sides: Sides
) -> Float[Tensor, "L 2 _"]:
    """What each side hears of its craft's sides, itself included: H numbers, and H more.

    Args:
        told: what each side tells.
        free: unit vector of each encounter's plane; sides that meet it from behind have its
            negative.
        sides: which craft they are of.

    Returns:
        The sum of what is told, weighed by the cosines between the planes, and the plain sum.
    """
    both = torch.cat([told, told], dim=2)
    found: Tensor = _Heard.apply(both, free, sides)  # type: ignore[no-untyped-call]
    return found


class _Heard(torch.autograd.Function):
    """The two sums, compiled; both are symmetric, so gradients go back as values come."""

    @staticmethod
    def forward(ctx: Any, told: Tensor, free: Tensor, sides: Sides) -> Tensor:
        ctx.free, ctx.sides = free, sides
        return _sums(told, free, sides)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None]:
        return _sums(gradient, ctx.free, ctx.sides), None, None


def _sums(
    told: Float[Tensor, "L 2 _"], free: Float[Tensor, "L m"], sides: Sides
) -> Float[Tensor, "L 2 _"]:
    result = torch.zeros_like(told, device="cpu", memory_format=torch.contiguous_format)
    add_up(*map(numbers, (told, free, sides.start, sides.order)), result.numpy())
    return result.to(told.device)


@no_type_check
@njit(cache=True, fastmath=True)
def add_up(told, free, start, order, result):
    """Both sums, where sides 2l and 2l + 1 are those of encounter l.

    Args:
        told: what goes into the first sum and into the second, (L, 2, 2H).
        free: unit vectors, (L, m).
        start: where the sides of each craft begin in ``order``, (C + 1,).
        order: all sides, (2L,).
        result: zeros, which become the sums, (L, 2, 2H).
    """
    m, H = free.shape[1], told.shape[2] // 2
    every = np.empty(H, told.dtype)
    for c in range(len(start) - 1):
        every[:] = 0.0
        for a in range(start[c], start[c + 1]):
            for h in range(H):
                every[h] += told[order[a] >> 1, order[a] & 1, H + h]
        for a in range(start[c], start[c + 1]):
            one, at = order[a] >> 1, order[a] & 1
            for h in range(H):
                result[one, at, H + h] = every[h]
            for b in range(start[c], a + 1):
                other, there = order[b] >> 1, order[b] & 1
                cosine = told.dtype.type(0.0)
                for x in range(m):
                    cosine += free[one, x] * free[other, x]
                if at != there:
                    cosine = -cosine
                for h in range(H):
                    result[one, at, h] += cosine * told[other, there, h]
                if a != b:
                    for h in range(H):
                        result[other, there, h] += cosine * told[one, at, h]
