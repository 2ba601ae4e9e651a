"""How close craft come: at the nodes (Eq. 5) and, soundly, at any time between them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from pipeline.arrays import Array
from pipeline.orbit.approaches import (
    FEW,
    TOLERANCE,
    Swarms,
    close_approaches,
    least_of_each,
    pairs,
    rounding,
    side_by_side,
)
from pipeline.orbit.bezier import norm
from pipeline.orbit.problem import Problem


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
    states: Float[Array, "n T 6"], collision_radius: float, swarms: Swarms
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
    """The least separation of any pair at any time; infinite for a craft alone.

    Attributes:
        distance: the separation attained, m.
        bound: no pair is ever closer than this, m; at most a bracket below ``distance``.
        pair: the two craft; None for a craft alone.
        time: when, s since the start; None for a craft alone.
    """

    distance: float
    bound: float
    pair: tuple[int, int] | None
    time: float | None


def least_separation(
    states: Float[Array, "n T 6"], controls: Float[Array, "n intervals 3"], problem: Problem
) -> Separation:
    """The least distance of any pair at any time of a flown trajectory."""
    return least_separations(states, controls, problem, side_by_side((len(states),)))[0]


def least_separations(
    states: Float[Array, "n T 6"],
    controls: Float[Array, "n intervals 3"],
    problem: Problem,
    swarms: Swarms,
    tolerance: float = TOLERANCE,
) -> list[Separation]:
    """The least distance of any pair of each swarm at any time, in brackets so wide, m.

    The least at the nodes bounds it from above, so that no other pair and time needs to be looked
    at; and where rounding hides that pair from the search as well, it is the least.
    """
    at_nodes = _least_at_nodes(states, swarms)
    within = np.nan_to_num(at_nodes, posinf=0.0)  # where there is no pair, none is found
    found = close_approaches(states, controls, problem, within, swarms=swarms, tolerance=tolerance)
    times = found.interval * problem.time_step + found.offset
    label, start = swarms.label[found.first], swarms.starts
    bound = np.full(len(at_nodes), np.inf)
    np.minimum.at(bound, label, found.bound)
    closest = dict(np.transpose(least_of_each(found.distance, label)).tolist())
    separations = []
    for swarm, one in enumerate(bound.tolist()):
        k = closest.get(swarm)
        if k is None:
            craft = slice(start[swarm], start[swarm] + swarms.sizes[swarm])
            separations.append(_closest_at_nodes(states[craft], problem))
            continue
        pair = int(found.first[k] - start[swarm]), int(found.second[k] - start[swarm])
        separations.append(Separation(float(found.distance[k]), one, pair, float(times[k])))
    return separations


def _closest_at_nodes(states: Float[Array, "n T 6"], problem: Problem) -> Separation:
    """The closest pair of a swarm at any node; its bound is lower by what rounding may hide."""
    n, T, _ = states.shape
    if n < 2:
        return Separation(np.inf, np.inf, None, None)
    if n <= FEW:
        distances = node_distances(states)
        k = int(distances.min(axis=1).argmin())
        node, pair = int(distances[k].argmin()), [int(one[k]) for one in pairs(n)]
        distance = float(distances[k, node])
    else:
        tree = _node_tree(states)
        near, points = map(np.asarray, tree.query(tree.data, k=2))
        point = int(near[:, 1].argmin())
        distance, node = float(near[point, 1]), point % T
        # The nearest is the craft itself, or one in the same place.
        pair = sorted({point // T, *(points[point] // T).tolist()})
    bound = distance - rounding(states)
    return Separation(distance, bound, (pair[0], pair[1]), node * problem.time_step)


def _least_at_nodes(states: Float[Array, "n T 6"], swarms: Swarms) -> Float[Array, "swarms"]:
    """Distance of the closest pair of each swarm at any node, m; infinite without a pair."""
    if not swarms.few:
        parts = np.split(states, swarms.starts[1:])
        return np.array([_nearest_at_nodes(part) for part in parts])
    least = np.full(len(swarms.sizes), np.inf)
    i, j = swarms.pairs
    distance = norm(states[i, :, :3] - states[j, :, :3]).min(axis=1)
    np.minimum.at(least, swarms.label[i], distance)
    return least


def _nearest_at_nodes(states: Float[Array, "n T 6"]) -> float:
    tree = _node_tree(states)
    distance = np.asarray(tree.query(tree.data, k=2)[0])  # the nearest is the craft itself
    return float(distance[:, 1].min()) if len(states) > 1 else np.inf


def _node_tree(states: Float[Array, "n T 6"]) -> cKDTree:
    """Positions at all nodes: as many planes of a fourth dimension, too far apart to meet."""
    positions = states[..., :3]
    size = 2 * float(np.ptp(positions, axis=(0, 1)).sum()) + 1.0
    plane = np.broadcast_to(size * np.arange(states.shape[1])[:, None], (*states.shape[:2], 1))
    return cKDTree(np.concatenate([positions, plane], axis=-1).reshape(-1, 4))


def pair_conflicts(
    states: Float[Array, "n T 6"], controls: Float[Array, "n intervals 3"], problem: Problem
) -> int:
    """Pairs that come within r_col at any time, at nodes or between them."""
    found = close_approaches(states, controls, problem, problem.collision_radius)
    return len(np.unique(np.stack([found.first, found.second]), axis=1).T)
