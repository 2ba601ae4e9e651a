"""The least fuel that any transfer needs when the other craft are left out.

By HiGHS and its dual, or, of thrusters of other kinds, by cvxpy.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import joblib
import numpy as np
from scipy.optimize import linear_sum_assignment, linprog
from scipy.sparse import eye, kron

from judge.motion import Case, exact_step

INFEASIBLE = 2
PARTS = 20
AGREEMENT = 1e-6


@dataclass(frozen=True)
class Bound:
    """Least fuel of each craft, m/s²; infinite where it cannot reach its goal at all.

    No transfer needs less than ``proven``, which holds by weak duality however well the program
    was solved; one needs ``attained``.
    """

    proven: np.ndarray
    attained: np.ndarray


FOUND: dict[str, Bound] = {}
"""Cache of bounds by problem and end states, which the plans of many planners share."""


def least_fuel(problem: Case, initial: np.ndarray, goal: np.ndarray) -> Bound:
    """From states (n, 6) to states (n, 6), each craft on its own."""
    kept = problem.rate, problem.step, problem.nodes, problem.limit, problem.thrusters
    asked = str(joblib.hash((kept, initial, goal)))
    if asked not in FOUND:
        FOUND[asked] = _least_fuel(problem, initial, goal)
    return FOUND[asked]


def _least_fuel(problem: Case, initial: np.ndarray, goal: np.ndarray) -> Bound:
    free, forced = exact_step(problem.rate, problem.step)
    effects = [forced]
    for _ in range(problem.nodes - 2):
        effects.insert(0, free @ effects[0])
    drift = np.linalg.matrix_power(free, problem.nodes - 1)
    # Metres and the duration as units, so that all numbers are of one size.
    size = np.repeat([1.0, problem.duration], 3)
    unit = problem.duration**-2
    reach = size[:, None] * np.hstack(effects) * unit
    limit = None if problem.limit is None else problem.limit / unit
    misses = size * (goal - initial @ drift.T)
    if problem.thrusters is None:
        found = _least(reach, misses, limit)
    else:
        least = problem.thrusters.least
        found = np.array([2 * [least(k, reach, b, unit)] for k, b in enumerate(misses)]).T
    return Bound(*(unit * found))


def least_fuel_inside(
    document: Mapping[str, Any], problem: Case, initial: np.ndarray, goal: np.ndarray
) -> np.ndarray:
    """Least fuel of each craft, m/s², inside of its corridors at PARTS times in each time step.

    By HiGHS, for thrusters along the axes, with waypoints at given times; in the pyramid that is
    inscribed in a cone of which 98 % is enough, so that any pyramid of 16 sides in the cone has
    this one inside.
    """
    unit, step, found = problem.duration**-2, problem.step, []
    for k, (start, end) in enumerate(zip(initial, goal, strict=True)):
        corridors = [
            one for one in document["corridors"] if k in (one.get("craft") or range(len(initial)))
        ]
        free, pushed, rows, most = np.eye(6), np.zeros((6, 3 * (problem.nodes - 1))), [], []
        passed = [one for one in document.get("waypoints", ()) if one["craft"] == k]
        at, place = [], []
        ends = [one[name] for one in corridors for name in ("from", "to")]
        grid = np.linspace(0.0, problem.duration, PARTS * (problem.nodes - 1) + 1)
        times = np.union1d(grid, ends)
        for node in range(problem.nodes - 1):
            for time in times[(step * node <= times) & (times < step * (node + 1))]:
                A, B = exact_step(problem.rate, time - step * node)
                moved = A @ pushed
                moved[:, 3 * node : 3 * node + 3] += B
                for one in corridors:
                    if one["from"] <= time <= one["to"]:
                        normal, offset = _faces(one)
                        rows.append(normal @ moved[:3])
                        most.append(offset - normal @ (A @ free @ start)[:3])
            A, B = exact_step(problem.rate, step)
            free, pushed = A @ free, A @ pushed
            pushed[:, 3 * node : 3 * node + 3] += B
            for one in passed:
                if round(one["time"] / step) == node + 1:
                    at.append(pushed[:3])
                    place.append(one["position"] - (free @ start)[:3])
        above = np.concatenate([np.zeros((1, pushed.shape[1])), *rows]) * unit
        size = np.repeat([1.0, problem.duration], 3)[:, None]
        led = np.concatenate([size * pushed, *at]) * unit
        there = np.concatenate([size[:, 0] * (end - free @ start), *place])
        solved = linprog(
            np.ones(2 * pushed.shape[1]),
            A_ub=np.hstack([above, -above]),
            b_ub=np.concatenate([[1.0], *most]),
            A_eq=np.hstack([led, -led]),
            b_eq=there,
            bounds=(0, None if problem.limit is None else problem.limit / unit),
        )
        found.append(np.inf if solved.fun is None else unit * solved.fun)
    return np.array(found)


def _faces(one: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Outward normals and offsets of the faces of a box, or of a pyramid inside of a cone."""
    if "box" in one:
        low, high = np.array(one["box"]["min"]), np.array(one["box"]["max"])
        return np.concatenate([np.eye(3), -np.eye(3)]), np.concatenate([high, -low])
    axis = np.array(one["cone"]["axis"], dtype=float)
    axis /= np.linalg.norm(axis)
    across = np.linalg.svd(axis[None])[2][1:]
    turn = np.linspace(0, 2 * np.pi, 65)[:-1]
    wide = np.tan(np.deg2rad(one["cone"]["half_angle_deg"])) * np.cos(np.pi / 16)
    sides = np.cos(turn)[:, None] * across[0] + np.sin(turn)[:, None] * across[1]
    normal = sides - wide * np.cos(np.pi / 64) * axis
    return normal, normal @ np.array(one["cone"]["apex"], dtype=float)


def least_fuel_of_any_order(problem: Case, initial: np.ndarray, goal: np.ndarray) -> Bound:
    """The same of the craft in the order of goals that needs least, each pair by its program."""
    n = len(goal)
    orders = [(np.arange(n) + k) % n for k in range(n)]
    proven, attained = np.full((2, n, n), np.inf)
    for order in orders:
        found = least_fuel(problem, initial, goal[order])
        proven[range(n), order], attained[range(n), order] = found.proven, found.attained
    return Bound(*(cost[linear_sum_assignment(cost)] for cost in (proven, attained)))


def _least(reach: np.ndarray, misses: np.ndarray, limit: float | None) -> np.ndarray:
    """Dual bounds and optima (2, n) of n linear programs: min ‖w‖₁, reach·w = miss, |w| ≤ limit."""
    n, both = len(misses), np.hstack([reach, -reach])
    cost, of_all = np.ones(n * both.shape[1]), kron(eye(n), both, format="csc")
    limits: dict[str, Any] = {"A_eq": of_all, "b_eq": misses.ravel(), "bounds": (0, limit)}
    solved = linprog(cost, **limits, method="highs")
    if solved.status == INFEASIBLE:
        if n == 1:
            return np.full((2, 1), np.inf)
        return np.hstack([_least(reach, miss[None], limit) for miss in misses])
    if solved.status != 0:
        raise ArithmeticError(f"HiGHS cannot tell the least fuel: {solved.message}")
    assert solved.x is not None
    price = solved.eqlin.marginals.reshape(misses.shape)
    worth = np.abs(price @ reach)  # of each control; what is worth more than its cost of 1 is used
    value, attained = np.vecdot(price, misses), solved.x.reshape(n, -1).sum(axis=1)
    if limit is None:
        proven = value / np.maximum(1.0, worth.max(axis=1))
    else:
        proven = value - limit * np.maximum(worth - 1, 0).sum(axis=1)
    if (attained - proven > AGREEMENT * np.maximum(1.0, attained)).any():
        raise ArithmeticError(f"HiGHS attains {attained} and its dual proves only {proven}")
    return np.stack([proven, attained])
