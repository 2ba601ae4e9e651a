"""How far craft of their own radii stay from each other, and from what does not move.

A dense grid of times, refined by a scalar minimiser. An obstacle drifts by the matrix exponential,
or stands still. The distance to an ellipsoid is that to its nearest point, by a root of one
variable, from the definition; no scaled axes and no enclosing ellipsoid.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from judge.adrift import places
from judge.motion import Case, exact_steps

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
    times = (*np.linspace(0, problem.duration, PARTS * (problem.nodes - 1) + 1).tolist(),)
    arcs = []
    for craft, other, apart in pairs(document, problem, states, controls):
        grid = apart(times)
        at = int(grid.argmin())
        around = times[max(at - 1, 0)], times[min(at + 1, len(times) - 1)]
        arcs.append((float(grid[at]), craft, other, times[at], apart, around))
    least, found = min(arc[0] for arc in arcs), []
    for near, craft, other, time, apart, around in arcs:
        found.append(Closest(near, craft, other, time))
        if near < least + NEAR:
            best = minimize_scalar(
                lambda t, apart=apart: apart((t,))[0],
                bounds=around,
                method="bounded",
                options={"xatol": 1e-6},
            )
            found.append(Closest(float(best.fun), craft, other, float(best.x)))
    return min(found, key=lambda one: one.clearance)


Apart = Callable[[tuple[float, ...]], np.ndarray]


def pairs(
    document: Mapping[str, Any], problem: Case, states: np.ndarray, controls: np.ndarray
) -> Iterator[tuple[int, int | str, Apart]]:
    """Each pair, and how far apart their surfaces are at some times."""
    n, radii = len(states), radii_of(document, problem, len(states))

    @cache
    def flown(k: int, times: tuple[float, ...]) -> np.ndarray:
        return np.asarray(places(problem, states[[k]], controls[[k]], np.array(times))[0])

    def craft(i: int, j: int, times: tuple[float, ...]) -> np.ndarray:
        gap = np.linalg.norm(flown(i, times) - flown(j, times), axis=1)
        return np.asarray(gap - radii[i] - radii[j])

    def obstacle(i: int, one: Mapping[str, Any], times: tuple[float, ...]) -> np.ndarray:
        there = obstacle_track(one, problem, np.array(times))
        return outside(flown(i, times) - there, axes_of(one)) - radii[i]

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
    since = np.append(np.arange(0.0, length, problem.step / 12), length)
    free, _ = exact_steps(problem.rate, since)
    for node in range(problem.nodes):
        times = node * problem.step + since
        lost = np.einsum("tij,nj->tni", free[:, :3], states[:, node])
        met = places(problem, states, controls, times).swapaxes(0, 1)
        apart = np.linalg.norm(lost[:, :, None] - met[:, None], axis=-1) - radii - radii[:, None]
        least = min(least, float(apart[:, ~np.eye(n, dtype=bool)].min(initial=np.inf)))
        for one in document.get("obstacles", []):
            there = obstacle_track(one, problem, times)
            gaps = outside(lost - there[:, None], axes_of(one)) - radii
            least = min(least, float(gaps.min()))
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
    return np.asarray(obstacle_track(one, problem, np.array([time]))[0])


def obstacle_track(one: Mapping[str, Any], problem: Case, times: np.ndarray) -> np.ndarray:
    """Positions of an obstacle at k times, LVLH, m, (k, 3)."""
    if "position" in one:
        return np.tile(np.array(one["position"], dtype=float), (len(times), 1))
    free, _ = exact_steps(problem.rate, times)
    return np.asarray(free[:, :3] @ np.array(one["state"], dtype=float))


def outside(points: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Distance of points (..., 3) from an ellipsoid about the origin; below 0 inside it.

    The nearest point is a²p/(a² + t), on the surface: t ≥ 0 is where Σ(a p/(a² + t))² falls to 1.
    That sum is convex and falls, so Newton's steps from 0 never go beyond the root.
    """
    squares = axes**2
    scaled, t = axes * points, np.zeros(points.shape[:-1])
    for _ in range(200):
        share = np.square(scaled / (squares + t[..., None]))
        slope = 2 * (share / (squares + t[..., None])).sum(axis=-1)
        further = np.maximum(share.sum(axis=-1) - 1, 0.0) / slope.clip(min=1e-300)
        t = t + further
        if (further <= 1e-13 * t).all():
            break
    else:
        raise ArithmeticError("no root is found")
    apart = np.linalg.norm(points - squares * points / (squares + t[..., None]), axis=-1)
    # How deep inside does not matter: a share of the least semi-axis.
    inside = np.square(points / axes).sum(axis=-1)
    deep = float(axes.min()) * (1 - np.sqrt(inside.clip(max=1.0)))
    return np.asarray(np.where(inside < 1, -deep, apart))
