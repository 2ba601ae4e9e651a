"""How close a craft that has lost its thrust comes to the others: a dense grid, then refined.

It looks at every craft, every node and every other craft. The grid's steps are so short that a
scalar minimiser finds the closest approach in each; it looks at those where the way from one point
of the grid to the next is long enough to come closest of all.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from judge.motion import Case, after, exact_steps

PARTS, SHORT = 12, 1e-3
"""Grid steps in a time step; fewer where they would be so short a share of an orbit."""
CURVED = 1.05
"""How much longer than straight the way between two points of the grid may be."""


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
    grid = problem.step / min(PARTS, np.ceil(problem.step * problem.rate / 2 / np.pi / SHORT))
    arcs = []
    for node in range(problem.nodes):
        begin = node * problem.step
        times = np.append(np.arange(0.0, length, grid), length)
        drift, _ = exact_steps(problem.rate, times)
        adrift = np.einsum("tij,nj->nti", drift[:, :3], states[:, node])
        flown = places(problem, states, controls, begin + times)
        gap = adrift[:, None] - flown[None]
        apart = np.linalg.norm(gap, axis=-1)
        moved = np.linalg.norm(np.diff(gap, axis=2), axis=-1)
        lower = (apart[..., 1:] + apart[..., :-1] - CURVED * moved) / 2
        lower[range(len(states)), range(len(states))] = np.inf
        for lost, other, k in np.argwhere(lower <= apart[~np.eye(len(states), dtype=bool)].min()):
            sides = int(lost), node, int(other)
            arcs.append(
                (float(lower[lost, other, k]), *sides, float(times[k]), float(times[k + 1]))
            )
    best = Adrift(np.inf, 0, 0, 0, 0.0)
    for bound, lost, node, other, *around in sorted(arcs):
        if bound > best.distance:
            break
        found = _refined(problem, states, controls, lost, node, other, (around[0], around[1]))
        best = min(best, found, key=lambda one: one.distance)
    return best


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
    """As ``place`` for k times: positions (n, k, 3)."""
    node = np.minimum((times + 1e-9) // problem.step, problem.nodes - 1).astype(int)
    free, forced = exact_steps(problem.rate, times - node * problem.step)
    held = np.pad(controls, ((0, 0), (0, 1), (0, 0)))[:, node]
    both = np.concatenate([states[:, node], held], axis=2)
    return (np.concatenate([free, forced], axis=2)[:, :3] @ both[..., None])[..., 0]


def _refined(
    problem: Case,
    states: np.ndarray,
    controls: np.ndarray,
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
    return Adrift(float(best), lost, node, other, begin + float(since))
