"""Craft of different sizes, and obstacles, which no plan moves, such as a chief or debris.

The relative position of a pair must stay outside an ellipsoid along the LVLH axes: a sphere of the
sum of both radii for two craft. Axes are scaled so that it becomes a sphere of its least semi-axis
q: distances shrink, so that bounds on derivatives hold. Scaled distances less q - r_col compare
with r_col as those of equal craft do, so the searches for closest approaches serve unchanged
(``docs/mathematics.md``).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pipeline.arrays import Array, Bool, Float, fields_as_python
from pipeline.errors import InputError, check_range, check_vector
from pipeline.orbit.arrays import (
    Controls,
    CraftMask,
    Indices,
    PositionMaps,
    States,
    Values,
    Vectors,
)
from pipeline.orbit.corridors import Corridor, Faces
from pipeline.orbit.partition import Pairs, SwarmPartition, swarm_partition
from pipeline.orbit.problem import RANGES, Problem
from pipeline.orbit.transfer import fly

MOST_UNLIKE = 500  # craft at most of a swarm with radii or obstacles: all pairs are compared


@dataclass(frozen=True)
class Obstacle:
    """A body that craft keep clear of and no plan moves: a chief, a target, debris, a dead craft.

    Attributes:
        name: what messages and certificates call it.
        state: at the first node, LVLH, m and m/s.
        radius: of the sphere that it takes up, m; or give semi_axes.
        semi_axes: of the ellipsoid about it that no part of a craft may enter, along x, y, z, m.
        hold: whether it is held where it is, or drifts.
    """

    name: str
    state: tuple[float, ...]
    radius: float | None = None
    semi_axes: tuple[float, float, float] | None = None
    hold: bool = False

    def __post_init__(self) -> None:
        fields_as_python(self)
        check_vector(f"state of obstacle {self.name!r}", self.state, 6)
        object.__setattr__(self, "state", tuple(map(float, self.state)))
        if (self.radius is None) == (self.semi_axes is None):
            raise InputError(f"obstacle {self.name!r} needs one of radius and semi_axes, m.")
        check_vector(f"semi_axes of obstacle {self.name!r}", self.axes)
        for one in self.axes:
            check_range(f"size of obstacle {self.name!r}", one, *RANGES["collision_radius"])
        if self.hold and any(self.state[3:]):
            raise InputError(
                f"obstacle {self.name!r} is held and has a velocity; expected a position alone."
            )

    def __str__(self) -> str:
        x, y, z = self.axes
        axes = f"semi-axes of {x:g}, {y:g}, {z:g}"
        return f"{self.name} has {axes if self.semi_axes else f'a radius of {x:g}'} m"

    @property
    def axes(self) -> tuple[float, ...]:
        """Semi-axes of the ellipsoid, or the radius three times, m."""
        radius = 0.0 if self.radius is None else self.radius
        return (radius,) * 3 if self.semi_axes is None else self.semi_axes

    def wider(self, by: float) -> "Obstacle":
        """The obstacle with its radius or semi-axes larger by a length, m."""
        if self.semi_axes is None:
            return replace(self, radius=(self.radius or 0.0) + by)
        x, y, z = self.semi_axes
        return replace(self, semi_axes=(x + by, y + by, z + by))


def check_obstacles(obstacles: Sequence[Obstacle], problem: Problem) -> None:
    """Raise InputError for names that are not unique, and for obstacles that cannot be held."""
    names = [one.name for one in obstacles]
    if "" in names or len(set(names)) < len(names):
        raise InputError("obstacles have no name or one that another has; expected one for each.")
    for one in obstacles:
        if one.hold and problem.orbit is not None and any(one.state):
            raise InputError(
                f"obstacle {one.name!r} is held away from the origin about an orbit that is no "
                "circle; expected hold at the origin, or with altitude or mean_motion alone."
            )


def at_the_end(obstacles: Sequence[Obstacle], problem: Problem) -> list[Obstacle]:
    """The obstacles as they are at the last node."""
    there = Participants(problem, [np.zeros(0)], [obstacles]).states[:, -1].tolist()
    return [
        one if one.hold else replace(one, state=tuple(state))
        for one, state in zip(obstacles, there, strict=True)
    ]


class Participants(SwarmPartition):
    """Craft of several swarms, with their radii, followed by all obstacles, as rows."""

    def __init__(
        self,
        problem: Problem,
        radii: Sequence[Float[Array, "_"]],
        obstacles: Sequence[Sequence[Obstacle]],
        corridors: Sequence[Sequence[Corridor]] = (),
    ) -> None:
        super().__init__(tuple(map(len, radii)))
        self.problem, self.craft = problem, sum(self.sizes)
        self.few = True
        inside = zip(corridors, self.sizes, self.starts.tolist(), strict=False)
        if any(corridors):
            self.faces = Faces.concatenated([Faces.of(*one) for one in inside])
        self.radius = np.concatenate(radii)  # of each craft, m
        self.obstacles = [one for some in obstacles for one in some]  # the obstacles
        self.counts = np.array([len(some) for some in obstacles])
        self.first = self.craft + np.cumsum(self.counts) - self.counts  # of each swarm's obstacles
        self._axes = np.array([one.axes for one in self.obstacles]).reshape(-1, 3)
        self._holds = np.array([one.hold for one in self.obstacles], dtype=bool)
        self.held = self.craft + np.flatnonzero(self._holds)
        initial = np.array([one.state for one in self.obstacles]).reshape(-1, 6)
        e2 = problem.mean_motion**2
        # Constant control that holds each in place, by Eq. 1, m/s²; zero for those that drift
        self.hold_controls = np.where(
            self._holds[:, None], initial[:, :3] * [-3 * e2, 0.0, e2], 0.0
        )
        self.controls = np.repeat(self.hold_controls[:, None], problem.intervals, axis=1)
        # Node states of obstacles; a flight replaces them by its own.
        self.states: States = fly(initial, self.controls, problem)

    @cached_property
    def pairs(self) -> Pairs:
        """Pairs of craft of a swarm, and then each craft of a swarm with each of its obstacles."""
        i, j = swarm_partition(self.sizes).pairs
        counts = self.counts[self.label]
        craft = np.repeat(np.arange(self.craft), counts)
        number = np.arange(len(craft)) - np.repeat(np.cumsum(counts) - counts, counts)
        other = self.first[self.label[craft]] + number
        return np.concatenate([i, craft]), np.concatenate([j, other])

    def all_states(
        self, states: States, nodes: slice = slice(None)
    ) -> Float[Array, "participants T 6"]:
        """As ``SwarmPartition.all_states``, with the obstacles."""
        return np.concatenate([states, self.states[:, nodes]])

    def all_controls(self, controls: Controls) -> Float[Array, "participants intervals 3"]:
        """As ``SwarmPartition.all_controls``, with the obstacles."""
        return np.concatenate([controls, self.controls])

    def participant_mask(self, moved: CraftMask) -> Bool[Array, "participants"]:
        """As ``SwarmPartition.participant_mask``: no obstacle is."""
        return np.append(moved, np.zeros(len(self.obstacles), dtype=bool))

    def local_index(self, swarm: int, row: int) -> int:
        """As ``SwarmPartition.local_index``; the swarm's obstacles follow its craft."""
        if row < self.craft:
            return super().local_index(swarm, row)
        return self.sizes[swarm] + row - int(self.first[swarm])

    def separation_scaling(self, first: Indices, second: Indices) -> tuple[Vectors, Values]:
        """As ``SwarmPartition.separation_scaling``: scales of the axes, and q - r_col, m.

        The least ellipsoid, by the sum of its squared semi-axes, about all points within a
        radius r of an ellipsoid with semi-axes a has √(a²(1 + 1/β) + r²(1 + β)), β² = Σa²/3r².
        """
        r = self.radius[first]
        wanted = np.empty((len(first), 3))
        craft = second < self.craft
        wanted[craft] = (r[craft] + self.radius[second[craft]])[:, None]
        a, r = self._axes[second[~craft] - self.craft], r[~craft, None]
        beta = np.sqrt(np.square(a).sum(axis=1, keepdims=True) / 3) / r
        wanted[~craft] = np.sqrt(a**2 * (1 + 1 / beta) + r**2 * (1 + beta))
        least = wanted.min(axis=1)
        return least[:, None] / wanted, least - self.problem.collision_radius

    def obstacle_positions(self, rows: Indices, interval: Indices, maps: PositionMaps) -> Vectors:
        """Positions of obstacles, m, by maps from starts of intervals, also beyond the plan."""
        k, dynamics = rows - self.craft, self.problem.dynamics
        begin = np.array(self.states[k, 0])
        drift = ~self._holds[k]
        begin[drift] = np.matvec(dynamics.drift(np.zeros_like(interval), interval), begin)[drift]
        return np.matvec(maps[0], begin) + np.matvec(maps[1], self.hold_controls[k])
