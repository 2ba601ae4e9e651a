"""The numbers that the script of a plan's page draws, rounded."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from pipeline.arrays import Array, Float, Int
from pipeline.orbit.approaches import TOLERANCE, close_approaches
from pipeline.orbit.arrays import Controls, Formation, States, Values, norm
from pipeline.orbit.corridors import Box, Corridor
from pipeline.orbit.participants import Participants
from pipeline.orbit.problem import Problem
from pipeline.orbit.separation import node_distances
from pipeline.orbit.transfer import free_drift, track
from pipeline.plan.plan import Plan
from pipeline.scenario import Scenario, participants

SAMPLES = 240  # times at which a transfer is shown: every 5 s of the reference problem's 20 minutes
CROWD = 100  # craft from which each has fewer samples, so that the page does not grow too large
ORBIT_STEPS = (4, 8, 16, 32, 64)  # samples in each interval of an orbit of free drift: by need
CHORD = 0.002  # most error of straight lines between them, as a share of the paths' extent
PROBES = 16  # about how many points of an orbit must lie on another for both to be one line
LARGER = 10.0  # orbits of more than so many times the extent of the paths are not drawn
VISIBLE = 0.004  # least radius of what is drawn, as a share of the extent of all
MOST_PAIRS = 6  # pairs whose separation is shown, each in a colour that can be told from the others
PADDING = 0.04  # free space around what is drawn, as a share of its extent
FLATTEST = 0.3  # least extent of the box on any axis, as a share of the largest, for labels


@dataclass(frozen=True)
class Pair:
    """The closest approach of two craft."""

    first: int  # the craft of lower index
    second: int  # the other
    distance: float  # their least separation at any time, m
    time: float  # when, s since the start
    wanted: float  # separation required of them, m: r_col, or the sum of their radii


def page_data(plan: Plan) -> tuple[dict[str, Any], list[Pair]]:
    """What the page draws (cm, mm, mm/s², s), for JSON, and the pairs whose separation it has."""
    scenario, found = plan.scenario, plan.certificate
    problem = scenario.problem
    sizes = scenario.radii if scenario.sized else None
    pairs = closest_pairs(plan.states, plan.controls, problem, radii=sizes)
    closest = [pair.time for pair in pairs]
    if found.min_separation_time is not None:
        closest.append(found.min_separation_time)
    times = sample_times(scenario.n, problem, np.array(closest))
    positions = positions_at(times, plan.states, plan.controls, problem)
    extent = _extent(positions)
    drifts = {
        "initial": orbits(scenario.initial, problem, CHORD * extent),
        "goal": orbits(scenario.goal, problem.starting_at(problem.intervals), CHORD * extent),
    }
    for end, drift in drifts.items():
        far = _extent(drift) > LARGER * extent
        drifts[end] = drift[:0] if far else distinct(drift, 2 * CHORD * extent)
    separations = [norm(positions[pair.first] - positions[pair.second]) for pair in pairs]
    nearest = None
    if scenario.n > 1:
        craft, distance = nearest_pair(positions)
        nearest = {"pairs": craft.tolist(), "separations": _whole(1000 * distance)}
    limit, obstacles = problem.max_acceleration, obstacles_at(times, scenario)
    corridors = [_outline(one, times, positions) for one in scenario.corridors]
    near = [one[None] for one in corridors if _extent(one[None]) <= LARGER * extent]
    least = VISIBLE * _extent(positions, *drifts.values(), *near, obstacles)
    room = max([least, *scenario.radii, *(a for one in scenario.obstacles for a in one.axes)])
    return {
        "times": times.tolist(),
        "nodes": (np.arange(problem.nodes) * problem.time_step).tolist(),
        "collisionRadius": problem.collision_radius,
        "bound": found.min_separation_bound,
        "closest": found.min_separation_time,
        "positions": _whole(100 * positions),
        "corridors": [_whole(100 * one) for one in corridors],
        "radii": np.maximum(scenario.radii, least).tolist(),
        "obstacles": [
            {
                "name": one.name,
                "axes": np.maximum(one.axes, least).tolist(),
                "track": _whole(100 * track),
            }
            for one, track in zip(scenario.obstacles, obstacles, strict=True)
        ],
        "orbits": {end: _whole(100 * drift) for end, drift in drifts.items()},
        "box": _box([positions, *drifts.values(), *near, obstacles], room),
        "controls": np.round(1000 * plan.controls, 5).tolist(),
        "limit": None if limit is None else 1000 * limit,
        "pairs": [[pair.first, pair.second] for pair in pairs],
        "wanted": [pair.wanted for pair in pairs],
        "separations": [_whole(1000 * one) for one in separations],
        "nearest": nearest,
    }, pairs


def steps_of(n: int, problem: Problem) -> int:
    """Samples in each interval of a transfer of n craft, at least one."""
    return max(1, round(SAMPLES * min(1.0, CROWD / n) / problem.intervals))


def sample_times(n: int, problem: Problem, further: Values) -> Float[Array, "S"]:
    """Times at which to show a transfer, s: evenly spaced, nodes included, and ``further`` ones."""
    steps = steps_of(n, problem)
    even = problem.time_step / steps * np.arange(problem.intervals * steps + 1)
    return np.union1d(even, further)


def positions_at(
    times: Float[Array, "S"], states: States, controls: Controls, problem: Problem
) -> Float[Array, "n S 3"]:
    """Positions in m at any times of a transfer, s: Eq. 2 from the node before each."""
    interval = np.clip(times // problem.time_step, 0, problem.intervals - 1).astype(int)
    A, B = problem.dynamics.step(times - interval * problem.time_step, interval)
    free = np.einsum("sij,nsj->nsi", A[:, :3], states[:, interval])
    return free + np.einsum("sij,nsj->nsi", B[:, :3], controls[:, interval])


def obstacles_at(times: Float[Array, "S"], scenario: Scenario) -> Float[Array, "obstacles S 3"]:
    """Positions in m of obstacles at any times of a transfer, s."""
    swarms = participants([scenario])
    if not isinstance(swarms, Participants):
        return np.zeros((0, len(times), 3))
    return positions_at(times, swarms.states, swarms.controls, scenario.problem)


def orbits(states: Formation, problem: Problem, accuracy: float = np.inf) -> Float[Array, "n P 3"]:
    """Positions in m along an orbit of free drift from each state (m, m/s).

    Straight lines between them are within an accuracy, m, of the orbit, where that takes no more
    than the most samples: near the perigee of an eccentric orbit craft are fast.
    """
    drift = free_drift(states, problem)
    if len(states) > CROWD:
        return track(*drift, 1)
    for steps in ORBIT_STEPS:
        found = track(*drift, 2 * steps)
        sampled, between = found[:, ::2], found[:, 1::2]
        if norm(between - (sampled[:, 1:] + sampled[:, :-1]) / 2).max() <= accuracy:
            break
    return sampled


def distinct(drifts: Float[Array, "n P 3"], accuracy: float) -> Float[Array, "kept P 3"]:
    """Orbits that lie on no other before them: dashes of one would fill the gaps of another."""
    boxes = np.concatenate([drifts.min(axis=1), drifts.max(axis=1)], axis=1)
    kept: list[int] = []
    for k, drift in enumerate(drifts):
        points = drift[:: max(1, len(drift) // PROBES), None]
        near = np.abs(boxes[kept] - boxes[k]).max(axis=1) <= accuracy
        if all(_distance(points, one).max() > accuracy for one in drifts[kept][near]):
            kept.append(k)
    return drifts[kept]


def closest_pairs(
    states: States, controls: Controls, problem: Problem, radii: Values | None = None
) -> list[Pair]:
    """The pairs of least separation at any time, the closest first; all where there are few.

    Where craft have radii, the closest is the one with the least separation beyond both radii.
    """
    n = len(states)
    if n < 2:
        return []
    at_nodes, swarms = node_distances(states).min(axis=1), None
    if radii is not None:  # less what they ask for beyond r_col
        swarms = Participants(problem, [radii], [()])
        at_nodes -= radii[np.stack(swarms.pairs)].sum(axis=0) - problem.collision_radius
    # At nodes alone MOST_PAIRS pairs come within this distance, so the closest pairs at any time
    # do; the tolerance is there so that none of them is lost to rounding.
    last = min(MOST_PAIRS, len(at_nodes)) - 1
    within = float(np.partition(at_nodes, last)[last]) + TOLERANCE
    found = close_approaches(states, controls, problem, within, swarms=swarms)
    order = np.argsort(found.distance, kind="stable")
    _, first = np.unique((found.first * n + found.second)[order], return_index=True)
    closest = order[np.sort(first)][:MOST_PAIRS]
    wanted = np.full(len(found.first), problem.collision_radius)
    if radii is not None:
        wanted = radii[found.first] + radii[found.second]
    distance = found.distance + (wanted - problem.collision_radius)
    columns = (found.first, found.second, distance, found.times(problem), wanted)
    return [Pair(*row) for row in zip(*(c[closest].tolist() for c in columns), strict=True)]


def nearest_pair(positions: Float[Array, "n S 3"]) -> tuple[Int[Array, "S 2"], Float[Array, "S"]]:
    """The two closest craft at each time, and their distance, m."""
    found = [cKDTree(at).query(at, k=2) for at in positions.swapaxes(0, 1)]
    distance = np.array([distances for distances, _ in found])[..., 1]
    craft = distance.argmin(axis=1)
    both = np.array([near for _, near in found])[np.arange(len(craft)), craft]
    # Where two craft are at the same position, the query may return the other one first.
    other = np.where(both[:, 0] == craft, both[:, 1], both[:, 0])
    return np.sort(np.stack([craft, other], axis=1), axis=1), distance.min(axis=1)


def _distance(points: Float[Array, "K 1 3"], line: Float[Array, "P 3"]) -> Values:
    """The distance of points from the nearest of a line of many, m."""
    steps = np.diff(line, axis=0)
    lengths = np.maximum(np.vecdot(steps, steps), np.finfo(float).tiny)
    along = np.clip(np.vecdot(points - line[:-1], steps) / lengths, 0, 1)
    return norm(points - line[:-1] - along[..., None] * steps).min(axis=1)


def _whole(values: Float[Array, "*shape"]) -> Any:
    return np.rint(values).astype(np.int64).tolist()


def _outline(one: Corridor, times: Values, positions: Float[Array, "n S 3"]) -> Float[Array, "_ 3"]:
    """A line along the edges of a corridor, m; a cone's is as long as its craft are distant."""
    if isinstance(one.inside, Box):
        return one.inside.outline()
    first, last = np.searchsorted(times, one.begin, "right") - 1, np.searchsorted(times, one.end)
    counts = positions[list(one.craft) or slice(None), first : last + 1]  # and just around it
    return one.inside.outline(norm(counts - np.array(one.inside.apex)).max())


def _extent(*parts: Float[Array, "_ _ 3"]) -> float:
    """The largest extent on any axis, m."""
    points = np.concatenate([part.reshape(-1, 3) for part in parts])
    return float(np.ptp(points, axis=0).max()) if len(points) else 0.0


def _box(parts: list[Float[Array, "_ _ 3"]], radius: float) -> list[list[float]]:
    """Least and greatest coordinate on each axis, m, of a box with room for all that is drawn."""
    points = np.concatenate([part.reshape(-1, 3) for part in parts])
    low, high = points.min(axis=0) - radius, points.max(axis=0) + radius
    extent = high - low
    half = np.maximum(extent, FLATTEST * extent.max()) / 2 * (1 + 2 * PADDING)
    middle = (low + high) / 2
    return np.round(np.stack([middle - half, middle + half], axis=1), 2).tolist()
