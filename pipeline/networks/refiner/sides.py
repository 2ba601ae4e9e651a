"""The two sides of every encounter, sorted by craft: in a list, or a table with a row for each."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor


@dataclass(frozen=True, eq=False)
class Sides:
    """Where the sides of L encounters are; C craft with p sides at most.

    Attributes:
        craft: the craft that meet anybody, in order, (C,).
        count: sides of each, (C,).
        order: which side is where in the list, (2L,).
        most: p.
        place: of each side, in the flattened table, (2L,).
    """

    craft: Int[Tensor, "C"]
    count: Int[Tensor, "C"]
    order: Int[Tensor, "_"]
    most: int
    place: Int[Tensor, "_"]

    def listed(self, values: Float[Tensor, "L 2 *rest"]) -> Float[Tensor, "_ *rest"]:
        """What belongs to each side, one craft's after the other's."""
        return values.flatten(0, 1).index_select(0, self.order)

    def unlisted(self, values: Float[Tensor, "S"]) -> Float[Tensor, "L 2"]:
        """What the list has for each side."""
        return torch.empty_like(values).index_copy(0, self.order, values).reshape(-1, 2)

    def table(self, values: Float[Tensor, "L 2 *rest"]) -> Float[Tensor, "C p *rest"]:
        """What belongs to each side, by craft; 0 where a craft has fewer."""
        flat = values.flatten(0, 1)
        empty = flat.new_zeros(len(self.craft) * self.most, *flat.shape[1:])
        table = empty.index_copy(0, self.place, flat)
        return table.reshape(len(self.craft), self.most, *flat.shape[1:])

    def back(self, table: Float[Tensor, "C p *rest"]) -> Float[Tensor, "L 2 *rest"]:
        """What the table has for each side."""
        flat = table.flatten(0, 1).index_select(0, self.place)
        return flat.reshape(-1, 2, *flat.shape[1:])

    def each(self, rows: Float[Tensor, "C *rest"]) -> Float[Tensor, "L 2 *rest"]:
        """What each craft has, for each of its sides."""
        flat = rows.index_select(0, self.place // self.most)
        return flat.reshape(-1, 2, *flat.shape[1:])


def sides_of(craft: Int[Tensor, "L 2"]) -> Sides:
    """The table of encounters between craft."""
    flat = craft.reshape(-1)
    order = torch.argsort(flat, stable=True)
    ids, count = torch.unique_consecutive(flat[order], return_counts=True)
    most = int(count.max())
    row = torch.arange(len(ids), device=flat.device).repeat_interleave(count)
    before = (count.cumsum(0) - count).repeat_interleave(count)
    slot = torch.arange(len(flat), device=flat.device) - before
    place = torch.empty_like(flat)
    place[order] = row * most + slot
    return Sides(ids, count, order, most, place)
