"""The numbers of a page, rounded for it: its script draws them, and computes none of them."""

from typing import Any

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.orbit.bezier import norm
from pipeline.plan import Plan
from pipeline.scenario import Scenario
from pipeline.show.motion import orbits, positions_at, sample_times
from pipeline.show.pairs import Pair, closest_pairs, nearest

PADDING = 0.04
"""Free space around what is drawn, as a share of its extent."""

FLATTEST = 0.3
"""Least extent of the box on any axis, as a share of the largest: axes need room for labels."""


def page_data(plan: Plan, scenario: Scenario) -> tuple[dict[str, Any], list[Pair]]:
    """What the page draws, JSON-ready, and the pairs whose separation is among it.

    Positions are in cm, separations in mm, controls in mm/s², times in s.
    """
    problem, found = scenario.problem, plan.certificate
    pairs = closest_pairs(plan.states, plan.controls, problem)
    closest = [pair.time for pair in pairs]
    if found.min_separation_time is not None:
        closest.append(found.min_separation_time)
    times = sample_times(scenario.n, problem, np.array(closest))
    positions = positions_at(times, plan.states, plan.controls, problem)
    ends = {"initial": orbits(scenario.initial, problem), "goal": orbits(scenario.goal, problem)}
    radius, limit = problem.collision_radius / 2, problem.max_acceleration
    return {
        "times": times.tolist(),
        "nodes": (np.arange(problem.nodes) * problem.time_step).tolist(),
        "collisionRadius": problem.collision_radius,
        "bound": found.min_separation_bound,
        "closest": found.min_separation_time,
        "positions": _whole(100 * positions),
        "orbits": {end: _whole(100 * drift) for end, drift in ends.items()},
        "box": _box([positions, *ends.values()], radius),
        "controls": np.round(1000 * plan.controls, 5).tolist(),
        "limit": None if limit is None else 1000 * limit,
        "pairs": [[pair.first, pair.second] for pair in pairs],
        "separations": [
            _whole(1000 * norm(positions[p.first] - positions[p.second])) for p in pairs
        ],
        "nearest": _nearest(positions),
    }, pairs


def _nearest(positions: Float[Array, "n S 3"]) -> dict[str, Any] | None:
    """Who is closest to whom at each time, mm; nothing without a pair."""
    if len(positions) < 2:
        return None
    craft, distance = nearest(positions)
    return {"pairs": craft.tolist(), "separations": _whole(1000 * distance)}


def _whole(values: Float[Array, "*shape"]) -> Any:
    return np.rint(values).astype(np.int64).tolist()


def _box(parts: list[Float[Array, "n _ 3"]], radius: float) -> list[list[float]]:
    """Least and greatest coordinate on each axis, m, of a box with room for all that is drawn."""
    points = np.concatenate([part.reshape(-1, 3) for part in parts])
    low, high = points.min(axis=0) - radius, points.max(axis=0) + radius
    extent = high - low
    half = np.maximum(extent, FLATTEST * extent.max()) / 2 * (1 + 2 * PADDING)
    middle = (low + high) / 2
    return np.round(np.stack([middle - half, middle + half], axis=1), 2).tolist()
