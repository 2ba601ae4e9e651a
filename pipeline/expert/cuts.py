"""Half-space cuts: which pairs are held apart at which times, and in which direction."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.arrays import Array
from pipeline.orbit.approaches import Swarms, close_approaches, side_by_side
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import TransferMaps, transfer_maps
from pipeline.plan import AT_ALL_TIMES, Requirements

TOUCHING = 1e-3
"""Distance in m under which two craft give no direction of their own."""


@dataclass(frozen=True, eq=False)
class Apart:
    """How a cut's second craft is looked at, where that differs from the first.

    Attributes:
        interval: at whose start the second craft's state counts, (k,).
        free: from that state to the second's position, (k, 3, 6).
        pushed: the same of its control in that interval, (k, 3, 3).
        offset: position of the first, or less that of the second, as far as it is fixed, (k, 3), m.
    """

    interval: Int[Array, "k"]
    free: Float[Array, "k 3 6"]
    pushed: Float[Array, "k 3 3"]
    offset: Float[Array, "k 3"]


@dataclass(frozen=True, eq=False)
class Cuts:
    """Pairs and times at which a separation is asked for.

    Attributes:
        first: first craft, (k,).
        second: second craft, (k,).
        interval: interval of the time, (k,).
        free: from a craft's state at the interval's start to its position then, (k, 3, 6).
        pushed: the same of its control in the interval, (k, 3, 3).
        apart: the same of the second craft, where some cuts look at it in another way.
    """

    first: Int[Array, "k"]
    second: Int[Array, "k"]
    interval: Int[Array, "k"]
    free: Float[Array, "k 3 6"]
    pushed: Float[Array, "k 3 3"]
    apart: Apart | None = None

    def __len__(self) -> int:
        """Number of cuts."""
        return len(self.first)

    def __add__(self, other: "Cuts") -> "Cuts":
        """Both sets of cuts."""
        both = zip(self._parts, other._parts, strict=True)
        first, second, interval, free, pushed = map(np.concatenate, both)
        if self.apart is None and other.apart is None:
            return Cuts(first, second, interval, free, pushed)
        looks = zip(vars(self.second_look).values(), vars(other.second_look).values(), strict=True)
        return Cuts(first, second, interval, free, pushed, Apart(*map(np.concatenate, looks)))

    def where(self, keep: Bool[Array, "k"] | Int[Array, "j"]) -> "Cuts":
        """Some of the cuts."""
        first, second, interval, free, pushed = (part[keep] for part in self._parts)
        if self.apart is None:
            return Cuts(first, second, interval, free, pushed)
        look = Apart(*(part[keep] for part in vars(self.apart).values()))
        return Cuts(first, second, interval, free, pushed, look)

    @property
    def second_look(self) -> Apart:
        """How the second craft is looked at."""
        same = Apart(self.interval, self.free, self.pushed, np.zeros((len(self), 3)))
        return same if self.apart is None else self.apart

    @property
    def in_flight(self) -> Bool[Array, "k"]:
        """Those of two craft that both fly their plans: both are looked at in the same way."""
        same, other = vars(replace(self, apart=None).second_look), vars(self.second_look)
        differ = [(same[k] != other[k]).reshape(len(self), -1).any(axis=1) for k in same]
        return ~np.any(differ, axis=0)

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
    """Cuts with directions: row · uᵢ - other · uⱼ ≥ required is a separation along the normal.

    Attributes:
        row: (k, m), m per m/s².
        required: (k,), m.
        other: (k, m), m per m/s²; None where it is ``row``.
    """

    row: Float[Array, "k m"]
    required: Float[Array, "k"]
    other: Float[Array, "k m"] | None = None


def conflicts(
    states: Float[Array, "n T 6"],
    controls: Float[Array, "n intervals 3"],
    problem: Problem,
    within: float,
    moved: Bool[Array, "n"],
    requirements: Requirements = AT_ALL_TIMES,
    *,
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
        requirements: say whether all times are looked at, or the nodes only.
        swarms: which craft belong together; by default all of them.
        beside: also cut so long before and after each closest approach, as a share of the
            interval, since it moves; not at nodes only.

    Returns:
        A cut at each closest approach, and a lower bound on the separation there, m.
    """
    if requirements.at_nodes:
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
    if cuts.apart is not None:
        look = cuts.apart
        one = np.matvec(cuts.free, states[i, k]) + np.matvec(cuts.pushed, controls[i, k])
        other = np.matvec(look.free, states[j, look.interval])
        return look.offset + one - other - np.matvec(look.pushed, controls[j, look.interval])
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
    row = _row(to_state, normal, k, cuts.pushed, maps)
    if cuts.apart is not None:
        look = cuts.apart
        seen = np.vecmat(normal, look.free)
        other = _row(seen, normal, look.interval, look.pushed, maps)
        apart = np.vecdot(normal, look.offset)
        apart += np.vecdot(to_state, np.matvec(maps.drift[k], initial[i]))
        apart -= np.vecdot(seen, np.matvec(maps.drift[look.interval], initial[j]))
        return HalfSpaces(row, separation - apart, other)
    drifted = np.matvec(maps.drift[k], initial[i] - initial[j])
    return HalfSpaces(row, separation - np.vecdot(to_state, drifted))


def _row(
    to_state: Float[Array, "k 6"],
    normal: Float[Array, "k 3"],
    interval: Int[Array, "k"],
    pushed: Float[Array, "k 3 3"],
    maps: TransferMaps,
) -> Float[Array, "k m"]:
    """Effect of a craft's controls along each normal, m per m/s²."""
    row = np.vecmat(to_state, maps.reach[interval])
    columns = 3 * interval[:, None] + np.arange(3)
    row[np.arange(len(interval))[:, None], columns] += np.vecmat(normal, pushed)
    return row


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
