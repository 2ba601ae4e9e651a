"""A scenario: the states that each craft starts from and must reach."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.errors import InputError
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import Reference, radius_at
from pipeline.orbit.thrust import ALONG_AXES, Limits
from pipeline.scenario.spacecraft import Spacecraft, check_craft, limits_of
from pipeline.scenario.waypoint import Waypoint, check_waypoints

# Craft, few enough for a list of all pairs, and craft times nodes
MOST_CRAFT, MOST_STATES = 10_000, 1_000_000
# Largest component of a position, m, and of a velocity, m/s, on any orbit
FURTHEST, FASTEST = 1e9, 1e6
RELATIVE = 0.1  # share of the reference orbit's radius beyond which no motion is relative


Ends = Literal["passive", "any"]


@dataclass(frozen=True, eq=False, repr=False)
class Scenario:
    """Initial and goal states of a swarm, with the problem they belong to.

    Attributes:
        problem: orbit, time grid and collision radius.
        initial: states at the first node, (n, 6), m and m/s, LVLH; lists become arrays.
        goal: states at the last node, (n, 6).
        family: the family it was drawn from, or "custom".
        name: in files and tables.
        reference: epoch and attitude of the reference orbit, or None; not used in planning.
        ends: passive, on orbits that do not drift; or any, as those of a rendezvous.
        craft: of each craft what it has of its own; empty where all are alike.
        waypoints: places that craft must pass on their way, in the order of each craft.
    """

    problem: Problem
    initial: Float[Array, "..."]  # shapes are for __post_init__ to refuse, in a sentence
    goal: Float[Array, "..."]
    family: str = "custom"
    name: str = ""
    reference: Reference | None = None
    ends: Ends = "passive"
    craft: tuple[Spacecraft, ...] = ()
    waypoints: tuple[Waypoint, ...] = ()

    def __post_init__(self) -> None:
        """Refuse states that do not describe two formations of the same craft."""
        for end in ("initial", "goal"):
            try:
                states = np.asarray(getattr(self, end), dtype=float)
            except (TypeError, ValueError) as error:
                raise InputError(
                    f"{end} is no array of numbers ({error}); expected a row x y z vx vy vz in m "
                    "and m/s for each spacecraft."
                ) from error
            object.__setattr__(self, end, states)
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
            far, fast = np.abs(states).reshape(-1, 2, 3).max(axis=(0, 2)).tolist()
            furthest = min(FURTHEST, RELATIVE * radius_at(self.problem.mean_motion))
            if far > furthest or fast > FASTEST:
                raise InputError(
                    f"{end} reaches {far:g} m and {fast:g} m/s; expected positions within "
                    f"{furthest:g} m, {RELATIVE:.0%} of the reference orbit's radius, and "
                    f"velocities within {FASTEST:g} m/s."
                )
        if self.n > MOST_CRAFT or self.n * self.problem.nodes > MOST_STATES:
            raise InputError(
                f"there are {self.n} spacecraft and {self.problem.nodes} nodes; expected at most "
                f"{MOST_CRAFT} spacecraft, and {MOST_STATES} of both multiplied."
            )
        if len(self.initial) != len(self.goal):
            raise InputError(
                f"initial has {len(self.initial)} states and goal has {len(self.goal)}; expected "
                "one of each for every spacecraft."
            )

        check_craft(self.craft, self.n, self.problem.thrust)
        check_waypoints(self.waypoints, self.n, self.problem)

    def __repr__(self) -> str:
        """Name, size and time grid; without the arrays."""
        grid = f"{self.problem.intervals} intervals of {self.problem.time_step:g} s"
        return f"Scenario({', '.join(filter(None, [self.name, f'{self.n} craft', grid]))})"

    @property
    def n(self) -> int:
        """Number of spacecraft."""
        return len(self.initial)

    @cached_property
    def limits(self) -> Limits | None:
        """What the thrusters of each craft can do; None where max_acceleration is all of it.

        With waypoints, too, plans are made by programs that know such limits.
        """
        plain = self.problem.thrust == ALONG_AXES and not any(one.limited for one in self.craft)
        return None if plain and not self.waypoints else limits_of(self.craft, self.n, self.problem)

    def taking(self, slots: Sequence[int]) -> "Scenario":
        """The scenario in which each craft goes to the goal of that number here."""
        return replace(self, goal=self.goal[list(slots)])


def shared_problem(scenarios: Sequence[Scenario]) -> Problem:
    """The one problem of at least one scenario; several are an InputError."""
    problem = scenarios[0].problem
    for k, scenario in enumerate(scenarios):
        if scenario.problem is not problem and scenario.problem != problem:
            differing = next(
                field.name
                for field in fields(problem)
                if getattr(scenario.problem, field.name) != getattr(problem, field.name)
            )
            raise InputError(
                f"scenarios 0 and {k} have {differing} {getattr(problem, differing)} and "
                f"{getattr(scenario.problem, differing)}; expected scenarios of one problem: plan "
                "each problem's scenarios by themselves."
            )
    return problem
