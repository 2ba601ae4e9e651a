"""Clusters of craft that must be planned jointly."""

import numpy as np
from jaxtyping import Int

from pipeline.arrays import Array

Cluster = Int[Array, "_"]
"""Indices of the craft in a cluster."""


def cluster_labels(n: int, first: Int[Array, "k"], second: Int[Array, "k"]) -> Int[Array, "n"]:
    """The cluster of each craft, called by its lowest member: craft that cuts join, however far.

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


def members(labels: Int[Array, "k"]) -> list[Int[Array, "_"]]:
    """Where each label that occurs stands, by label, ascending."""
    order = labels.argsort(kind="stable")
    return np.split(order, np.flatnonzero(np.diff(labels[order])) + 1) if len(order) else []
