"""Simplex bases of the programs of large clusters, kept from one round to the next."""

import numpy as np

from pipeline.arrays import Array, Bool, Int
from pipeline.expert.subproblem import Basis, Optimum

# Craft of a cluster from which on a program starts from the basis of the last one, and may be
# solved in parts. In smaller clusters that saves nothing, since programs are linearized anew, and
# might lead to another of several optima.
VAST = 1000


class Bases:
    """Basis of the last program of each large cluster; at first that of decoupled optima.

    Clusters only merge, and bases of two clusters together are a basis of the merged program.
    """

    def __init__(self, decoupled: Int[Array, "n 6"] | None, m: int) -> None:
        self._decoupled, self._m = decoupled, m
        self._controls: Bool[Array, "n both"] | None = None  # once a cluster is large
        self._slack, self._row = np.zeros((2, 0), dtype=bool)

    def last(self, craft: Int[Array, "_"], cuts: Int[Array, "_"]) -> Basis | None:
        """The last basis of a cluster; None where it is not large, or none is known."""
        if self._decoupled is None or len(craft) < VAST:
            return None
        if self._controls is None:
            self._controls = self._first(self._decoupled)
        more = np.ones(max(0, int(cuts.max()) + 1 - len(self._row)), dtype=bool)
        self._slack = np.append(self._slack, ~more)
        self._row = np.append(self._row, more)  # rows of new cuts are basic
        return Basis(self._controls[craft], self._slack[cuts], self._row[cuts])

    def keep(self, craft: Int[Array, "_"], cuts: Int[Array, "_"], found: Optimum) -> None:
        """Keep the basis of a large cluster's optimum, or reset it where there is none."""
        if self._decoupled is None or self._controls is None or len(craft) < VAST:
            return
        basis = found.basis
        if basis is None:
            none = np.zeros(len(cuts), dtype=bool)
            basis = Basis(self._first(self._decoupled[craft]), none, ~none)
        self._controls[craft], self._slack[cuts], self._row[cuts] = vars(basis).values()

    def _first(self, decoupled: Int[Array, "_ 6"]) -> Bool[Array, "_ both"]:
        basic = np.zeros((len(decoupled), 2 * self._m), dtype=bool)
        np.put_along_axis(basic, decoupled, True, axis=1)
        return basic
