"""Least distances in a flight: between craft, to obstacles, and inside corridors."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.arrays import Array, Float, like, namespace, plain
from pipeline.flight.world import World
from pipeline.orbit.corridors import Faces, least_margin
from pipeline.orbit.nearest import Nearest, nearest, smaller_separation
from pipeline.scenario import Scenario, participants

OF_CRAFT = "min_separation", "first_craft", "second_craft", "min_separation_time"
OF_SIZES = "min_clearance", "clearance_craft", "clearance_other", "min_clearance_time"
OF_CORRIDORS = "min_margin", "margin_craft", "margin_corridor", "min_margin_time"
"""Columns of trials, of each a distance, two numbers and a time. The other one of a clearance is a
craft or, numbered on after the craft, an obstacle."""


@dataclass(frozen=True, eq=False)
class LeastDistances:
    """The least distances in each trial over a time span."""

    craft: Nearest  # of any two craft
    # of craft and obstacles by their sizes, as it compares with r_col; None where sizes are alike
    sized: Nearest | None = None
    inside: Nearest | None = None  # of craft inside of their corridors; None where there are none

    def nearer(self, other: "LeastDistances") -> "LeastDistances":
        """The least distances over both time spans."""
        return LeastDistances(
            smaller_separation(self.craft, other.craft),
            self.sized and other.sized and smaller_separation(self.sized, other.sized),
            self.inside and other.inside and smaller_separation(self.inside, other.inside),
        )

    def columns(self, radius: float) -> dict[str, Array]:
        """Columns of ``Trials``: distances, which pair or corridor, and times, by r_col, m."""
        kinds = (
            (OF_CRAFT, self.craft, 0.0),
            (OF_SIZES, self.sized, radius),
            (OF_CORRIDORS, self.inside, 0.0),
        )
        found: dict[str, Array] = {}
        for names, one, off in kinds:
            if one is not None:
                columns = one.distance - off, one.first, one.second, one.time
                found |= zip(names, columns, strict=True)
        return found


class Surroundings:
    """Obstacles and corridors of a scenario in a world, and least distances of craft to them.

    Obstacles are held, or drift there without errors and with the swarm's mean drag coefficient.
    """

    def __init__(self, scenario: Scenario, world: World) -> None:
        self._scenario, self._faces = scenario, Faces.of(scenario.corridors, scenario.n)
        self._swarms = participants([scenario]) if scenario.sized else None
        self._arcs = list(_obstacle_arcs(scenario, world)) if scenario.obstacles else []

    @property
    def obstacles(self) -> Float[Array, "m T 6"]:
        """States of obstacles at the nodes, m and m/s, LVLH."""
        states = np.zeros((len(self._scenario.obstacles), self._scenario.problem.nodes, 6))
        for k, arc in enumerate(self._arcs):
            states[:, k], states[:, k + 1] = arc[:, 0, 0], arc[:, -1, -1]
        return states

    def least_distances(self, arcs: Float[Any, "K n M q 6"], interval: int) -> LeastDistances:
        """The least distances in an interval, by the arcs of the craft of K trials."""
        h = self._scenario.problem.time_step
        when, sized, inside = (interval * h, h), None, None
        if self._swarms is not None:
            there = self._arcs[interval : interval + 1]
            beside = [np.broadcast_to(one, (len(arcs), *one.shape)) for one in there]
            both = namespace(arcs).concatenate([arcs, *(like(one, arcs) for one in beside)], axis=1)
            sized = nearest(both, *when, self._swarms)
        if len(self._faces):
            inside = least_margin(plain(arcs), self._faces, *when)
        return LeastDistances(nearest(arcs, *when), sized, inside)


def _obstacle_arcs(scenario: Scenario, world: World) -> Iterator[Float[Array, "m M q 6"]]:
    states = np.array([one.state for one in scenario.obstacles])
    held = np.array([one.hold for one in scenario.obstacles])
    for k in range(scenario.problem.intervals):
        flown = np.where(held[:, None], 0.0, states)  # held ones as the reference
        arcs = world.of_obstacles.arc(flown, np.zeros((len(states), 3)), k)
        arcs[held] = states[held, None, None]
        states = arcs[:, -1, -1]
        yield arcs
