"""How close craft come: at the nodes (Eq. 5) and, soundly, at any time between them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from pipeline.arrays import Array
from pipeline.orbit.approaches import close_approaches, pairs
from pipeline.orbit.problem import Problem


def node_distances(states: Float[Array, "*batch n T 6"]) -> Float[Array, "*batch p T"]:
    """Distance in m of every pair at every node."""
    i, j = pairs(states.shape[-3])
    return np.linalg.norm(states[..., i, :, :3] - states[..., j, :, :3], axis=-1)


def node_collisions(
    states: Float[Array, "*batch n T 6"], collision_radius: float
) -> Int[Array, "*batch"]:
    """f_col of Eq. 5: pairs and nodes with a distance of at most r_col."""
    return np.asarray((node_distances(states) <= collision_radius).sum(axis=(-2, -1)))


@dataclass(frozen=True)
class Separation:
    """The least separation of any pair at any time; infinite where there is no pair.

    Attributes:
        distance: the separation attained, m.
        bound: no pair is ever closer than this, m; at most TOLERANCE below ``distance``.
        pair: the two craft, or None.
        time: when, s since the start, or None.
    """

    distance: float
    bound: float
    pair: tuple[int, int] | None
    time: float | None


def least_separation(
    states: Float[Array, "n T 6"], controls: Float[Array, "n intervals 3"], problem: Problem
) -> Separation:
    """The least distance of any pair at any time of a flown trajectory."""
    if len(states) < 2:
        return Separation(np.inf, np.inf, None, None)
    at_nodes = float(node_distances(states).min())
    found = close_approaches(states, controls, problem, within=at_nodes)
    k = int(found.distance.argmin())
    time = float(found.interval[k] * problem.time_step + found.offset[k])
    pair = (int(found.first[k]), int(found.second[k]))
    return Separation(float(found.distance[k]), float(found.bound.min()), pair, time)


def pair_conflicts(
    states: Float[Array, "n T 6"], controls: Float[Array, "n intervals 3"], problem: Problem
) -> int:
    """Pairs that come within r_col at any time, at nodes or between them."""
    found = close_approaches(states, controls, problem, problem.collision_radius)
    return len(np.unique(np.stack([found.first, found.second]), axis=1).T)
