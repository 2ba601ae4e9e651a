"""The two sides of every encounter, sorted into a table with a row for each craft."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor


@dataclass(frozen=True, eq=False)
class Sides:
    """Where in the table the sides of L encounters are; C craft with p sides at most.

    Attributes:
        craft: the craft of each row, (C,).
        most: p.
        place: of each side, in the flattened table, (2L,).
    """

    craft: Int[Tensor, "C"]
    most: int
    place: Int[Tensor, "_"]

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

    @property
    def real(self) -> Bool[Tensor, "C p"]:
        """Where there is a side."""
        none = torch.zeros(len(self.craft) * self.most, dtype=torch.bool, device=self.place.device)
        return none.index_fill(0, self.place, True).reshape(len(self.craft), self.most)


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
    return Sides(ids, most, place)
