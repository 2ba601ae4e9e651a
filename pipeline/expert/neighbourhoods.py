"""Parts of a large cluster about its unsafe craft, each solved with all others held as they fly."""

import numpy as np

from pipeline.arrays import Array, Int
from pipeline.expert.bases import VAST
from pipeline.expert.cuts import Cuts, HalfSpaces
from pipeline.orbit.arrays import Controls, Indices, Marked

HOPS = 2  # pairs that are cut, one after the other, from an unsafe craft to the last one that moves
MOST = 0.5  # share of a cluster up to which it is solved in parts


def cluster_labels(n: int, first: Indices, second: Indices) -> Int[Array, "n"]:
    """Label of each connected component of the conflict graph: its lowest index.

    Labels are handed on along cuts until none changes; for graphs this small that takes a tenth
    of the time of a general routine, which would take as long as the program it prepares.
    """
    labels = np.arange(n)
    while True:
        lowest = np.minimum(labels[first], labels[second])
        joined = labels.copy()
        np.minimum.at(joined, first, lowest)
        np.minimum.at(joined, second, lowest)
        if (joined == labels).all():
            return labels
        labels = joined


def neighbourhoods(craft: Int[Array, "_"], cuts: Cuts, unsafe: Marked) -> list[Int[Array, "_"]]:
    """The parts of a cluster within ``HOPS`` of unsafe craft; all of it if small or mostly unsafe.

    Cuts are those of the cluster. Craft of different parts share no cut.
    """
    if len(craft) < VAST:
        return [craft]
    near = unsafe.copy()
    for _ in range(HOPS):
        met = near[cuts.first] | near[cuts.second]
        near[cuts.first[met]] = near[cuts.second[met]] = True
    free = craft[near[craft]]
    if not 0 < len(free) <= MOST * len(craft):
        return [craft]
    both = near[cuts.first] & near[cuts.second]
    ends = (np.searchsorted(free, one[both]) for one in (cuts.first, cuts.second))
    labels = cluster_labels(len(free), *ends)
    return [free[labels == label] for label in np.unique(labels)]


def about_some(
    craft: Int[Array, "_"], cuts: Cuts, planes: HalfSpaces, controls: Controls
) -> tuple[Indices, Indices, HalfSpaces]:
    """Half-spaces that bind some craft, as others keep their controls, m/s².

    Each binds at least one of those craft. The indices among them of its first and second craft
    come first; where one of the two is held, both are the other.
    """
    place = np.full(len(controls), -1)
    place[craft] = np.arange(len(craft))
    i, j = place[cuts.first], place[cuts.second]
    first_held, second_held = i < 0, j < 0
    held = first_held | second_held
    if not held.any():
        return i, j, planes
    flat = controls.reshape(len(controls), -1)
    row = planes.row
    other = row if planes.other is None else planes.other
    required = planes.required.copy()
    required[first_held] -= np.vecdot(row, flat[cuts.first])[first_held]
    required[second_held] += np.vecdot(other, flat[cuts.second])[second_held]
    alone = np.where(first_held[:, None], -other, row)
    none = np.where(held[:, None], 0.0, other)
    both = np.where(first_held, j, i), np.where(second_held, i, j)
    return *both, HalfSpaces(alone, required, none)
