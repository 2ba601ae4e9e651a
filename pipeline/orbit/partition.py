"""Partition of stacked craft into independent swarms, and the pairs within each swarm."""

from functools import cached_property, lru_cache
from itertools import accumulate, pairwise, starmap
from typing import TYPE_CHECKING

import numpy as np

from pipeline.arrays import Array, Bool, Float, Int, Shaped
from pipeline.orbit.arrays import Controls, CraftMask, Indices, States, Values, Vectors

if TYPE_CHECKING:
    from pipeline.orbit.corridors import Faces

# Craft of a swarm, and pairs in all, up to which comparing all pairs is faster than a k-d tree
FEW, MOST_PAIRS = 128, 300_000
DISTANCES_AT_ONCE = 20_000  # distances of pairs that are computed at once, to fit in caches

Pairs = tuple[Int[Array, "p"], Int[Array, "p"]]


class SwarmPartition:
    """Partition of the craft axis into independent swarms of given sizes."""

    def __init__(self, sizes: tuple[int, ...]) -> None:
        self.sizes = sizes
        self.label = np.repeat(np.arange(len(sizes)), sizes)  # the swarm of each craft
        self.slices = list(starmap(slice, pairwise(accumulate(sizes, initial=0))))  # craft of each
        self.starts = np.array([craft.start for craft in self.slices])  # the first of these
        # Whether swarms are small enough to compare all pairs.
        self.few = max(sizes) <= FEW and sum(n * n for n in sizes) <= 2 * MOST_PAIRS
        self.held = np.zeros(0, dtype=int)  # participants that are held where they are
        self.faces: Faces | None = None  # half-spaces that craft stay inside of

    @cached_property
    def pairs(self) -> Pairs:
        """First and second craft of every pair i < j of a swarm."""
        first, second = zip(*(pairs(n) for n in self.sizes), strict=True)
        shift = np.repeat(self.starts, [len(one) for one in first])
        return np.concatenate(first) + shift, np.concatenate(second) + shift

    @cached_property
    def loss_pairs(self) -> Pairs:
        """Every pair of a craft that loses its thrust and another craft or obstacle."""
        one, other = self.pairs
        back = ~self.is_obstacle(other)
        return np.concatenate([one, other[back]]), np.concatenate([other, one[back]])

    def split(self, rows: Shaped[Array, "craft *rest"]) -> list[Shaped[Array, "_ *rest"]]:
        """Split an array of all craft into one array for each swarm."""
        return [rows[craft] for craft in self.slices]

    def per_craft(self, within: float | Float[Array, "swarms"]) -> Float[Array, "craft"]:
        """Expand one value for all swarms, or one for each swarm, to a value for each craft."""
        if isinstance(within, np.ndarray):
            return within.take(self.label)
        return np.full(len(self.label), within)

    def all_states(
        self, states: States, nodes: slice = slice(None)
    ) -> Float[Array, "participants T 6"]:
        """Node states of all participants: the craft, to which ``Participants`` adds obstacles."""
        return states

    def all_controls(self, controls: Controls) -> Float[Array, "participants intervals 3"]:
        """Controls of all participants: the craft, to which ``Participants`` adds obstacles."""
        return controls

    def participant_mask(self, moved: CraftMask) -> Bool[Array, "participants"]:
        """The craft that are marked, as a mask of all participants."""
        return moved

    def is_obstacle(self, rows: Indices) -> Bool[Array, "k"]:
        """Which participants are obstacles, which come after the craft and which no plan moves."""
        return np.asarray(rows >= len(self.label))

    def local_index(self, swarm: int, row: int) -> int:
        """Index of a participant within its swarm."""
        return row - int(self.starts[swarm])

    def separation_scaling(self, first: Indices, second: Indices) -> tuple[Vectors | None, Values]:
        """Scales of the axes for pairs' separations, if any, and offsets to subtract, m."""
        return None, np.zeros(len(first))

    def separations(
        self,
        one: Float[Array, "participants times 3"],
        other: Float[Array, "participants times 3"],
        first: Int[Array, "p"],
        second: Int[Array, "p"],
    ) -> Float[Array, "p times"]:
        """Separations of pairs, m, scaled and offset to compare with the collision radius.

        Coordinates are the first axis in the computation, which is several times faster.
        """
        points, others = (np.ascontiguousarray(some.transpose(2, 0, 1)) for some in (one, other))
        scale, beyond = self.separation_scaling(first, second)
        distance = np.empty((len(first), one.shape[1]))
        few = max(1, DISTANCES_AT_ONCE // one.shape[1])
        for part in (slice(k, k + few) for k in range(0, len(first), few)):
            gap = points.take(first[part], 1)
            gap -= others.take(second[part], 1)
            if scale is not None:
                gap *= scale[part].T[:, :, None]
            np.square(gap, out=gap)
            np.sqrt(gap.sum(axis=0), out=distance[part])
        return distance if scale is None else distance - beyond[:, None]


@lru_cache(maxsize=64)
def swarm_partition(sizes: tuple[int, ...]) -> SwarmPartition:
    """The partition of craft into swarms of given sizes, cached."""
    return SwarmPartition(sizes)


@lru_cache(maxsize=64)
def pairs(n: int) -> Pairs:
    """First and second craft of every pair i < j of n craft, read-only."""
    both = np.triu_indices(n, 1)
    for one in both:
        one.flags.writeable = False
    return both


def least_of_each(
    value: Values, label: Indices
) -> tuple[Int[Array, "labels"], Int[Array, "labels"]]:
    """The labels that occur, and the index of each one's least value; NaN is least."""
    if len(label) and (label == label[0]).all():
        return label[:1], np.array([value.argmin()])
    order = np.lexsort((np.where(np.isnan(value), -np.inf, value), label))
    ordered = label[order]
    first = np.flatnonzero(np.diff(ordered, prepend=-1))
    return ordered[first], order[first]
