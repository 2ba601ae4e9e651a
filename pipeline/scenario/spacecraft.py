"""Properties of single craft: mass, radius, thrust limits, and Δv left."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import fields_as_python
from pipeline.errors import InputError, check_range
from pipeline.orbit.problem import RANGES, Problem
from pipeline.orbit.thrust import Limits, Thrust, Windows, blocked_intervals, check_windows


@dataclass(frozen=True)
class Spacecraft:
    """Properties of one craft that differ from the swarm's.

    Attributes:
        name: used in files for simulators.
        mass: with propellant, at the first node, kg, or None; not used in planning.
        max_acceleration: limit on each component of its control, or on each thruster, m/s²; None
            for that of the problem.
        max_acceleration_norm: limit on ‖u‖₂, m/s²; None for that of the problem.
        delta_v: largest Δv in total, m/s, or None for no limit.
        no_burn: time spans without burns, from and to, s, besides those of the problem.
        radius: of the sphere that it takes up, m; None for half the problem's collision radius.
    """

    name: str = ""
    mass: float | None = None
    max_acceleration: float | None = None
    max_acceleration_norm: float | None = None
    delta_v: float | None = None
    no_burn: Windows = ()
    radius: float | None = None

    def __post_init__(self) -> None:
        fields_as_python(self)
        for name in ("mass", "max_acceleration", "max_acceleration_norm", "delta_v"):
            if (value := getattr(self, name)) is not None:
                check_range(name, value, *RANGES["max_acceleration"])
        if self.radius is not None:
            check_range("radius", self.radius, *RANGES["collision_radius"])
        check_windows(self.no_burn)

    @property
    def limited(self) -> bool:
        """Whether it has thrust or Δv limits of its own."""
        own = self.max_acceleration, self.max_acceleration_norm, self.delta_v, self.no_burn or None
        return any(one is not None for one in own)


def limits_of(craft: Sequence[Spacecraft], n: int, problem: Problem) -> Limits:
    """Thrust limits of n craft; ``craft`` is empty where all are alike."""
    thrust = problem.thrust
    both = problem.max_acceleration, thrust.max_acceleration_norm
    component, norm = (np.full(n, np.inf if one is None else one) for one in both)
    delta_v = np.full(n, np.inf)
    grid = problem.time_step, problem.intervals
    burns = np.tile(~blocked_intervals(thrust.no_burn, *grid)[:, None], (n, 1, 3))
    for k, one in enumerate(craft):
        given = one.max_acceleration, one.max_acceleration_norm, one.delta_v
        for limit, value in zip((component, norm, delta_v), given, strict=True):
            if value is not None:
                limit[k] = value
        burns[k] &= ~blocked_intervals(one.no_burn, *grid)[:, None]
    return Limits(component, norm, delta_v, burns)


def check_craft(craft: Sequence[Spacecraft], n: int, thrust: Thrust) -> None:
    """Refuse a wrong number of craft, or one without the delta_v that a fair objective needs."""
    if craft and len(craft) != n:
        raise InputError(
            f"craft has {len(craft)} entries and there are {n} spacecraft; expected one of each."
        )
    if thrust.objective == "fair" and not (craft and all(one.delta_v for one in craft)):
        raise InputError(
            "objective is fair and not every craft has a delta_v; expected what each has left: "
            "give craft a delta_v, m/s, each."
        )
