"""The transfer problem: orbit, time grid and limits that all scenarios of a dataset share."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import lru_cache, wraps
from typing import Any, TypeVar

import numpy as np

from pipeline.arrays import fields_as_python
from pipeline.errors import InputError, check_kind, check_range, is_whole
from pipeline.orbit.dynamics import ClohessyWiltshire, Dynamics
from pipeline.orbit.linearized import LinearizedDynamics
from pipeline.orbit.reference import LOWEST, check_mean_motion, mean_motion_at
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.orbit.thrust import ALONG_AXES, Thrust

# Accepted range of each quantity, SI: far beyond any swarm, but without numerical trouble
RANGES = {
    "mean_motion": (1e-15, mean_motion_at(LOWEST)),
    "time_step": (1e-3, 1e6),
    "collision_radius": (1e-6, 1e6),
    "max_acceleration": (1e-12, 1e6),
}

# Share of a limit of thrust or Δv that counts as rounding, in controls, needs and proofs alike
LIMIT_ROUNDING = 1e-6
NEGLIGIBLE = 1e-10  # fuel that counts as zero, in units of evasive_control
# Nodes of a transfer, and revolutions of the reference orbit that it may take
MOST_NODES, MOST_TURNS = 1250, 1000

Found = TypeVar("Found")


@dataclass(frozen=True)
class Problem:
    """Orbit, time grid and limits of a transfer; the defaults are the reference problem.

    The paper gives T = 11 and r_col = 15 m and leaves orbit and step open; with a 500 km
    circular orbit and 120 s the expert's fuel has the magnitude that the paper reports.

    Attributes:
        mean_motion: e of the reference orbit, rad/s.
        time_step: Δt, length of an interval of constant control, s.
        nodes: T, time nodes; there are T-1 intervals.
        collision_radius: r_col, m.
        max_acceleration: limit on each component of the control, m/s², or None.
        orbit: reference orbit about which motion is linearized; by default a circle without
            perturbations, which needs no more than its mean motion.
        thrust: thrusters, and constraints on burns.
    """

    mean_motion: float = mean_motion_at(500e3)
    time_step: float = 120.0
    nodes: int = 11
    collision_radius: float = 15.0
    max_acceleration: float | None = None
    orbit: ReferenceOrbit | None = None
    thrust: Thrust = ALONG_AXES

    def __post_init__(self) -> None:
        fields_as_python(self)
        object.__setattr__(self, "nodes", _whole(self.nodes))
        check_mean_motion(self.mean_motion)
        check_kind("orbit", self.orbit, ReferenceOrbit | None)
        if self.orbit is not None and self.mean_motion != self.orbit.mean_motion:
            raise InputError(
                f"mean_motion is {self.mean_motion:.9g} rad/s; expected that of its orbit, "
                f"{self.orbit.mean_motion:.9g} rad/s: use about."
            )
        check_kind("thrust", self.thrust, Thrust)
        for name, (least, most) in RANGES.items():
            if name != "max_acceleration" or self.max_acceleration is not None:
                check_range(name, getattr(self, name), least, most)
        if self.nodes > MOST_NODES:
            raise InputError(f"nodes is {self.nodes}; expected at most {MOST_NODES}.")
        if self.duration * self.mean_motion > 2 * np.pi * MOST_TURNS:
            raise InputError(
                f"the transfer takes {self.duration:g} s; expected at most {MOST_TURNS} "
                f"revolutions of the orbit, {2 * np.pi * MOST_TURNS / self.mean_motion:g} s."
            )
        if self.nodes < 3:
            raise InputError(
                f"nodes is {self.nodes}; expected at least 3, since two intervals of constant "
                "control are the fewest that can reach a goal state."
            )

    @property
    def dynamics(self) -> Dynamics:
        """Linear relative motion, and bounds on its derivatives."""
        if self.orbit is None:
            return ClohessyWiltshire(self.mean_motion, self.time_step)
        return LinearizedDynamics(self.orbit, self.time_step, self.intervals)

    def about(self, orbit: ReferenceOrbit) -> "Problem":
        """The same problem about a reference orbit."""
        check_kind("orbit", orbit, ReferenceOrbit)
        return replace(self, mean_motion=orbit.mean_motion, orbit=orbit)

    def starting_at(self, node: int) -> "Problem":
        """The same problem for a plan that begins at a later node of this one."""
        if self.orbit is None:
            return self
        return replace(self, orbit=self.orbit.later(node * self.time_step))

    @classmethod
    def of(cls, document: Mapping[str, Any]) -> "Problem":
        """The problem with the fields that ``document`` gives."""
        fields = dict(document)
        for name, kind in (("orbit", ReferenceOrbit), ("thrust", Thrust)):
            if given := document.get(name):
                fields[name] = kind(**given)
        return cls(**fields)

    def document(self) -> dict[str, Any]:
        """The fields for files, without orbit and thrust where they have their defaults."""
        fields = asdict(self)
        for name in ("orbit", "thrust"):
            if getattr(self, name) == getattr(Problem, name):
                del fields[name]
        return fields

    @property
    def intervals(self) -> int:
        """Number of intervals, T-1."""
        return self.nodes - 1

    @property
    def duration(self) -> float:
        """Length of the transfer, s."""
        return self.intervals * self.time_step

    @property
    def evasive_control(self) -> float:
        """Size of a control that moves a craft by about the collision radius, m/s²."""
        return self.collision_radius / self.duration**2

    @property
    def negligible_fuel(self) -> float:
        """Largest fuel that counts as rounding, m/s²."""
        return NEGLIGIBLE * self.evasive_control

    @property
    def most_control(self) -> float:
        """Largest component of a control within the limit, rounding included, m/s²."""
        limit = self.max_acceleration
        return np.inf if limit is None else limit * (1 + LIMIT_ROUNDING)


def once_per_motion(function: Callable[[Problem], Found]) -> Callable[[Problem], Found]:
    """Decorator: cache a function of a problem by its orbit and time grid alone."""
    of_motion = lru_cache(maxsize=32)(function)

    @lru_cache(maxsize=32)
    @wraps(function)
    def found(problem: Problem) -> Found:
        radius = Problem.collision_radius
        return of_motion(
            replace(problem, collision_radius=radius, max_acceleration=None, thrust=ALONG_AXES)
        )

    return found


def _whole(nodes: object) -> int:
    """Number of nodes as an integer, also of 11.0; InputError for fractions and other types."""
    if isinstance(nodes, float) and nodes.is_integer():
        return int(nodes)
    if not isinstance(nodes, int) or not is_whole(nodes):
        raise InputError(f"nodes is {nodes!r}; expected a whole number of at least 3.")
    return nodes
