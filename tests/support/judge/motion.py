"""Relative motion by the Clohessy-Wiltshire equations, flown by matrix exponentials."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.linalg import expm

from judge.thrusters import Thrusters

GRAVITY = 3.986004418e14
"""Of the Earth, m³/s²."""

RADIUS = 6378137.0
"""Of the Earth at the equator, m."""


@dataclass(frozen=True)
class Case:
    """What a scenario, or a shard's metadata, says of orbit, time grid and limits; SI units."""

    rate: float
    step: float
    nodes: int
    radius: float
    limit: float | None = None
    thrusters: Thrusters | None = None

    @classmethod
    def of(cls, document: Mapping[str, Any], n: int = 0) -> "Case":
        """The problem in the fields of scenario.json, with the thrusters of n craft, if any."""
        rate = document.get("mean_motion")
        if rate is None:
            rate = (GRAVITY / (RADIUS + document["altitude"]) ** 3) ** 0.5
        step, nodes, radius = (
            document[name] for name in ("time_step", "nodes", "collision_radius")
        )
        thrusters = Thrusters.of(document, n) if n else None
        return cls(rate, step, nodes, radius, document.get("max_acceleration"), thrusters)

    @property
    def duration(self) -> float:
        """Of the whole transfer, s."""
        return self.step * (self.nodes - 1)


@lru_cache(maxsize=16384)
def exact_step(rate: float, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """What becomes of a state (6, 6), and of a held acceleration (6, 3), after some seconds."""
    flow = np.zeros((9, 9))  # of position, velocity and the acceleration, which stays
    position, velocity, held = slice(0, 3), slice(3, 6), slice(6, 9)
    flow[position, velocity] = flow[velocity, held] = np.eye(3)
    flow[velocity, position] = rate**2 * np.diag([3.0, 0.0, -1.0])
    flow[3, 4], flow[4, 3] = 2 * rate, -2 * rate
    moved = expm(seconds * flow)
    return moved[:6, :6], moved[:6, held]


def after(rate: float, seconds: float, state: np.ndarray, held: np.ndarray) -> np.ndarray:
    """States (..., 6) after some seconds under held accelerations (..., 3)."""
    free, forced = exact_step(rate, seconds)
    return state @ free.T + held @ forced.T


def exact_steps(rate: float, seconds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As ``exact_step`` for k times: (k, 6, 6) and (k, 6, 3)."""
    each, where = np.unique(seconds.round(9), return_inverse=True)
    free, forced = zip(*(exact_step(rate, one) for one in each.tolist()), strict=True)
    return np.stack(free)[where], np.stack(forced)[where]


def fly(problem: Case, start: np.ndarray, controls: np.ndarray) -> np.ndarray:
    """Node states (n, T, 6) from states (n, 6) and controls (n, T-1, 3)."""
    nodes = [start]
    for held in np.moveaxis(controls, 1, 0):
        nodes.append(after(problem.rate, problem.step, nodes[-1], held))
    return np.stack(nodes, axis=1)
