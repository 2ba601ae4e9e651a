"""Half-space cuts: which pairs are held apart at which times, and in which direction."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.arrays import Array
from pipeline.orbit.approaches import Swarms, close_approaches, side_by_side
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import transfer_maps

TOUCHING = 1e-3
"""Distance in m under which two craft give no direction of their own."""


@dataclass(frozen=True, eq=False)
class Cuts:
    """Pairs and times at which a separation is asked for.

    Attributes:
        first: first craft, (k,).
        second: second craft, (k,).
        interval: interval of the time, (k,).
        free: from a craft's state at the interval's start to its position then, (k, 3, 6).
        pushed: the same of its control in the interval, (k, 3, 3).
    """

    first: Int[Array, "k"]
    second: Int[Array, "k"]
    interval: Int[Array, "k"]
    free: Float[Array, "k 3 6"]
    pushed: Float[Array, "k 3 3"]

    def __len__(self) -> int:
        """Number of cuts."""
        return len(self.first)

    def __add__(self, other: "Cuts") -> "Cuts":
        """Both sets of cuts."""
        return Cuts(*(np.concatenate(both) for both in zip(self._parts, other._parts, strict=True)))

    def where(self, keep: Bool[Array, "k"] | Int[Array, "j"]) -> "Cuts":
        """Some of the cuts."""
        return Cuts(*(part[keep] for part in self._parts))

    @property
    def _parts(self) -> tuple[Array, ...]:
        return self.first, self.second, self.interval, self.free, self.pushed


_NO_INDEX = np.zeros(0, dtype=int)
NO_CUTS = Cuts(_NO_INDEX, _NO_INDEX, _NO_INDEX, np.zeros((0, 3, 6)), np.zeros((0, 3, 3)))


def cuts_at(
    first: Int[Array, "k"],
    second: Int[Array, "k"],
    interval: Int[Array, "k"],
    offset: Float[Array, "k"],
    problem: Problem,
) -> Cuts:
    """Cuts at times since the starts of their intervals, s."""
    free, pushed = problem.dynamics.step(offset)
    return Cuts(first, second, interval, free[:, :3], pushed[:, :3])


@dataclass(frozen=True, eq=False)
class HalfSpaces:
    """Cuts with directions: row · (uᵢ - uⱼ) ≥ required is a separation along the normal.

    Attributes:
        row: (k, m), m per m/s².
        required: (k,), m.
    """

    row: Float[Array, "k m"]
    required: Float[Array, "k"]


def conflicts(
    states: Float[Array, "n T 6"],
    controls: Float[Array, "n intervals 3"],
    problem: Problem,
    within: float,
    moved: Bool[Array, "n"],
    *,
    at_nodes: bool,
    swarms: Swarms | None = None,
    beside: float = 0.0,
) -> tuple[Cuts, Float[Array, "k"]]:
    """Where pairs with at least one moved craft come within a distance, and how close.

    Args:
        states: node states, m and m/s.
        controls: m/s².
        problem: the problem.
        within: distance of interest, m.
        moved: craft whose pairs are looked at.
        at_nodes: look at the nodes only (the paper's criterion), not at all times.
        swarms: which craft belong together; by default all of them.
        beside: also cut so long before and after each closest approach, as a share of the
            interval, since it moves; not at nodes only.

    Returns:
        A cut at each closest approach, and a lower bound on the separation there, m.
    """
    if at_nodes:
        i, j = (swarms or side_by_side((len(states),))).pairs
        touched = moved[i] | moved[j]
        i, j = i[touched], j[touched]
        distance = np.linalg.norm(states[i, :-1, :3] - states[j, :-1, :3], axis=-1)
        row, node = np.nonzero(distance <= within)
        return cuts_at(i[row], j[row], node, np.zeros(len(row)), problem), distance[row, node]
    found = close_approaches(states, controls, problem, within, swarms=swarms, moved=moved)
    pairs = found.first, found.second, found.interval
    cuts, bound, h = Cuts(*pairs, found.free, found.pushed), found.bound, problem.time_step
    for way in (-beside, beside) if beside else ():
        cuts += cuts_at(*pairs, np.clip(found.offset + way * h, 0.0, h), problem)
        bound = np.concatenate([bound, found.bound])
    return cuts, bound


def gaps(
    cuts: Cuts,
    states: Float[Array, "n T 6"],
    controls: Float[Array, "n intervals 3"],
) -> Float[Array, "k 3"]:
    """Position of each cut's first craft relative to its second, there and then, m."""
    i, j, k = cuts.first, cuts.second, cuts.interval
    gap = np.matvec(cuts.free, states[i, k] - states[j, k])
    return gap + np.matvec(cuts.pushed, controls[i, k] - controls[j, k])


def half_spaces(
    cuts: Cuts,
    states: Float[Array, "n T 6"],
    controls: Float[Array, "n intervals 3"],
    problem: Problem,
    separation: Float[Array, "k"] | float,
    shift: Float[Array, "k 3"] | float = 0.0,
) -> HalfSpaces:
    """Aim cuts from a trajectory: n̂ is the direction between the pair there and then.

    Args:
        cuts: pairs and times.
        states: node states of the trajectory, m and m/s.
        controls: its controls, m/s².
        problem: the problem.
        separation: what to ask for, of all or of each, m.
        shift: added to each gap before its direction is taken, m: passes on another side.
    """
    gap = gaps(cuts, states, controls) + shift
    k = cuts.interval
    normal = directions(gap, states[cuts.first, k, 3:] - states[cuts.second, k, 3:])
    return half_spaces_along(cuts, normal, states[:, 0], problem, separation)


def half_spaces_along(
    cuts: Cuts,
    normal: Float[Array, "k 3"],
    initial: Float[Array, "n 6"],
    problem: Problem,
    separation: Float[Array, "k"] | float,
) -> HalfSpaces:
    """Cuts with given directions: normal · (pᵢ - pⱼ) ≥ separation there and then.

    Args:
        cuts: pairs and times.
        normal: direction of each cut.
        initial: initial states, m and m/s.
        problem: the problem.
        separation: what to ask for, of all or of each, m.
    """
    maps = transfer_maps(problem)
    i, j, k = cuts.first, cuts.second, cuts.interval
    to_state = np.vecmat(normal, cuts.free)
    row = np.vecmat(to_state, maps.reach[k])
    columns = 3 * k[:, None] + np.arange(3)
    row[np.arange(len(k))[:, None], columns] += np.vecmat(normal, cuts.pushed)
    drifted = np.matvec(maps.drift[k], initial[i] - initial[j])
    return HalfSpaces(row, separation - np.vecdot(to_state, drifted))


def directions(gap: Float[Array, "k 3"], velocity: Float[Array, "k 3"]) -> Float[Array, "k 3"]:
    """Unit vectors along each gap; across the relative velocity where the two craft touch."""
    distance = np.linalg.norm(gap, axis=1)
    touching = distance < TOUCHING
    if touching.any():
        axis = np.eye(3)[np.abs(velocity).argmin(axis=1)]
        across = np.cross(velocity, axis)
        across = np.where(np.linalg.norm(across, axis=1, keepdims=True) > 0, across, axis)
        gap = np.where(touching[:, None], across, gap)
        distance = np.linalg.norm(gap, axis=1)
    return gap / distance[:, None]
