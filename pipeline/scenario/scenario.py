"""A scenario: the states that each craft starts from and must reach."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.errors import InputError
from pipeline.orbit.approaches import pairs
from pipeline.orbit.problem import Problem
from pipeline.orbit.rings import energy_mismatch

ENERGY_TOLERANCE = 1e-5
"""Largest |ẏ + 2e x| in m/s that counts as energy-matched: about 0.2 m of drift an orbit."""


@dataclass(frozen=True, eq=False)
class Scenario:
    """Initial and goal states of a swarm, with the problem they belong to.

    Attributes:
        problem: orbit, time grid and collision radius.
        initial: states at the first node, (n, 6), m and m/s, LVLH.
        goal: states at the last node, (n, 6).
        family: the family it was drawn from, or "custom".
        name: what to call it in files and tables.
    """

    problem: Problem
    initial: Float[Array, "..."]  # shapes are for __post_init__ to refuse, in a sentence
    goal: Float[Array, "..."]
    family: str = "custom"
    name: str = ""

    def __post_init__(self) -> None:
        """Refuse states that do not describe two formations of the same craft."""
        for end in ("initial", "goal"):
            states = getattr(self, end)
            if states.ndim != 2 or states.shape[1:] != (6,) or len(states) == 0:
                raise InputError(
                    f"{end} has shape {states.shape}; expected one row x y z vx vy vz for each "
                    "of at least one spacecraft."
                )
            bad = ~np.isfinite(states).all(axis=1)
            if bad.any():
                raise InputError(
                    f"{end}[{bad.argmax()}] has a value that is not a finite number; expected "
                    "six finite numbers x y z vx vy vz in m and m/s."
                )
        if len(self.initial) != len(self.goal):
            raise InputError(
                f"initial has {len(self.initial)} states and goal has {len(self.goal)}; expected "
                "one of each for every spacecraft."
            )

    @property
    def n(self) -> int:
        """Number of spacecraft."""
        return len(self.initial)

    def taking(self, slots: Sequence[int]) -> "Scenario":
        """The scenario in which each craft goes to the goal of that number here."""
        return replace(self, goal=self.goal[list(slots)])


def check(scenario: Scenario, *, allow_drift: bool = False) -> None:
    """Refuse formations that no transfer can start from or end in safely.

    Args:
        scenario: the scenario to check.
        allow_drift: accept states that are not energy-matched (Eq. 3).

    Raises:
        InputError: where a pair is within the collision radius at either end, or a state is
            not energy-matched.
    """
    for end, states in (("initial", scenario.initial), ("goal", scenario.goal)):
        _check_apart(end, states, scenario.problem.collision_radius)
        if not allow_drift:
            _check_energy(end, states, scenario.problem.mean_motion)


def _check_apart(end: str, states: Float[Array, "n 6"], collision_radius: float) -> None:
    i, j = pairs(len(states))
    distance = np.linalg.norm(states[i, :3] - states[j, :3], axis=1)
    close = np.flatnonzero(distance <= collision_radius)
    if len(close):
        k = close[distance[close].argmin()]
        raise InputError(
            f"{end}[{i[k]}] and {end}[{j[k]}] are {distance[k]:.6g} m apart; expected every pair "
            f"further apart than collision_radius, {collision_radius:g} m: move one of them or "
            "lower collision_radius."
        )


def _check_energy(end: str, states: Float[Array, "n 6"], mean_motion: float) -> None:
    mismatch = np.abs(energy_mismatch(states, mean_motion))
    k = int(mismatch.argmax())
    if mismatch[k] > ENERGY_TOLERANCE:
        raise InputError(
            f"{end}[{k}] drifts: vy + 2·mean_motion·x is {mismatch[k]:.3g} m/s; expected 0 within "
            f"{ENERGY_TOLERANCE:g} m/s (energy matching): set vy to "
            f"{-2 * mean_motion * states[k, 0]:.9g}, or give --allow-drift."
        )
