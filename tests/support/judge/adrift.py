"""How close a craft that has lost its thrust comes to the others: a dense grid, then refined.

It looks at every craft, every node and every other craft; the grid's steps are so short that the
closest approach is beside the least of its points, and a scalar minimiser goes on from there.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from judge.motion import Case, after, exact_steps

PARTS = 12
"""Grid steps in a time step."""

NEAR = 20.0
"""Arcs whose least grid point is within this of the least of all are refined, m."""


@dataclass(frozen=True)
class Adrift:
    """The closest that a craft adrift comes to another; m and s."""

    distance: float
    lost: int
    node: int
    other: int
    time: float


def closest_adrift(
    problem: Case, states: np.ndarray, controls: np.ndarray, orbits: float
) -> Adrift:
    """Over all losses of thrust at nodes of a flight; at the last one all drift from their goals.

    Args:
        problem: orbit and time grid.
        states: as flown, (n, T, 6).
        controls: (n, T-1, 3).
        orbits: how long the craft drifts; its others fly on, and after their plan drift too.
    """
    length = orbits * 2 * np.pi / problem.rate
    arcs = []
    for node in range(problem.nodes):
        begin = node * problem.step
        times = np.append(np.arange(0.0, length, problem.step / PARTS), length)
        drift, _ = exact_steps(problem.rate, times)
        adrift = np.einsum("tij,nj->nti", drift[:, :3], states[:, node])
        flown = places(problem, states, controls, begin + times)
        apart = np.linalg.norm(adrift[:, None] - flown[None], axis=-1)
        for lost, other in zip(*np.nonzero(~np.eye(len(states), dtype=bool)), strict=True):
            at = int(apart[lost, other].argmin())
            near = float(apart[lost, other, at])
            around = times[max(at - 1, 0)], times[min(at + 1, len(times) - 1)]
            arcs.append((near, int(lost), node, int(other), around))
    least = min(arc[0] for arc in arcs)
    return min(
        (_refined(problem, states, controls, *arc) for arc in arcs if arc[0] < least + NEAR),
        key=lambda one: one.distance,
    )


def distance_adrift(
    problem: Case,
    states: np.ndarray,
    controls: np.ndarray,
    pair: tuple[int, int],
    node: int,
    time: float,
) -> float:
    """Distance at a time of a craft that lost its thrust at a node from another that flies on."""
    lost, other = pair
    since = time - node * problem.step
    there = after(problem.rate, since, states[lost, node], np.zeros(3))[:3]
    return float(np.linalg.norm(there - place(problem, states, controls, time)[other]))


def place(problem: Case, states: np.ndarray, controls: np.ndarray, time: float) -> np.ndarray:
    """Positions (n, 3) at a time of a flight, which drifts on after its last node."""
    return places(problem, states, controls, np.array([time]))[:, 0]


def places(
    problem: Case, states: np.ndarray, controls: np.ndarray, times: np.ndarray
) -> np.ndarray:
    """Positions (n, k, 3) at k times."""
    node = np.minimum((times + 1e-9) // problem.step, problem.nodes - 1).astype(int)
    free, forced = exact_steps(problem.rate, times - node * problem.step)
    held = np.pad(controls, ((0, 0), (0, 1), (0, 0)))[:, node]
    both = np.concatenate([states[:, node], held], axis=2)
    return (np.concatenate([free, forced], axis=2)[:, :3] @ both[..., None])[..., 0]


def _refined(
    problem: Case,
    states: np.ndarray,
    controls: np.ndarray,
    near: float,
    lost: int,
    node: int,
    other: int,
    around: tuple[float, float],
) -> Adrift:
    begin = node * problem.step

    def apart(since: float) -> float:
        return distance_adrift(problem, states, controls, (lost, other), node, begin + since)

    found = minimize_scalar(apart, bounds=around, method="bounded", options={"xatol": 1e-6})
    best, since = min((found.fun, found.x), *((apart(since), since) for since in around))
    return Adrift(min(float(best), near), lost, node, other, begin + float(since))
