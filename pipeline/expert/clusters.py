"""Clusters: connected components of the conflict graph; subproblems and bases of large ones.

In a subproblem only craft near unsafe ones move; the controls of all others are fixed. The program
of a whole cluster starts from the simplex basis of the round before.
"""

import numpy as np

from pipeline.arrays import Array, Bool, Int
from pipeline.expert.cuts import Cuts, HalfSpaces
from pipeline.expert.subproblem import Basis, Optimum
from pipeline.orbit.arrays import Controls, CraftMask, Indices

HOPS = 1  # edges of the conflict graph from an unsafe craft to the furthest one that moves
MOST = 0.5  # largest share of a cluster's craft that is solved for alone
JOINT = 100  # craft up to which clusters share a program: setting one up costs as much as solving
VAST = 1000  # craft of a cluster from which on a program may be solved in parts
# Controls of a cluster from which on a program starts from the basis of the last one. With fewer
# that saves nothing, since programs are linearized anew, and might lead to another of several
# optima.
MANY = 3000

Cluster = Int[Array, "_"]  # indices of the craft in a cluster


def cluster_labels(n: int, first: Indices, second: Indices) -> Int[Array, "n"]:
    """Label of each connected component of the conflict graph: its lowest index.

    Labels propagate along cuts until none changes; for graphs this small that takes a tenth of the
    time of a general routine, which would take as long as the program itself.
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


def groups(labels: Indices) -> list[Int[Array, "_"]]:
    """Group indices by label: those of each label that occurs, in ascending order of labels."""
    order = labels.argsort(kind="stable")
    ends = np.diff(labels.take(order)).nonzero()[0] + 1
    return np.split(order, ends) if len(order) else []


def joint_clusters(clusters: list[Cluster], swarm: Indices) -> list[list[Cluster]]:
    """Group successive clusters of the same scenario; each group shares a program.

    A group has at most ``JOINT`` craft, or is one cluster. ``swarm`` has each craft's scenario.
    """
    joint: list[list[Cluster]] = []
    size, last = 0, -1
    for craft in clusters:
        label, size = int(swarm[craft[0]]), size + len(craft)
        if label == last and size <= JOINT:
            joint[-1].append(craft)
        else:
            joint.append([craft])
            size, last = len(craft), label
    return joint


def neighbourhoods(craft: Cluster, cuts: Cuts, unsafe: CraftMask) -> list[Cluster]:
    """The connected parts of a cluster within ``HOPS`` of unsafe craft, by the cluster's cuts.

    Empty where they are most of the cluster. No cut joins craft of two parts.
    """
    near = unsafe.copy()
    for _ in range(HOPS):
        met = near[cuts.first] | near[cuts.second]
        near[cuts.first[met]] = near[cuts.second[met]] = True
    free = craft[near[craft]]
    if len(free) == 0 or len(free) > MOST * len(craft):
        return []
    inside = near[cuts.first] & near[cuts.second]
    ends = (np.searchsorted(free, one[inside]) for one in (cuts.first, cuts.second))
    return [free[one] for one in groups(cluster_labels(len(free), *ends))]


def with_others_fixed(
    craft: Int[Array, "_"], cuts: Cuts, planes: HalfSpaces, controls: Controls
) -> tuple[Indices, Indices, HalfSpaces]:
    """Half-spaces of some craft, with the controls of all others, m/s², moved to their right side.

    At least one craft of each half-space is among them. Returns its first and second craft, as
    indices among them, equal where the other is fixed, and the half-spaces.
    """
    place = np.full(len(controls), -1)
    place[craft] = np.arange(len(craft))
    i, j = place[cuts.first], place[cuts.second]
    first_fixed, second_fixed = i < 0, j < 0
    fixed = first_fixed | second_fixed
    flat = controls.reshape(len(controls), -1)
    row = planes.row
    other = row if planes.other is None else planes.other
    required = planes.required.copy()
    required[first_fixed] -= np.vecdot(row, flat[cuts.first])[first_fixed]
    required[second_fixed] += np.vecdot(other, flat[cuts.second])[second_fixed]
    alone = np.where(first_fixed[:, None], -other, row)
    none = np.where(fixed[:, None], 0.0, other)
    both = np.where(first_fixed, j, i), np.where(second_fixed, i, j)
    return *both, HalfSpaces(alone, required, none)


class Bases:
    """Simplex bases of clusters of MANY controls, each that of the cluster's last program.

    At first they are those of decoupled optima. Clusters only merge, and bases of two clusters
    together are a basis of the merged program.
    """

    def __init__(self, decoupled: Int[Array, "n 6"] | None, m: int) -> None:
        self._decoupled, self._m = decoupled, m
        self._controls: Bool[Array, "n both"] | None = None  # once a cluster has many
        self._slack, self._row = np.zeros((2, 0), dtype=bool)

    def last(self, craft: Int[Array, "_"], cuts: Int[Array, "_"]) -> Basis | None:
        """The last basis of a cluster; None where it has few controls, or none is known."""
        if self._decoupled is None or len(craft) * self._m < MANY:
            return None
        if self._controls is None:
            self._controls = Basis.of_decoupled(self._decoupled, self._m, 0).controls
        more = np.ones(max(0, int(cuts.max()) + 1 - len(self._row)), dtype=bool)
        self._slack = np.append(self._slack, ~more)
        self._row = np.append(self._row, more)  # rows of new cuts are basic
        return Basis(self._controls[craft], self._slack[cuts], self._row[cuts])

    def keep(self, craft: Int[Array, "_"], cuts: Int[Array, "_"], found: Optimum) -> None:
        """Keep the basis of a cluster's optimum, or reset it where there is none."""
        if self._decoupled is None or self._controls is None or len(craft) * self._m < MANY:
            return
        decoupled = self._decoupled[craft]
        basis = found.basis or Basis.of_decoupled(decoupled, self._m, len(cuts))
        self._controls[craft], self._slack[cuts], self._row[cuts] = vars(basis).values()
