"""How far craft of their own radii stay from each other, and from what does not move.

A dense grid of times, refined by a scalar minimiser. An obstacle drifts by the matrix exponential,
or stands still. The distance to an ellipsoid is that to its nearest point, by a root of one
variable, from the definition; no scaled axes and no enclosing ellipsoid.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.optimize import brentq, minimize_scalar

from judge.adrift import place
from judge.motion import Case, after

PARTS = 60
"""Grid steps in a time step."""

NEAR = 5.0
"""Arcs whose least grid point is within this of the least of all are refined, m."""


@dataclass(frozen=True)
class Closest:
    """The least distance of two surfaces, m, whose they are, and when."""

    clearance: float
    craft: int
    other: int | str
    time: float


def least_clearance(
    document: Mapping[str, Any], problem: Case, states: np.ndarray, controls: np.ndarray
) -> Closest:
    """Over all pairs of craft, and craft and obstacles, of the fields of scenario.json."""
    times = np.linspace(0, problem.duration, PARTS * (problem.nodes - 1) + 1)
    arcs = []
    for craft, other, apart in pairs(document, problem, states, controls):
        grid = np.array([apart(t) for t in times])
        at = int(grid.argmin())
        around = times[max(at - 1, 0)], times[min(at + 1, len(times) - 1)]
        arcs.append((float(grid[at]), craft, other, float(times[at]), apart, around))
    least, found = min(arc[0] for arc in arcs), []
    for near, craft, other, time, apart, around in arcs:
        found.append(Closest(near, craft, other, time))
        if near < least + NEAR:
            best = minimize_scalar(apart, bounds=around, method="bounded", options={"xatol": 1e-6})
            found.append(Closest(float(best.fun), craft, other, float(best.x)))
    return min(found, key=lambda one: one.clearance)


Apart = Callable[[float], float]


def pairs(
    document: Mapping[str, Any], problem: Case, states: np.ndarray, controls: np.ndarray
) -> Iterator[tuple[int, int | str, Apart]]:
    """Each pair, and how far apart their surfaces are at a time."""
    n, radii = len(states), radii_of(document, problem, len(states))

    def flown(t: float, k: int) -> np.ndarray:
        return place(problem, states[[k]], controls[[k]], t)[0]

    def craft(i: int, j: int, t: float) -> float:
        return float(np.linalg.norm(flown(t, i) - flown(t, j))) - radii[i] - radii[j]

    def obstacle(i: int, one: Mapping[str, Any], t: float) -> float:
        return outside(flown(t, i) - obstacle_at(one, problem, t), axes_of(one)) - radii[i]

    for i in range(n):
        for j in range(i + 1, n):
            yield i, j, partial(craft, i, j)
        for one in document.get("obstacles", []):
            yield i, one["name"], partial(obstacle, i, one)


def least_adrift(
    document: Mapping[str, Any],
    problem: Case,
    states: np.ndarray,
    controls: np.ndarray,
    orbits: float,
) -> float:
    """Least clearance on a grid of a craft adrift from any node; the true one is hardly less."""
    n, radii = len(states), radii_of(document, problem, len(states))
    length, least = orbits * 2 * np.pi / problem.rate, np.inf
    for node in range(problem.nodes):
        for t in np.append(np.arange(0.0, length, problem.step / 12), length).round(9):
            time = node * problem.step + float(t)
            lost = after(problem.rate, float(t), states[:, node], np.zeros(3))[:, :3]
            met = place(problem, states, controls, time)
            apart = np.linalg.norm(lost[:, None] - met, axis=2) - radii - radii[:, None]
            each = [apart[~np.eye(n, dtype=bool)]]
            for one in document.get("obstacles", []):
                gaps = lost - obstacle_at(one, problem, time)
                each.append(np.array([outside(gap, axes_of(one)) for gap in gaps]) - radii)
            least = min(least, float(np.concatenate(each).min()))
    return least


def radii_of(document: Mapping[str, Any], problem: Case, n: int) -> np.ndarray:
    """Radius of each craft, m."""
    craft = document.get("craft") or [{}] * n
    return np.array([one.get("radius") or problem.radius / 2 for one in craft])


def axes_of(one: Mapping[str, Any]) -> np.ndarray:
    """Semi-axes of an obstacle, m."""
    return np.array(one.get("semi_axes") or [one["radius"]] * 3)


def obstacle_at(one: Mapping[str, Any], problem: Case, time: float) -> np.ndarray:
    """Where an obstacle is at a time, (3,)."""
    if "position" in one:
        return np.array(one["position"], dtype=float)
    state = np.array(one["state"], dtype=float)
    return after(problem.rate, round(time, 9), state, np.zeros(3))[:3]


def outside(point: np.ndarray, axes: np.ndarray) -> float:
    """Distance of a point from an ellipsoid about the origin; below 0 inside it."""
    inside = float(np.square(point / axes).sum())
    if inside < 1:  # how deep does not matter: a share of the least semi-axis
        return -float(axes.min()) * (1 - inside**0.5)
    # The nearest point is a²p/(a² + t) with t ≥ 0, on the surface.
    most = float(np.linalg.norm(axes * point)) + 1.0
    t = brentq(lambda t: np.square(axes * point / (axes**2 + t)).sum() - 1, 0, most**2, xtol=1e-9)
    return float(np.linalg.norm(point - axes**2 * point / (axes**2 + t)))
