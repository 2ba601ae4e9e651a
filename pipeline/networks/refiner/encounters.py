"""Where craft meet: pairs and intervals, and how close they come there.

Within an interval of two minutes the relative position is, to some millimetres, the cubic that has
the positions and velocities of both ends. So everything about an encounter, the plane that keeps
the pair apart included, is linear in the states of the interval's two nodes.
"""

from dataclasses import dataclass, fields

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from pipeline.networks.refiner.compiled import numbers
from pipeline.networks.refiner.nearest import close_pairs, nearest


@dataclass(frozen=True, eq=False)
class Encounters:
    """Pairs of craft in intervals; all lengths here are in r_col, times in Δt.

    Attributes:
        first: first craft, (k,).
        second: second craft, (k,).
        interval: which interval, (k,).
    """

    first: Int[Tensor, "k"]
    second: Int[Tensor, "k"]
    interval: Int[Tensor, "k"]

    def of(self, rows: Int[Tensor, "j"]) -> "Encounters":
        """Some of them."""
        return Encounters(*(getattr(self, one.name)[rows] for one in fields(self)))

    @property
    def both(self) -> tuple[Int[Tensor, "k"], Int[Tensor, "k"]]:
        """First and second craft."""
        return self.first, self.second

    @property
    def craft(self) -> Int[Tensor, "k 2"]:
        """The same as pairs."""
        return torch.stack(self.both, dim=1)


@dataclass(frozen=True, eq=False)
class Look:
    """When and how close the craft of each encounter come; gradients do not run through it.

    Attributes:
        share: when, as a share of the interval, (k,); 0 where it was not looked at.
        distance: (k,); infinite where it was not looked at.
        turns: whether the pair comes closer before and parts after it, (k,); where not, they are
            closer in the interval before or after.
    """

    share: Float[Tensor, "k"]
    distance: Float[Tensor, "k"]
    turns: Bool[Tensor, "k"]


def candidates(
    states: Float[Tensor, "N T 6"], n: int, within: float, of_extent: float = 0.0
) -> Encounters:
    """Pairs of the same swarm of n, and intervals in which they come within a distance.

    Args:
        states: of all craft.
        n: craft of each swarm.
        within: the distance, r_col.
        of_extent: the same as a part of the swarm's extent, where that is more.
    """
    least = (of_extent * extents(states, n)).clamp(min=within)
    found = close_pairs(numbers(states), n, numbers(least))
    return Encounters(*torch.from_numpy(found).to(states.device))


def extents(states: Float[Tensor, "N T 6"], n: int) -> Float[Tensor, "b"]:
    """Half of the longest side of a box around each swarm at all nodes, r_col."""
    position = states[..., :3].reshape(states.shape[0] // n, -1, 3)
    return (position.amax(dim=1) - position.amin(dim=1)).amax(dim=1) / 2


def look(
    met: Encounters, states: Float[Tensor, "N T 6"], within: Float[Tensor, "k"] | None = None
) -> Look:
    """When and how close craft of given node states come.

    Args:
        met: pairs and intervals.
        states: of all craft.
        within: distance beyond which an encounter may go unseen, as infinitely far away, r_col;
            all are seen by default.
    """
    share, distance = torch.empty(2, len(met.first), dtype=torch.float64)
    turns = torch.empty(len(met.first), dtype=torch.bool)
    within = torch.full_like(share, torch.inf) if within is None else within
    everybody = torch.ones(len(states), dtype=torch.bool)
    return look_again(Look(share, distance, turns), met, states, within, everybody)


def look_again(
    before: Look,
    met: Encounters,
    states: Float[Tensor, "N T 6"],
    within: Float[Tensor, "k"],
    moved: Bool[Tensor, "N"],
) -> Look:
    """The same where craft have moved; two of which neither has are as near as before.

    Args:
        before: what was found then.
        met: pairs and intervals.
        states: of all craft.
        within: distance beyond which an encounter may go unseen, as infinitely far away, r_col.
        moved: which craft have moved.
    """
    share, distance, turns = (
        part.to("cpu", copy=True) for part in (before.share, before.distance, before.turns)
    )
    given = (states, met.first, met.second, met.interval, within, moved)
    nearest(*map(numbers, given), share.numpy(), distance.numpy(), turns.numpy())
    return Look(*(part.to(states.device) for part in (share, distance, turns)))
