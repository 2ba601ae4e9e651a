"""Separation of craft: at the nodes (Eq. 5) and, proven, at any time between them."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from pipeline.arrays import Array, Float, Int
from pipeline.orbit.approaches import TOLERANCE, Approaches, close_approaches
from pipeline.orbit.arrays import Controls, Indices, States, norm
from pipeline.orbit.partition import FEW, SwarmPartition, least_of_each, pairs, swarm_partition
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import free_drift

ROUNDING = 1e-14  # bound on the rounding error of a distance, as a share of the largest coordinate


def node_distances(states: Float[Array, "*batch n T 6"]) -> Float[Array, "*batch p T"]:
    """Separation, m, of every pair at every node."""
    i, j = pairs(states.shape[-3])
    return norm(states[..., i, :, :3] - states[..., j, :, :3])


def node_collisions(
    states: Float[Array, "*batch n T 6"], collision_radius: float
) -> Int[Array, "*batch"]:
    """f_col of Eq. 5: number of pairs and nodes with a distance of at most r_col."""
    if states.shape[-3] <= FEW:
        return np.asarray((node_distances(states) <= collision_radius).sum(axis=(-2, -1)))
    each = states.reshape(-1, *states.shape[-3:])
    found = [len(_node_tree(one).query_pairs(collision_radius)) for one in each]
    return np.array(found).reshape(states.shape[:-3])


def swarm_node_collisions(
    states: States, collision_radius: float, swarms: SwarmPartition, nodes: slice = slice(None)
) -> Int[Array, "swarms"]:
    """f_col of each of several swarms, from states at all nodes or at those given."""
    if not swarms.few:
        parts = swarms.split(states)
        return np.array([node_collisions(part, collision_radius) for part in parts])
    i, j = swarms.pairs
    positions = swarms.all_states(states, nodes)[..., :3]
    close = swarms.separations(positions, positions, i, j) <= collision_radius
    return np.bincount(swarms.label[i], close.sum(axis=1), len(swarms.sizes)).astype(int)


@dataclass(frozen=True)
class Separation:
    """The least separation of any pair at any time; infinite for a single craft."""

    distance: float = np.inf  # the separation attained, m
    bound: float = np.inf  # proven lower bound on it, m; at most a bracket below
    pair: tuple[int, int] | None = None  # the two craft; a drifting one first
    time: float | None = None  # when, s since the first node
    node: int | None = None  # at which the first lost its thrust; at the last both drift from goals


def least_separations(
    states: States,
    controls: Controls,
    problem: Problem,
    swarms: SwarmPartition,
    tolerance: float = TOLERANCE,
) -> list[Separation]:
    """The least separation of any pair of each swarm at any time, to a tolerance, m."""
    least, flown = _closest_at_nodes(states, problem, swarms), (states, controls, problem)
    search = partial(close_approaches, *flown, swarms=swarms, tolerance=tolerance)
    return with_closer(least, search, problem, swarms)


def with_closer(
    least: list[Separation],
    search: Callable[[Float[Array, "swarms"]], Approaches],
    problem: Problem,
    swarms: SwarmPartition,
) -> list[Separation]:
    """Least separation of each swarm: that given, or a closer approach that a search finds."""
    # 0 without a pair, for which nothing is searched
    found = search(np.array([one.distance if one.distance < np.inf else 0.0 for one in least]))
    label, time = swarms.label[found.first], found.times(problem)
    bound = np.full(len(least), np.inf)
    np.minimum.at(bound, label, found.bound)
    for swarm, k in np.transpose(least_of_each(found.distance, label)).tolist():
        i, j = (swarms.local_index(swarm, int(one[k])) for one in (found.first, found.second))
        lost = None if found.node is None else int(found.node[k])
        distance = float(found.distance[k])
        least[swarm] = Separation(distance, float(bound[swarm]), (i, j), float(time[k]), lost)
    return least


def closest_sampled(
    distances: Float[Array, "p S"], first: Indices, second: Indices, swarms: SwarmPartition
) -> Iterator[tuple[int, float, int, tuple[int, int]]]:
    """For each swarm with pairs: its index, least distance, index of the time, and the pair."""
    least = distances.min(axis=1)
    for swarm, k in np.transpose(least_of_each(least, swarms.label[first])).tolist():
        pair = swarms.local_index(swarm, int(first[k])), swarms.local_index(swarm, int(second[k]))
        yield swarm, float(least[k]), int(distances[k].argmin()), pair


def drift_separations(states: Float[Array, "N n 6"], problem: Problem) -> Float[Array, "N"]:
    """Lower bound on the separation in each formation over an orbit of free drift, m."""
    N, n, _ = states.shape
    drift = free_drift(states.reshape(N * n, 6), problem)
    return np.array([found.bound for found in least_separations(*drift, swarm_partition((n,) * N))])


def pair_conflicts(states: States, controls: Controls, problem: Problem) -> int:
    """Number of pairs that come within r_col at any time, at nodes or between them."""
    found = close_approaches(states, controls, problem, problem.collision_radius)
    return len(np.unique(np.stack([found.first, found.second]), axis=1).T)


def _closest_at_nodes(states: States, problem: Problem, swarms: SwarmPartition) -> list[Separation]:
    """The closest pair of each swarm at any node; its bound allows for rounding."""
    if not swarms.few and len(swarms.sizes) > 1:
        parts = swarms.split(states)
        each = (_closest_at_nodes(part, problem, swarm_partition((len(part),))) for part in parts)
        return [one for (one,) in each]
    closest = [Separation()] * len(swarms.sizes)
    most = np.maximum.reduceat(np.abs(states[..., :3]).max(axis=(1, 2)), swarms.starts)
    if swarms.few:
        i, j = swarms.pairs
        craft, states = len(states), swarms.all_states(states)
        most = np.maximum(most, np.abs(states[craft:, :, :3]).max(initial=0.0))
        distances = swarms.separations(states[..., :3], states[..., :3], i, j)
        found = closest_sampled(distances, i, j, swarms)
    else:
        found = iter([_closest_by_tree(states)])
    for swarm, distance, node, pair in found:
        bound = distance - ROUNDING * float(most[swarm])
        closest[swarm] = Separation(distance, bound, pair, node * problem.time_step)
    return closest


def _closest_by_tree(states: States) -> tuple[int, float, int, tuple[int, int]]:
    """As ``closest_sampled``, for one large swarm at its nodes."""
    tree, T = _node_tree(states), states.shape[1]
    near, points = map(np.asarray, tree.query(tree.data, k=2))
    point = int(near[:, 1].argmin())  # the nearest is the craft itself, or one at the same position
    i, j = sorted({point // T, *(points[point] // T).tolist()})[:2]
    return 0, float(near[point, 1]), point % T, (i, j)


def _node_tree(states: States) -> Any:
    """A k-d tree of positions at all nodes; a fourth coordinate keeps nodes separate."""
    from scipy.spatial import cKDTree  # slow to import, and only large swarms need it

    positions = states[..., :3]
    size = 2 * float(np.ptp(positions, axis=(0, 1)).sum()) + 1.0
    plane = np.broadcast_to(size * np.arange(states.shape[1])[:, None], (*states.shape[:2], 1))
    return cKDTree(np.concatenate([positions, plane], axis=-1).reshape(-1, 4))
