"""Waypoints: places that a craft must pass on its way."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from pipeline.arrays import fields_as_python
from pipeline.errors import InputError, check_range, check_vector, is_whole
from pipeline.orbit.arrays import States, Values
from pipeline.orbit.problem import Problem
from pipeline.orbit.thrust import ON_GRID

LATEST = 1e12  # s, later than any transfer ends
MOST_CHOICES = 400  # most combinations of nodes for the waypoints of a craft without a time


@dataclass(frozen=True)
class Waypoint:
    """A position, and maybe a velocity, that a craft must have at a node.

    Attributes:
        craft: its number.
        position: LVLH, m.
        velocity: LVLH, m/s, or None for any.
        time: s since the first node, or None for the node at which it costs least.
    """

    craft: int
    position: tuple[float, float, float]
    velocity: tuple[float, float, float] | None = None
    time: float | None = None

    def __post_init__(self) -> None:
        fields_as_python(self)
        if not is_whole(self.craft):
            raise InputError(f"craft of a waypoint is {self.craft!r}; expected a craft's number.")
        check_vector("position of a waypoint", self.position)
        if self.velocity is not None:
            check_vector("velocity of a waypoint", self.velocity)
        if self.time is not None:
            check_range("time of a waypoint", self.time, 0.0, LATEST)

    @property
    def state(self) -> Values:
        """Position and velocity, 0 where any will do; LVLH, m and m/s."""
        return np.array([*self.position, *(self.velocity or (0.0, 0.0, 0.0))])

    def node(self, problem: Problem) -> int | None:
        """The node of its time, or None."""
        return None if self.time is None else round(self.time / problem.time_step)


def of_craft(waypoints: Sequence[Waypoint]) -> dict[int, list[Waypoint]]:
    """The waypoints, in order, of each craft that has some."""
    ordered = sorted(waypoints, key=lambda one: one.craft)
    return {k: list(some) for k, some in groupby(ordered, key=lambda one: one.craft)}


def check_waypoints(waypoints: Sequence[Waypoint], n: int, problem: Problem) -> None:
    """Refuse waypoints of unknown craft, off the inner nodes or out of order with an InputError."""
    for k, one in enumerate(waypoints):
        if not 0 <= one.craft < n:
            raise InputError(
                f"waypoints[{k}].craft is {one.craft}; expected a craft's number, 0 to {n - 1}."
            )
        node = one.node(problem)
        if node is None or one.time is None:
            continue
        off = abs(one.time / problem.time_step - node)
        if not (off <= ON_GRID and 0 < node < problem.intervals):
            raise InputError(
                f"waypoints[{k}].time is {one.time:g} s; expected a node between the first and the "
                f"last: a multiple of {problem.time_step:g} s below {problem.duration:g} s."
            )
    for craft, some in of_craft(waypoints).items():
        nodes = [node for one in some if (node := one.node(problem)) is not None]
        if nodes != sorted(set(nodes)):
            raise InputError(
                f"waypoints of craft {craft} are not in the order of their times; expected one "
                "after the other: sort them."
            )
        if len(node_choices(some, problem)) not in range(1, MOST_CHOICES + 1):
            raise InputError(
                f"craft {craft} has {len(some)} waypoints, whose open times can be chosen in no "
                f"way, or in more than {MOST_CHOICES}; expected fewer: give some a time."
            )


def closest_pair(
    waypoints: Sequence[Waypoint], problem: Problem, radii: Values
) -> tuple[float, int, int, float] | None:
    """Distance (m), both craft and time (s) of the pair that waypoints bring closest, by radii."""
    timed = [one for one in waypoints if one.time is not None]
    craft = np.array([one.craft for one in timed])
    places = np.array([one.position for one in timed])
    nodes = np.array([one.node(problem) for one in timed])
    found = []
    for k, one in enumerate(timed):
        others = k + 1 + np.flatnonzero(nodes[k + 1 :] == nodes[k])
        if len(others) > 0:
            distances = np.linalg.norm(places[others] - places[k], axis=1)
            least = int((distances - radii[craft[others]]).argmin())
            other = int(craft[others[least]])
            found.append((float(distances[least]), one.craft, other, one.time or 0.0))
    return min(found, key=lambda one: one[0] - radii[one[1]] - radii[one[2]], default=None)


def node_choices(waypoints: Sequence[Waypoint], problem: Problem) -> list[tuple[int, ...]]:
    """Possible combinations of ascending nodes for the waypoints of one craft.

    All of them or, where there are more than MOST_CHOICES, some more than that number.
    """
    latest: list[int] = []
    last = problem.intervals
    for one in reversed(waypoints):  # the node of each that leaves room for those after it
        node = one.node(problem)
        last = last - 1 if node is None else min(last - 1, node)
        latest.insert(0, last)
    found: list[tuple[int, ...]] = [()]
    for one, last in zip(waypoints, latest, strict=True):
        node, longer = one.node(problem), []
        for before in found:
            open_nodes = range(before[-1] + 1 if before else 1, last + 1)
            nodes = open_nodes if node is None else [node] * (node in open_nodes)
            longer += [(*before, k) for k in nodes]
            if len(longer) > MOST_CHOICES:
                break
        found = longer
    return found


def waypoint_nodes(
    waypoints: Sequence[Waypoint], states: States, problem: Problem
) -> dict[int, list[tuple[int, Waypoint]]]:
    """The waypoints of each craft, each with the node at which it is passed.

    For those without a time, the combination of nodes with the least miss is chosen.
    """
    found = {}
    for craft, some in of_craft(waypoints).items():
        tried = [[*zip(nodes, some, strict=True)] for nodes in node_choices(some, problem)]
        off = [
            max(far + problem.duration * fast for far, fast in each)
            for each in ([_miss(one, states[craft, k]) for k, one in way] for way in tried)
        ]
        found[craft] = tried[int(np.argmin(off))]
    return found


def waypoint_errors(
    waypoints: Sequence[Waypoint], states: States, problem: Problem
) -> tuple[float, float]:
    """Largest miss of waypoints by node states, m and m/s, at the nodes of ``waypoint_nodes``."""
    passed = waypoint_nodes(waypoints, states, problem)
    each = [_miss(one, states[craft, k]) for craft, some in passed.items() for k, one in some]
    position, velocity = np.max([(0.0, 0.0), *each], axis=0).tolist()
    return position, velocity


def _miss(waypoint: Waypoint, state: np.ndarray) -> tuple[float, float]:
    velocity = state[3:] if waypoint.velocity is None else np.array(waypoint.velocity)
    off = np.abs(state[:3] - waypoint.position).max(), np.abs(state[3:] - velocity).max()
    return float(off[0]), float(off[1])
