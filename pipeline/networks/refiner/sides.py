"""The sides of separating planes by craft, and sums over the sides of each craft."""

from dataclasses import dataclass
from typing import Any, no_type_check

import numpy as np

from pipeline.arrays import Array, Float, Int, namespace, plain
from pipeline.networks.refiner.arrays import njit, self_adjoint


@dataclass(frozen=True, eq=False)
class Sides:
    """The sides of L planes, grouped by craft; plane l has the sides 2l and 2l + 1."""

    craft: Int[Any, "C"]  # the C craft with planes, in order
    start: Int[Any, "_"]  # where the sides of each begin in ``order``, and at last their number
    order: Int[Any, "S"]  # all sides, craft after craft
    place: Int[Any, "S"]  # of each side, the index of its craft in ``craft``

    @classmethod
    def of(cls, craft: Int[Any, "L 2"]) -> "Sides":
        """Both sides of separating planes between two craft each, by craft."""
        xp, flat = namespace(craft), craft.reshape(-1)
        there, place, count = xp.unique(flat, return_inverse=True, return_counts=True)
        start = xp.concatenate([count[:1] * 0, count.cumsum(0)])
        return cls(there, start, place.argsort(stable=True), place)

    def totals(self, values: Float[Any, "L 2"]) -> Float[Any, "L 2"]:
        """For each side, the sum of values over all sides of its craft."""
        return np.bincount(self.place, values.reshape(-1))[self.place].reshape(values.shape)

    def aggregate(
        self, messages: Float[Any, "L 2 H"], free: Float[Any, "L m"]
    ) -> Float[Any, "L 2 _"]:
        """Message aggregation: a cosine-weighted sum and a sum over the encounters of each craft.

        The cosine is that between the planes' normals, which the second craft sees reversed.
        """
        vectors = plain(free)

        def sums(values: Float[Array, "L 2 _"]) -> Float[Array, "L 2 _"]:
            result = np.zeros_like(values)
            add_up(values, vectors, self.start, self.order, result)
            return result

        return self_adjoint(sums, namespace(messages).concatenate([messages, messages], axis=2))


@no_type_check
@njit(cache=True, fastmath=True)
def add_up(messages, free, start, order, result):
    """Both sums, into ``result``, which begins as zeros; sides are those of ``Sides``.

    Messages, (L, 2, 2H), have the terms of the first sum and those of the second.
    """
    m, H = free.shape[1], messages.shape[2] // 2
    every = np.empty(H, messages.dtype)
    for c in range(len(start) - 1):
        every[:] = 0.0
        for a in range(start[c], start[c + 1]):
            for h in range(H):
                every[h] += messages[order[a] >> 1, order[a] & 1, H + h]
        for a in range(start[c], start[c + 1]):
            one, at = order[a] >> 1, order[a] & 1
            for h in range(H):
                result[one, at, H + h] = every[h]
            for b in range(start[c], a + 1):
                other, there = order[b] >> 1, order[b] & 1
                cosine = messages.dtype.type(0.0)
                for x in range(m):
                    cosine += free[one, x] * free[other, x]
                if at != there:
                    cosine = -cosine
                for h in range(H):
                    result[one, at, h] += cosine * messages[other, there, h]
                if a != b:
                    for h in range(H):
                        result[other, there, h] += cosine * messages[one, at, h]
