"""A scenario: the states that each craft starts from and must reach."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np

from pipeline.arrays import Array, Float, as_floats
from pipeline.errors import InputError, check_choice, check_each, check_kind, list_if_iterable
from pipeline.orbit.arrays import PerCraft
from pipeline.orbit.corridors import Corridor, Faces, check_corridors
from pipeline.orbit.participants import MOST_UNLIKE, Obstacle, Participants, check_obstacles
from pipeline.orbit.partition import SwarmPartition, least_of_each, swarm_partition
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import Reference, radius_at
from pipeline.orbit.thrust import ALONG_AXES, Limits
from pipeline.scenario.spacecraft import Spacecraft, check_craft, limits_of
from pipeline.scenario.waypoint import Waypoint, check_waypoints

# Largest number of craft, for a list of all pairs to fit in memory, and of craft times nodes
MOST_CRAFT, MOST_STATES = 10_000, 1_000_000
# Largest component of a position, m, and of a velocity, m/s, on any orbit
FURTHEST, FASTEST = 1e9, 1e6
RELATIVE = 0.1  # largest distance from the origin, as a share of the reference orbit's radius

PARTS = {
    "craft": Spacecraft,
    "waypoints": Waypoint,
    "obstacles": Obstacle,
    "corridors": Corridor,
}
EndKind = Literal["passive", "any"]


@dataclass(frozen=True, eq=False, repr=False)
class Scenario:
    """Initial and goal states of a swarm, with the problem they belong to.

    Attributes:
        problem: orbit, time grid and collision radius.
        initial: states at the first node, (n, 6), m and m/s, LVLH; lists become arrays.
        goal: states at the last node, (n, 6).
        family: the family it was drawn from, or "custom".
        name: in tables and figures; of a file that is read, the file's name.
        reference: epoch and orientation of the reference orbit, or None; plans as flown use it.
        ends: passive, states on orbits that do not drift; or any, as in a rendezvous.
        craft: properties of each craft of its own; empty where all are alike.
        waypoints: places that craft must pass on their way, in the order of each craft.
        obstacles: bodies without control that craft keep clear of.
        corridors: boxes and approach cones that craft stay inside of for some time. The last
            four become tuples.
    """

    problem: Problem
    initial: Float[Array, "..."]  # __post_init__ checks the shapes, and says what is wrong
    goal: Float[Array, "..."]
    family: str = "custom"
    name: str = ""
    reference: Reference | None = None
    ends: EndKind = "passive"
    craft: Sequence[Spacecraft] = ()
    waypoints: Sequence[Waypoint] = ()
    obstacles: Sequence[Obstacle] = ()
    corridors: Sequence[Corridor] = ()

    def __post_init__(self) -> None:
        check_kind("problem", self.problem, Problem)
        check_kind("name", self.name, str)
        check_choice("ends", self.ends, get_args(EndKind))
        for name, kind in PARTS.items():
            check_each(name, getattr(self, name), kind)
            object.__setattr__(self, name, tuple(getattr(self, name)))
        for end in ("initial", "goal"):
            states = _states(end, getattr(self, end), self.problem.mean_motion)
            object.__setattr__(self, end, states)
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
        check_kind("reference", self.reference, Reference | None)
        check_craft(self.craft, self.n, self.problem.thrust)
        check_waypoints(self.waypoints, self.n, self.problem)
        check_obstacles(self.obstacles, self.problem)
        places = [(f"waypoints[{k}]", one.state) for k, one in enumerate(self.waypoints)]
        places += [(f"obstacle {one.name!r}", np.array(one.state)) for one in self.obstacles]
        for name, state in places:
            _check_reach(name, state[None], self.problem.mean_motion)
        check_corridors(self.corridors, self.n, self.problem)
        if self.unlike and self.n > MOST_UNLIKE:
            raise InputError(
                f"there are {self.n} spacecraft, with radii, obstacles or corridors; expected at "
                f"most {MOST_UNLIKE} with these."
            )

    def __repr__(self) -> str:
        grid = f"{self.problem.intervals} intervals of {self.problem.time_step:g} s"
        return f"Scenario({', '.join(filter(None, [self.name, f'{self.n} craft', grid]))})"

    @property
    def n(self) -> int:
        """Number of spacecraft."""
        return len(self.initial)

    @property
    def headline(self) -> str:
        """The beginning of figure titles: name, if any, and number of craft."""
        return f"{self.name}: " * bool(self.name) + f"n = {self.n}"

    @cached_property
    def limits(self) -> Limits | None:
        """Thrust limits of each craft; None where max_acceleration is the only one.

        Never None with waypoints: they are planned by the same programs as such limits.
        """
        plain = self.problem.thrust == ALONG_AXES and not any(one.limited for one in self.craft)
        return None if plain and not self.waypoints else limits_of(self.craft, self.n, self.problem)

    @property
    def sized(self) -> bool:
        """Whether craft have radii of their own, or there are obstacles."""
        return bool(self.obstacles) or any(one.radius is not None for one in self.craft)

    @property
    def unlike(self) -> bool:
        """Whether there are sizes or corridors besides the collision radius."""
        return self.sized or bool(self.corridors)

    def outside(self) -> Iterator[tuple[str, int, int, float]]:
        """Violations of corridors at the ends: end, craft, corridor, least margin (m, up to 0)."""
        if not self.corridors:
            return
        faces, last = Faces.of(self.corridors, self.n), self.problem.duration
        for end, states, at in (
            ("initial", self.initial, faces.begin <= 0),
            ("goal", self.goal, faces.end >= last),
        ):
            there = faces[at]
            margin = there.offset - np.vecdot(there.normal, states[there.craft, :3])
            _, least = least_of_each(margin, there.corridor * self.n + there.craft)
            for k in least[margin[least] <= 0].tolist():
                yield end, int(there.craft[k]), int(there.corridor[k]), float(margin[k])

    @property
    def radii(self) -> PerCraft:
        """Radius of each craft, m: half the collision radius where it has none of its own."""
        given = [one.radius for one in self.craft] or [None] * self.n
        half = self.problem.collision_radius / 2
        return np.array([half if one is None else one for one in given])

    def named(self, i: int, j: int) -> str:
        """Names of two participants in words; numbers from n on are obstacles."""
        other = str(j) if j < self.n else self.obstacles[j - self.n].name
        return f"craft {i} and {other}"

    def required_separation(self, i: int, j: int) -> str:
        """The collision radius, or sizes, that two participants must keep apart by, in words."""
        if not self.sized:
            return f"collision_radius is {self.problem.collision_radius:g} m"
        own = f"craft {i} has a radius of {self.radii[i]:g} m"
        if j < self.n:
            return f"{own}, craft {j} of {self.radii[j]:g} m"
        return f"{own}, {self.obstacles[j - self.n]}"

    def wider(self, by: float, inside: float = 0.0) -> "Scenario":
        """The scenario with separation increased and corridors narrowed, m."""
        problem, craft = self.problem, self.craft
        return replace(
            self,
            problem=replace(problem, collision_radius=problem.collision_radius + by),
            craft=tuple(
                one if one.radius is None else replace(one, radius=one.radius + by / 2)
                for one in craft
            ),
            obstacles=tuple(one.wider(by / 2) for one in self.obstacles),
            corridors=tuple(
                replace(one, inside=one.inside.narrower(inside)) for one in self.corridors
            ),
        )

    def taking(self, slots: Sequence[int]) -> "Scenario":
        """The scenario in which craft i takes the goal numbered ``slots[i]``."""
        return replace(self, goal=self.goal[list(slots)])

    def only(self, some: Sequence[int]) -> "Scenario":
        """The scenario with a subset of its craft, renumbered in the order given."""
        number = {k: new for new, k in enumerate(some)}
        corridors = []
        for corridor in self.corridors:
            inside = tuple(number[k] for k in corridor.craft or range(self.n) if k in number)
            corridors += [replace(corridor, craft=inside)] if inside else []
        return replace(
            self,
            initial=self.initial[list(some)],
            goal=self.goal[list(some)],
            craft=[self.craft[k] for k in some] if self.craft else (),
            waypoints=[
                replace(w, craft=number[w.craft]) for w in self.waypoints if w.craft in number
            ],
            corridors=corridors,
        )


def _states(end: str, given: Any, mean_motion: float) -> Float[Array, "n 6"]:
    """Copy of the states at an end as a float array; InputError if malformed or out of range."""
    try:
        # A copy, since the caller's array may change; what is masked counts as missing
        states = np.array(as_floats(given))
    except (TypeError, ValueError, RuntimeError) as error:
        raise InputError(
            f"{end} is no array of numbers ({error}); expected a row x y z vx vy vz in m "
            "and m/s for each spacecraft."
        ) from error
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
    _check_reach(end, states, mean_motion)
    return states


def _check_reach(name: str, states: Float[Array, "_ 6"], mean_motion: float) -> None:
    """Refuse states far from the reference, for which the linear model has no meaning."""
    far, fast = np.abs(states).reshape(-1, 2, 3).max(axis=(0, 2)).tolist()
    furthest = min(FURTHEST, RELATIVE * radius_at(mean_motion))
    if far > furthest or fast > FASTEST:
        raise InputError(
            f"{name} reaches {far:g} m and {fast:g} m/s; expected positions within "
            f"{furthest:g} m, {RELATIVE:.0%} of the reference orbit's radius, and "
            f"velocities within {FASTEST:g} m/s."
        )


def participants(scenarios: Sequence[Scenario]) -> SwarmPartition:
    """The partition into scenarios of the craft and obstacles of all, which share a problem."""
    if not any(one.unlike for one in scenarios):
        return swarm_partition(tuple(one.n for one in scenarios))
    radii, obstacles = [one.radii for one in scenarios], [one.obstacles for one in scenarios]
    corridors = [one.corridors for one in scenarios]
    return Participants(scenarios[0].problem, radii, obstacles, corridors)


def scenario_list(scenarios: Iterable[Scenario]) -> list[Scenario]:
    """List of the scenarios of an iterable; InputError if it is none, or has anything else."""
    found = list_if_iterable(scenarios)
    check_each("scenarios", found, Scenario)
    return found


def shared_problem(scenarios: Sequence[Scenario]) -> Problem:
    """The problem that scenarios, at least one, share; InputError where they differ."""
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
