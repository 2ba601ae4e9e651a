"""Closest approaches of craft, separating planes and their sides, in units of r_col and Δt.

Relative motion is linear and fuel is a norm, so a swarm twice as large with twice the collision
radius has the same transfers at twice the fuel. In units of r_col and Δt this scale drops out:
positions are in r_col, velocities in r_col/Δt, controls in r_col/Δt².

Within an interval the relative position of two craft is, to some millimetres, the cubic that has
the positions and velocities of both ends. So the separation along the gap at the closest approach
is linear in the states of the interval's two nodes, with Hermite weights.
"""

import sys
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from pipeline.arrays import Array, Bool, Float, Int, like, namespace, plain, tensor
from pipeline.networks.refiner.arrays import KERNELS, constant, rows, self_adjoint, where
from pipeline.orbit.arrays import Rows
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import transfer_maps

# Distance of decoupled optima within which a pair is considered: in r_col, and as a share of the
# swarm's extent, since craft that fly far can be moved far at little cost
NEAR, NEAR_OF_EXTENT = 4.0, 0.15

TOUCHING = 1e-4  # distance in r_col below which the gap of two craft defines no direction
STILL = 1e-9  # relative speed in r_col/Δt below which it defines no direction
# Of the search for closest approaches, in kernels.c too:
STRETCHES = 6  # parts of an interval in which the search at first takes motion as straight
NEWTON_STEPS = 3  # steps from there; the last changes the result by less than a millimetre
# Ratio of the squared distances after and before a Newton step up to which the step is taken: a
# smaller increase is rounding, and refusing it would leave the time accurate to 1e-7 only
EQUAL = 1 + 1e-12
THIRD = 1.0 / 3.0
LEVEL = 1e-6  # cosine between gap and relative velocity below which the distance is stationary


@dataclass(frozen=True, eq=False)
class Grid:
    """Scaled transfer maps of a problem: all node states are drift · s₁ + reach · u."""

    nodes: int  # T
    drift: Float[Any, "_ 6"]  # effect of the initial state on the states of all nodes
    reach: Float[Any, "_ m"]  # effect of the m = 3(T-1) controls on them
    free: Float[Any, "m m"]  # projection on controls that do not change the final state
    ends: Float[Any, "intervals 12 m"]  # rows of ``reach`` for both ends of each interval

    def fly(self, initial: Float[Any, "N 6"], controls: Float[Any, "N m"]) -> Float[Any, "N T 6"]:
        """Node states, by Eq. 2."""
        return (initial @ self.drift.T + controls @ self.reach.T).reshape(-1, self.nodes, 6)


@lru_cache(maxsize=32)
def grid_of(problem: Problem, device: Any = None) -> Grid:
    """The maps of a problem, which do not depend on r_col; as tensors if a device is given."""
    if device is not None:
        nodes, *parts = vars(grid_of(problem)).values()
        with sys.modules["torch"].inference_mode(False):  # the cached maps must serve training too
            return Grid(nodes, *(tensor(part, device) for part in parts))
    maps, step, scale = transfer_maps(problem), problem.time_step, per_step(problem)
    drift = (maps.drift * scale[:, None] / scale).reshape(-1, 6)
    reach = (maps.reach * scale[:, None] / step**2).reshape(len(drift), -1)
    free = np.eye(reach.shape[1]) - np.linalg.pinv(reach[-6:]) @ reach[-6:]
    ends = np.stack([reach[6 * t : 6 * t + 12] for t in range(problem.intervals)])
    return Grid(problem.nodes, drift, reach, free, ends)


def in_units(
    states: Float[Any, "b n 6"], radius: Float[Any, "b"], problem: Problem
) -> Float[Array, "N 6"]:
    """States of all craft, swarm after swarm, from m and m/s to r_col and r_col/Δt, as numpy's."""
    return (plain(states) * per_step(problem) / plain(radius)[:, None, None]).reshape(-1, 6)


def per_step(problem: Problem) -> Float[Array, "6"]:
    """Factors that turn a state in m and m/s into lengths: 1 for positions, Δt for velocities."""
    return np.repeat([1.0, problem.time_step], 3)


@dataclass(frozen=True, eq=False)
class Sides:
    """The sides of L planes, grouped by craft; plane l has the sides 2l and 2l + 1."""

    craft: Int[Any, "C"]  # the C craft with planes, in order
    start: Int[Any, "_"]  # where the sides of each begin in ``order``, and at last their number
    order: Int[Any, "S"]  # all sides, craft after craft
    place: Int[Any, "S"]  # of each side, the index of its craft in ``craft``

    @classmethod
    def of(cls, craft: Int[Any, "L 2"]) -> "Sides":
        """Both sides of separating planes between two craft each, by craft."""
        xp, flat = namespace(craft), craft.reshape(-1)
        there, place, count = xp.unique(flat, return_inverse=True, return_counts=True)
        start = xp.concatenate([count[:1] * 0, count.cumsum(0)])
        return cls(there, start, place.argsort(stable=True), place)

    def totals(self, values: Float[Any, "L 2"]) -> Float[Any, "L 2"]:
        """For each side, the sum of values over all sides of its craft."""
        return np.bincount(self.place, values.reshape(-1))[self.place].reshape(values.shape)

    def aggregate(
        self, messages: Float[Any, "L 2 H"], free: Float[Any, "L m"]
    ) -> Float[Any, "L 2 _"]:
        """Message aggregation: a cosine-weighted sum and a sum over the encounters of each craft.

        The cosine is that between the planes' normals, which the second craft sees reversed.
        """
        vectors = plain(free)

        def sums(values: Float[Array, "L 2 _"]) -> Float[Array, "L 2 _"]:
            result = np.zeros(values.shape)
            sizes = len(self.craft), vectors.shape[1], values.shape[2] // 2
            KERNELS.call("add_up", *sizes, values, vectors, self.start, self.order, result)
            return result.astype(values.dtype, copy=False)

        return self_adjoint(sums, namespace(messages).concatenate([messages, messages], axis=2))


@dataclass(frozen=True, eq=False)
class EncounterGeometry:
    """The closest approach of each encounter, without gradients."""

    share: Float[Any, "E"]  # when, as a share of the interval; 0 where not computed
    distance: Float[Any, "E"]  # r_col; infinite where not computed
    is_minimum: Bool[Any, "E"]  # whether the distance has a local minimum there


@dataclass(frozen=True, eq=False)
class Encounters(Rows):
    """Pairs of craft in intervals, each an edge of the encounter graph."""

    first: Int[Any, "E"]  # first craft
    second: Int[Any, "E"]  # second craft
    interval: Int[Any, "E"]  # which interval, from 0

    @property
    def craft(self) -> Int[Any, "E 2"]:
        """First and second craft."""
        return namespace(self.first).stack([self.first, self.second], axis=1)

    @property
    def sides(self) -> Sides:
        """Both sides of the separating plane of each encounter, by craft."""
        return Sides.of(self.craft)

    def relative(self, states: Float[Any, "N T 6"]) -> Float[Any, "E 2 6"]:
        """States of the first craft minus those of the second at both ends of the interval."""
        nodes = self.craft.T * states.shape[1] + self.interval  # (2, E), of all craft's nodes
        index = nodes[:, :, None] + like(np.arange(2), nodes)  # and those after them
        first, second = rows(states.reshape(-1, 6), index.reshape(-1)).reshape(2, -1, 2, 6)
        return first - second

    def approaches(
        self,
        states: Float[Any, "N T 6"],
        within: Float[Any, "E"],
        before: EncounterGeometry,
        moved: Bool[Any, "N"],
    ) -> EncounterGeometry:
        """The closest approach of each encounter; beyond ``within`` it may be left infinite.

        Pairs of which neither craft has moved keep the result ``before``.
        """
        found = [values.copy() for values in vars(before).values()]
        which = self.first, self.second, self.interval
        sizes = len(within), states.shape[1]
        KERNELS.call("nearest", *sizes, plain(states), *which, within, moved, *found)
        return EncounterGeometry(*found)


def encounters(states: Float[Array, "N T 6"], n: int) -> Encounters:
    """Pairs of craft and intervals in which they come within the distance of ``considered``."""
    N, T, _ = states.shape
    within, count, room = considered(states, n), 64 * N, 0  # a guess that few exceed
    while count > room:
        room, found = count, np.empty((count, 3), dtype=np.int64)
        count = KERNELS.call("close_pairs", N, T, n, states, within, room, found)
    return Encounters(*found[:count].T.copy())


def considered(states: Float[Any, "N T 6"], n: int) -> Float[Any, "b"]:
    """Distance in each swarm within which pairs count as encounters, r_col.

    A swarm's extent is half of the longest side of a box around it at all nodes.
    """
    xp, position = namespace(states), states[..., :3].reshape(states.shape[0] // n, -1, 3)
    extent = xp.amax(xp.amax(position, axis=1) - xp.amin(position, axis=1), axis=1) / 2
    return xp.clip(NEAR_OF_EXTENT * extent, NEAR, None)


@dataclass(frozen=True, eq=False)
class Scene:
    """Geometry of L encounters at their closest approaches, relative to the second craft."""

    interval: Int[Any, "L"]  # number of the interval, from 0
    share: Float[Any, "L"]  # time, as a share of the interval; no gradient runs through it
    ends: Float[Any, "L 2 6"]  # states relative to the second craft at both ends of the interval
    distance: Float[Any, "L"]  # between both craft
    along: Float[Any, "L 3"]  # unit vector along the gap, from the second craft: the normal
    gain: Float[Any, "L m"]  # how the craft's controls move it along the normal

    def like(self, other: Any) -> "Scene":
        """The scene as arrays of the other array's module, data type and device."""
        return Scene(*(like(values, other) for values in vars(self).values()))


def scene_of(
    interval: Int[Any, "L"], share: Float[Any, "L"], ends: Float[Any, "L 2 6"], grid: Grid
) -> Scene:
    """The geometry of encounters: distances, normals and gains."""
    distance, along = normals(ends, share)
    return Scene(interval, share, ends, distance, along, gains(interval, share, along, grid))


def normals(
    ends: Float[Any, "L 2 6"], share: Float[Any, "L"]
) -> tuple[Float[Any, "L"], Float[Any, "L 3"]]:
    """Distance and unit normal of each pair; where they touch, one normal to their motion."""
    gap = positions(ends, share)
    touching = _length(constant(gap)) < TOUCHING
    # No gradient turns the normal of craft that touch.
    along = _unit(where(touching, lambda: _across(velocities(constant(ends), share)), gap))
    return (gap * along).sum(axis=1), along


def gains(
    interval: Int[Any, "L"], share: Float[Any, "L"], along: Float[Any, "L 3"], grid: Grid
) -> Float[Any, "L m"]:
    """How the controls of the first craft move it along a normal at a share of an interval."""
    weights = _hermite(like(share, along))[:, :, None] * along[:, None]  # (L, 4, 3)
    return (weights.reshape(-1, 1, 12) @ rows(grid.ends, interval))[:, 0]


def positions(ends: Float[Any, "L 2 6"], share: Float[Any, "L"]) -> Float[Any, "L 3"]:
    """Relative positions, m, at a fraction of each interval, by cubic Hermite interpolation."""
    return _weighted(_hermite(like(share, ends)), ends)


def velocities(ends: Float[Any, "L 2 6"], share: Float[Any, "L"]) -> Float[Any, "L 3"]:
    """Relative velocities at a share of an interval."""
    s = like(share, ends)
    weights = [6 * s * (s - 1), (1 - s) * (1 - 3 * s), 6 * s * (1 - s), s * (3 * s - 2)]
    return _weighted(namespace(ends).stack(weights, axis=-1), ends)


def passing(
    ends: Float[Any, "L 2 6"], share: Float[Any, "L"], along: Float[Any, "L 3"]
) -> tuple[Float[Any, "L 3"], Float[Any, "L"]]:
    """Unit vector of the relative motion perpendicular to a normal, and the relative speed."""
    speed = velocities(ends, share)
    past = speed - (speed * along).sum(axis=1)[:, None] * along
    past = where(_length(past) < STILL, lambda: _across(along), past)
    return _unit(past), _length(speed)[:, 0]


def _hermite(s: Float[Any, "L"]) -> Float[Any, "L 4"]:
    """Hermite weights of position and velocity at one end, then at the other."""
    r = 1 - s
    weights = [r * r * (1 + 2 * s), s * r * r, s * s * (1 + 2 * r), -s * s * r]
    return namespace(s).stack(weights, axis=-1)


def _weighted(weights: Float[Any, "L 4"], ends: Float[Any, "L 2 6"]) -> Float[Any, "L 3"]:
    return namespace(ends).einsum("lk,lkx->lx", weights, ends.reshape(-1, 4, 3))


def _across(vector: Float[Any, "L 3"]) -> Float[Any, "L 3"]:
    """A vector perpendicular to each, also to a zero vector."""
    xp = namespace(vector)
    axis = rows(like(np.eye(3), vector), xp.argmin(abs(vector), axis=1))
    across = xp.linalg.cross(vector, axis)
    return xp.where(_length(across) < STILL, axis, across)


def _unit(vector: Float[Any, "L 3"]) -> Float[Any, "L 3"]:
    return vector / namespace(vector).clip(_length(vector), 1e-12, None)


def _length(vector: Float[Any, "L 3"]) -> Float[Any, "L 1"]:
    return namespace(vector).linalg.vector_norm(vector, axis=1, keepdims=True)
