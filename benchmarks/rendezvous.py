"""Rendezvous with the ISS by the sequential convex programs of Transformer-MPC's authors.

Guffanti, Gammelli, D'Amico and Pavone (2024), "Transformers for trajectory optimization with
application to spacecraft rendezvous"; Celestini and others (2024), "Transformer-based model
predictive control". Impulses at 100 nodes, mean relative elements under J2, a place to hold at, an
approach cone, and sequential convex programs about a keep-out ellipsoid. Numbers are those of their
repositories; the start is that of their script for one transfer.
"""

from collections.abc import Iterator

import cvxpy as cp
import numpy as np

from pipeline.arrays import Array, Float
from pipeline.errors import ProlearnError

ANGLES = np.radians([51.6418, 301.0371, 26.1813, 68.2333])
CHIEF = 6378136.3 + 416e3, 0.0005581, *ANGLES  # a, e, i, Ω, ω, M; m, rad
N = np.sqrt(3.986004415e14 / CHIEF[0] ** 3)
NODES, HOLD = 100, 90  # their number, and the index of the one at rest ahead of the port
STEP = 2 * 2 * np.pi / N / (NODES - 1)  # s, of two orbits
START = np.array([0.0, 75.0, 0.0, 70.0, 0.0, 133.0])  # a (δa, δλ, δe, δi), m
APEX, PORT, AHEAD, ANGLE = 69.0, 74.0, 104.0, np.radians(30)  # of the cone, along-track; m
AXES = np.array([60.0, 94.0, 123.0])  # of the ellipsoid, radial, along and across; m
MOST = 0.02  # largest burn along an axis, m/s
TRUST, ROUNDS = (200.0, 1.0), 20  # first and last radius of the trust region, m; programs at most
CONVERGED = 1e-6  # Δv saved by one more program, m/s


def relative(node: float) -> Float[Array, "6 6"]:
    """The map from relative orbital elements, m, to LVLH states at a node, m and m/s."""
    latitude = ANGLES[2:].sum() + N * STEP * node
    c, s = np.cos(latitude), np.sin(latitude)
    place = [[1, 0, -c, -s, 0, 0], [0, 1, 2 * s, -2 * c, 0, 0], [0, 0, 0, 0, s, -c]]
    speed = [[0, 0, s, -c, 0, 0], [-1.5, 0, 2 * c, 2 * s, 0, 0], [0, 0, 0, 0, c, s]]
    return np.array([*place, *(N * np.array(speed))])


def optima(transition: Float[Array, "6 6"]) -> Iterator[tuple[Array, Array]]:
    """Successive optima: relative elements before burns (6, T), m, and burns (3, T), m/s.

    The first is without the ellipsoid; each later program is linearized about the optimum before
    it, with a shrinking trust region, until convergence. ``transition``: of elements over STEP.
    """
    maps = np.stack([relative(k) for k in range(NODES)])
    s, u = cp.Variable((6, NODES)), cp.Variable((3, NODES))
    after = [s[:, k] + np.linalg.inv(maps[k])[:, 3:] @ u[:, k] for k in range(NODES)]
    docked, held = np.eye(6)[1] * PORT, np.eye(6)[1] * AHEAD
    from_apex = [maps[k, :3] @ s[:, k] - [0, APEX, 0] for k in range(HOLD, NODES)]
    always = [
        s[:, 0] == START,
        *(s[:, k + 1] == transition @ after[k] for k in range(NODES - 1)),
        after[-1] == np.linalg.solve(maps[0], docked),
        maps[HOLD] @ s[:, HOLD] == held,
        *(cp.norm(gap) * np.cos(ANGLE) <= gap[1] for gap in from_apex),
        cp.abs(u) <= MOST,
    ]
    fuel = cp.sum(cp.norm(u, 2, axis=0))
    trust, near = TRUST[0], list[cp.Constraint]()
    elements, spent = np.zeros((6, NODES)), np.inf
    for _ in range(1 + ROUNDS):
        program = cp.Problem(cp.Minimize(fuel), always + near)
        program.solve(solver=cp.CLARABEL)
        if program.status not in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE):
            raise ProlearnError(f"their program is {program.status}")
        yield s.value, u.value
        moved = np.linalg.norm(s.value - elements, axis=0).max()
        less, elements, spent = spent - program.value, s.value, program.value
        if near and moved <= TRUST[1] and less <= CONVERGED:
            return
        near = []
        for k in range(HOLD):
            place = maps[k, :3] / AXES[:, None]
            at = place @ elements[:, k]
            near.append(at @ place @ s[:, k] >= np.linalg.norm(at))
            near.append(cp.norm(s[:, k] - elements[:, k]) <= trust)
        trust *= (TRUST[1] / TRUST[0]) ** (1 / ROUNDS)
