"""The two sides of every encounter, sorted by craft."""

from dataclasses import dataclass
from typing import no_type_check

import numpy as np
import torch
from jaxtyping import Int
from numba import njit
from torch import Tensor

from pipeline.networks.refiner.compiled import numbers


@dataclass(frozen=True, eq=False)
class Sides:
    """Where the sides of L encounters are; encounter l has the sides 2l and 2l + 1.

    Attributes:
        craft: the craft that meet anybody, in order, (C,).
        start: where the sides of each begin in ``order``, and their number, (C + 1,).
        order: all sides, one craft's after the other's, (2L,).
    """

    craft: Int[Tensor, "C"]
    start: Int[Tensor, "_"]
    order: Int[Tensor, "_"]

    @property
    def place(self) -> Int[Tensor, "_"]:
        """Whose each side is, as a place in ``craft``."""
        each = torch.arange(len(self.craft), device=self.craft.device)
        mine = each.repeat_interleave(self.start.diff())
        return torch.empty_like(self.order).index_copy(0, self.order, mine)


def sides_of(craft: Int[Tensor, "L 2"], most: int) -> Sides:
    """The sides of encounters between craft.

    Args:
        craft: both craft of each.
        most: craft that there are at all.
    """
    found = _sorted(numbers(craft.reshape(-1)), most)
    return Sides(*(torch.from_numpy(part).to(craft.device) for part in found))


@no_type_check
@njit(cache=True)
def _sorted(craft, most):
    """The craft that there are, where their sides begin, and the sides, by counting."""
    before = np.zeros(most + 1, np.int64)
    for one in craft:
        before[one + 1] += 1
    there = np.nonzero(before[1:])[0]
    before = np.cumsum(before)
    start = np.append(before[there], len(craft))
    order = np.empty(len(craft), np.int64)
    for side in range(len(craft)):
        one = craft[side]
        order[before[one]] = side
        before[one] += 1
    return there, start, order
