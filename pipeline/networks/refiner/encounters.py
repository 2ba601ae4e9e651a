"""Where craft meet: pairs and intervals, and how close they come there.

Within an interval the relative position is, to some tenths of a millimetre, the cubic that has
the positions and velocities of both ends. So everything about an encounter, the plane that keeps
the pair apart included, is linear in the states of the interval's two nodes.
"""

from dataclasses import dataclass, fields

import torch
from jaxtyping import Float, Int
from torch import Tensor

from pipeline.networks.refiner.compiled import numbers
from pipeline.networks.refiner.nearest import close_pairs, nearest

TOUCHING = 1e-4
"""Distance in r_col under which two craft give no direction of their own."""

STILL = 1e-9
"""Relative speed in r_col/Δt under which two craft do not move past each other."""


Cubic = tuple[Tensor, Tensor, Tensor, Tensor]
"""p0, v0, a2, a3 of p0 + v0 s + a2 s² + a3 s³, each (k, 3)."""


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

    def relative(self, states: Float[Tensor, "N T 6"]) -> Float[Tensor, "k 2 6"]:
        """State of the first craft relative to the second at both ends of the interval."""
        N, T, _ = states.shape
        flat = states.reshape(N * T, 6)
        node = self.interval[:, None] + torch.arange(2, device=states.device)
        # Copies whole states, forth and back, where brackets would copy number by number.
        one, other = (
            flat.index_select(0, (craft[:, None] * T + node).reshape(-1)) for craft in self.both
        )
        return (one - other).reshape(-1, 2, 6)


@dataclass(frozen=True, eq=False)
class Look:
    """When and how close the craft of each encounter come; gradients do not run through it.

    Attributes:
        share: when, as a share of the interval, (k,); 0 where it was not looked at.
        distance: (k,); infinite where it was not looked at.
    """

    share: Float[Tensor, "k"]
    distance: Float[Tensor, "k"]


@dataclass(frozen=True, eq=False)
class Approach:
    """The closest approach of each encounter.

    Attributes:
        share: when, as a share of the interval, (k,); gradients do not run through it.
        gap: position of the first craft relative to the second, (k, 3).
        speed: their relative velocity, (k, 3).
        distance: (k,).
    """

    share: Float[Tensor, "k"]
    gap: Float[Tensor, "k 3"]
    speed: Float[Tensor, "k 3"]
    distance: Float[Tensor, "k"]


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
    within = torch.full_like(share, torch.inf) if within is None else within
    given = (states, met.first, met.second, met.interval, within)
    nearest(*map(numbers, given), share.numpy(), distance.numpy())
    return Look(share.to(states.device), distance.to(states.device))


def cubic(ends: Float[Tensor, "k 2 6"]) -> Cubic:
    """The cubic of relative motion between states at both ends of an interval."""
    p0, v0, p1, v1 = ends.reshape(-1, 4, 3).unbind(dim=1)
    return p0, v0, 3 * (p1 - p0) - 2 * v0 - v1, 2 * (p0 - p1) + v0 + v1


def approach(ends: Float[Tensor, "k 2 6"], share: Float[Tensor, "k"]) -> Approach:
    """The approach of relative motion between states at both ends of an interval, at a time."""
    p0, v0, a2, a3 = cubic(ends)
    s = share[:, None]
    gap = p0 + s * (v0 + s * (a2 + s * a3))
    speed = v0 + s * (2 * a2 + 3 * s * a3)
    return Approach(share, gap, speed, torch.linalg.vector_norm(gap, dim=1))


def directions(found: Approach) -> tuple[Float[Tensor, "k 3"], Float[Tensor, "k 3"]]:
    """Unit vectors at each encounter: along the gap, along the motion past it.

    Where the two craft touch, the gap's is any across the motion.
    """
    speed = found.speed.detach()
    touching = (found.distance.detach() < TOUCHING)[:, None]
    along = unit(torch.where(touching, _across(speed), found.gap))
    past = speed - (speed * along).sum(dim=1, keepdim=True) * along
    still = torch.linalg.vector_norm(past, dim=1, keepdim=True) < STILL
    motion = unit(torch.where(still, _across(along), past))
    return along, motion


def _across(vector: Float[Tensor, "k 3"]) -> Float[Tensor, "k 3"]:
    """Some vector at right angles to each, also to none."""
    axes = torch.eye(3, dtype=vector.dtype, device=vector.device)
    axis = axes[vector.detach().abs().argmin(dim=1)]
    across = torch.linalg.cross(vector, axis)
    none = torch.linalg.vector_norm(across, dim=1, keepdim=True) < STILL
    return torch.where(none, axis, across)


def unit(vector: Float[Tensor, "k 3"]) -> Float[Tensor, "k 3"]:
    """Vectors of length 1."""
    return vector / torch.linalg.vector_norm(vector, dim=1, keepdim=True).clamp(min=1e-12)


def plane_rows(
    met: Encounters, share: Float[Tensor, "k"], normal: Float[Tensor, "k 3"], nodes: int
) -> Float[Tensor, "k _"]:
    """A plane's normal times the position there and then, as a row over the states of all nodes.

    The weights are Hermite's cubics, by which positions follow from both ends.
    """
    s, r = share, 1 - share
    weights = torch.stack([r * r * (1 + 2 * s), s * r * r, s * s * (1 + 2 * r), -s * s * r], dim=1)
    both = (weights[:, :, None] * normal[:, None, :]).reshape(-1, 12)
    columns = 6 * met.interval[:, None] + torch.arange(12, device=normal.device)
    return normal.new_zeros(normal.shape[0], 6 * nodes).scatter(1, columns, both)
