"""Alfano's conjunctions with known probabilities of a collision, and numbers about them.

S. Alfano, "Satellite Conjunction Monte Carlo Analysis", AAS 09-233, 2009. States and covariances at
the closest approach, and results of 10⁸ two-body trials and of the "3D-Nc" method (D. Hall,
"Expected Collision Rates for Tracked Satellites", Journal of Spacecraft and Rockets 58(3), 2021),
are those of NASA's CARA Analysis Tools (github.com/nasa/CARA_Analysis_Tools: AlfanoTestCase*.cdm
and A09TestCases_01_12_Distributed.csv). Correlations across the orbital plane, below 3e-4, are left
out.
"""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from relative import MU

IN_PLANE = np.array([0, 1, 3, 4])
ACROSS = np.array([2, 5])


@dataclass(frozen=True)
class Craft:
    """Inertial state at the closest approach, km and km/s, and covariance, m and s."""

    state: tuple[float, ...]
    in_plane: tuple[float, ...]  # lower triangle of R, T and their rates
    across: tuple[float, ...]  # of N and its rate

    @property
    def inertial(self) -> np.ndarray:
        """State, m and m/s."""
        return np.array(self.state) * 1e3

    @property
    def covariance(self) -> np.ndarray:
        """Of the inertial state."""
        found = np.zeros((6, 6))
        for axes, values in ((IN_PLANE, self.in_plane), (ACROSS, self.across)):
            row, column = np.tril_indices(len(axes))
            found[axes[row], axes[column]] = found[axes[column], axes[row]] = values
        position, velocity = self.inertial[:3], self.inertial[3:]
        radial, normal = position, np.cross(position, velocity)
        axes = np.array([radial, np.cross(normal, radial), normal])
        turn = np.kron(np.eye(2), axes / np.linalg.norm(axes, axis=1, keepdims=True))
        return turn.T @ found @ turn


@dataclass(frozen=True)
class Conjunction:
    """Two craft, and what is published: probabilities that they enter the radius."""

    radius: float  # m
    half: float  # time that is looked at before and after the closest approach, s
    entered: tuple[float, float]  # 95 % interval of the share of trials that entered
    entries: float  # their expected number, "3D-Nc"
    craft: tuple[Craft, Craft]


def flown(states: np.ndarray, time: float) -> np.ndarray:
    """Two-body states (k, 6) some s later or earlier, by Kepler's equation and f and g."""
    start, speed = states[:, :3], states[:, 3:]
    r = np.linalg.norm(start, axis=1)
    a = 1 / (2 / r - np.square(speed).sum(axis=1) / MU)
    rate, cosine, sine = np.sqrt(MU / a**3), 1 - r / a, np.vecdot(start, speed) / np.sqrt(MU * a)
    swept = rate * time
    for _ in range(8):
        s, c = np.sin(swept), np.cos(swept)
        step = (swept - cosine * s + sine * (1 - c) - rate * time) / (1 - cosine * c + sine * s)
        swept = swept - step
        if np.abs(step).max() < 1e-9:  # the next would be its square
            break
    s, c = np.sin(swept), np.cos(swept)
    far = a * (1 - cosine * c + sine * s)
    f, g = 1 - a / r * (1 - c), time - (swept - s) / rate
    df, dg = -np.sqrt(MU * a) / (r * far) * s, 1 - a / far * (1 - c)
    position, velocity = (x[:, None] * start + y[:, None] * speed for x, y in ((f, g), (df, dg)))
    return np.concatenate([position, velocity], axis=1)


def trials(case: Conjunction, count: int, pieces: int) -> tuple[np.ndarray, np.ndarray]:
    """Whether craft with errors begin within the radius, and whether they ever are, by two-body
    motion that is looked at as straight between many times."""
    rng, drawn = np.random.default_rng(0), []
    for craft in case.craft:
        values, axes = np.linalg.eigh(craft.covariance)
        root = axes * np.sqrt(np.maximum(values, 0.0))
        drawn.append(craft.inertial + rng.normal(size=(count, 6)) @ root.T)

    def gap(time: float) -> np.ndarray:
        return (flown(drawn[1], time) - flown(drawn[0], time))[:, :3]

    before = gap(-case.half)
    begins = np.linalg.norm(before, axis=1) < case.radius
    ever = begins.copy()
    for time in np.linspace(-case.half, case.half, pieces + 1)[1:]:
        after = gap(time)
        moved = after - before
        share = np.clip(-np.vecdot(before, moved) / np.vecdot(moved, moved), 0, 1)
        ever |= np.linalg.norm(before + share[:, None] * moved, axis=1) < case.radius
        before = after
    return begins, ever


def _read() -> dict[int, Conjunction]:
    found = {}
    for row in json.loads(Path(__file__).with_suffix(".json").read_text()):
        first, second = (Craft(*map(tuple, one)) for one in row["craft"])
        given = row["radius"], row["half"], tuple(row["entered"]), row["entries"]
        found[row["number"]] = Conjunction(*given, (first, second))
    return found


CASES = _read()
CASES[10] = replace(CASES[9], half=21600.0, entered=(0.363951603, 0.364140225), entries=0.364063796)
CASES[12] = replace(
    CASES[11],
    entered=(0.002413104, 0.002432385),
    entries=0.002441547,
    craft=(CASES[11].craft[0], CASES[11].craft[0]),
)
"""By the number of each; 9 and 10 differ in time, and 12 is twice the first craft of 11."""
