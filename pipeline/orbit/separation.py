"""Separation of craft: at the nodes (Eq. 5) and, proven, at any time between them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from pipeline.arrays import Array
from pipeline.orbit.approaches import (
    FEW,
    TOLERANCE,
    Closest,
    Swarms,
    close_approaches,
    least_of_each,
    pairs,
    side_by_side,
)
from pipeline.orbit.arrays import Controls, Indices, States, Values
from pipeline.orbit.bezier import norm
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import free_drift

ROUNDING = 1e-14  # share of the largest coordinate that a distance may be off by, with some room


def node_distances(states: Float[Array, "*batch n T 6"]) -> Float[Array, "*batch p T"]:
    """Distance in m of every pair at every node."""
    i, j = pairs(states.shape[-3])
    return norm(states[..., i, :, :3] - states[..., j, :, :3])


def node_collisions(
    states: Float[Array, "*batch n T 6"], collision_radius: float
) -> Int[Array, "*batch"]:
    """f_col of Eq. 5: pairs and nodes with a distance of at most r_col."""
    if states.shape[-3] <= FEW:
        return np.asarray((node_distances(states) <= collision_radius).sum(axis=(-2, -1)))
    each = states.reshape(-1, *states.shape[-3:])
    found = [len(_node_tree(one).query_pairs(collision_radius)) for one in each]
    return np.array(found).reshape(states.shape[:-3])


def swarm_node_collisions(
    states: States, collision_radius: float, swarms: Swarms
) -> Int[Array, "swarms"]:
    """f_col of each of several swarms."""
    if not swarms.few:
        parts = np.split(states, swarms.starts[1:])
        return np.array([node_collisions(part, collision_radius) for part in parts])
    i, j = swarms.pairs
    close = norm(states[i, :, :3] - states[j, :, :3]) <= collision_radius
    return np.bincount(swarms.label[i], close.sum(axis=1), len(swarms.sizes)).astype(int)


@dataclass(frozen=True)
class Separation:
    """The least separation of any pair at any time; infinite for a craft alone."""

    distance: float = np.inf  # the separation attained, m
    bound: float = np.inf  # proven lower bound on it, m; at most a bracket below
    pair: tuple[int, int] | None = None  # the two craft; a drifting one first
    time: float | None = None  # when, s since the first node
    node: int | None = None  # at which the first lost its thrust; the last: both are at their goals


def least_separation(states: States, controls: Controls, problem: Problem) -> Separation:
    """The least distance of any pair of one swarm at any time of a flown trajectory."""
    return least_separations(states, controls, problem, side_by_side((len(states),)))[0]


def least_separations(
    states: States,
    controls: Controls,
    problem: Problem,
    swarms: Swarms,
    tolerance: float = TOLERANCE,
) -> list[Separation]:
    """The least distance of any pair of each swarm at any time, in brackets so wide, m.

    The least at the nodes bounds it from above, so that only closer pairs and times are searched;
    and where rounding hides that pair from the search as well, it is the least.
    """
    within = np.nan_to_num(_least_at_nodes(states, swarms), posinf=0.0)  # none without a pair
    found = close_approaches(states, controls, problem, within, swarms=swarms, tolerance=tolerance)
    times = found.interval * problem.time_step + found.offset
    least = closer([Separation()] * len(within), found, found.first, found.second, times, swarms)
    for swarm, (start, n) in enumerate(zip(swarms.starts, swarms.sizes, strict=True)):
        if least[swarm].pair is None and n > 1:
            part = states[start : start + n]
            distance, node, pair = _closest_at_nodes(part)
            bound = distance - ROUNDING * float(np.abs(part[..., :3]).max())
            least[swarm] = Separation(distance, bound, pair, node * problem.time_step)
    return least


def closer(
    least: list[Separation],
    found: Closest,
    first: Indices,
    second: Indices,
    time: Values,
    swarms: Swarms,
    node: Indices | None = None,
) -> list[Separation]:
    """The least separation of each swarm, replaced where an approach was found."""
    label, start = swarms.label[first], swarms.starts
    bound = np.full(len(least), np.inf)
    np.minimum.at(bound, label, found.bound)
    for swarm, k in np.transpose(least_of_each(found.distance, label)).tolist():
        pair = int(first[k] - start[swarm]), int(second[k] - start[swarm])
        lost = None if node is None else int(node[k])
        distance = float(found.distance[k])
        least[swarm] = Separation(distance, float(bound[swarm]), pair, float(time[k]), lost)
    return least


def drift_separations(states: Float[Array, "N n 6"], problem: Problem) -> Float[Array, "N"]:
    """Lower bound on the separation of each formation's craft in an orbit of free drift, m."""
    N, n, _ = states.shape
    drift = free_drift(states.reshape(N * n, 6), problem)
    return np.array([apart.bound for apart in least_separations(*drift, side_by_side((n,) * N))])


def pair_conflicts(states: States, controls: Controls, problem: Problem) -> int:
    """Pairs that come within r_col at any time, at nodes or between them."""
    found = close_approaches(states, controls, problem, problem.collision_radius)
    return len(np.unique(np.stack([found.first, found.second]), axis=1).T)


def _least_at_nodes(states: States, swarms: Swarms) -> Float[Array, "swarms"]:
    """Distance of the closest pair of each swarm at any node, m; infinite without a pair."""
    if not swarms.few:
        parts = np.split(states, swarms.starts[1:])
        return np.array([_closest_at_nodes(part)[0] if len(part) > 1 else np.inf for part in parts])
    least = np.full(len(swarms.sizes), np.inf)
    i, j = swarms.pairs
    distance = norm(states[i, :, :3] - states[j, :, :3]).min(axis=1)
    with np.errstate(invalid="ignore"):  # what is NaN stays NaN, which nothing is safe by
        np.minimum.at(least, swarms.label[i], distance)
    return least


def _closest_at_nodes(states: States) -> tuple[float, int, tuple[int, int]]:
    """Distance (m), node and craft of the closest pair of a swarm at any node."""
    n, T, _ = states.shape
    if n <= FEW:
        apart = node_distances(states)
        k, node = divmod(int(apart.argmin()), T)
        i, j = (int(one[k]) for one in pairs(n))
        return float(apart[k, node]), node, (i, j)
    tree = _node_tree(states)
    near, points = map(np.asarray, tree.query(tree.data, k=2))
    point = int(near[:, 1].argmin())  # the nearest is the craft itself, or one in its place
    i, j = sorted({point // T, *(points[point] // T).tolist()})[:2]
    return float(near[point, 1]), point % T, (i, j)


def _node_tree(states: States) -> cKDTree:
    """A k-d tree of positions at all nodes, each node's in a far plane of a fourth dimension."""
    positions = states[..., :3]
    size = 2 * float(np.ptp(positions, axis=(0, 1)).sum()) + 1.0
    plane = np.broadcast_to(size * np.arange(states.shape[1])[:, None], (*states.shape[:2], 1))
    return cKDTree(np.concatenate([positions, plane], axis=-1).reshape(-1, 4))
