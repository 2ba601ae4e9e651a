"""How far inside of boxes and cones craft stay, by definition: a dense grid, then refined."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from judge.adrift import places
from judge.motion import Case

PARTS = 60
"""Grid steps in a time step."""


def least_inside(
    document: Mapping[str, Any], problem: Case, states: np.ndarray, controls: np.ndarray
) -> float:
    """Least distance, m, of a craft from the boundary of a corridor that it has to be inside of."""
    least = np.inf
    for one in document.get("corridors", []):
        for craft in one.get("craft") or range(len(states)):
            at = partial(_inside_at, one, problem, states[[craft]], controls[[craft]])
            grid = np.arange(one["from"], one["to"], problem.step / PARTS)
            times = np.append(grid, one["to"])
            found = at(times)
            k = int(np.argmin(found))
            around = times[max(k - 1, 0)], times[min(k + 1, len(times) - 1)]
            best = minimize_scalar(
                lambda t, at=at: at(np.array([t]))[0],
                bounds=around,
                method="bounded",
                options={"xatol": 1e-6},
            )
            least = min(least, float(found[k]), float(best.fun))
    return least


def _inside_at(
    one: Mapping[str, Any],
    problem: Case,
    states: np.ndarray,
    controls: np.ndarray,
    times: np.ndarray,
) -> np.ndarray:
    return inside(places(problem, states, controls, times)[0], one)


def inside(points: np.ndarray, one: Mapping[str, Any]) -> np.ndarray:
    """How far inside of a box or a cone points (..., 3) are, m; below 0 outside."""
    if "box" in one:
        low, high = np.array(one["box"]["min"]), np.array(one["box"]["max"])
        return np.asarray(np.minimum(points - low, high - points).min(axis=-1))
    axis = np.array(one["cone"]["axis"], dtype=float)
    axis /= np.linalg.norm(axis)
    from_apex = points - np.array(one["cone"]["apex"])
    along = from_apex @ axis
    across = np.linalg.norm(from_apex - along[..., None] * axis, axis=-1)
    angle = np.deg2rad(one["cone"]["half_angle_deg"])
    return np.asarray(along * np.sin(angle) - across * np.cos(angle))
