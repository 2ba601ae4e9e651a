"""Where craft meet and the planes that keep them apart, in the units that make swarms alike.

Relative motion is linear and fuel is a norm, so a swarm twice as large with twice the collision
radius has the same transfers at twice the fuel. In units of r_col and Δt nothing is left of that:
positions are in r_col, velocities in r_col/Δt, controls in r_col/Δt².

Within an interval the relative position of two craft is, to some millimetres, the cubic that has
the positions and velocities of both ends. So the plane that stands across the gap at the closest
approach is linear in the states of the interval's two nodes, by the weights of Hermite.
"""

import sys
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.arrays import Array
from pipeline.networks.refiner.arrays import constant, like, namespace, plain, rows, where
from pipeline.networks.refiner.nearest import close_pairs, nearest
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import transfer_maps

# Distance within which decoupled optima must come for a pair to be looked at at all: in r_col, and
# as a share of the swarm's extent, since who flies far can be sent far off at little cost
NEAR, NEAR_OF_EXTENT = 4.0, 0.15

TOUCHING = 1e-4  # distance in r_col under which the gap of two craft gives no direction
STILL = 1e-9  # relative speed in r_col/Δt under which two craft do not move past each other


@dataclass(frozen=True, eq=False)
class Grid:
    """The constant maps of a problem, scaled: all node states are drift · s₁ + reach · u."""

    nodes: int  # T
    step: float  # Δt, s
    drift: Float[Any, "_ 6"]  # effect of the initial state on the states of all nodes
    reach: Float[Any, "_ m"]  # effect of the m = 3(T-1) controls on them
    free: Float[Any, "m m"]  # takes from controls the part that changes the final state; symmetric
    ends: Float[Any, "intervals 12 m"]  # rows of ``reach`` for both ends of each interval

    def fly(self, initial: Float[Any, "N 6"], controls: Float[Any, "N m"]) -> Float[Any, "N T 6"]:
        """Node states, by Eq. 2."""
        return (initial @ self.drift.T + controls @ self.reach.T).reshape(-1, self.nodes, 6)


@lru_cache(maxsize=32)
def grid_of(problem: Problem, device: Any = None) -> Grid:
    """The grid of a problem, whose collision radius has no part in it; on a device, as tensors."""
    if device is not None:
        grid, torch = grid_of(problem), sys.modules["torch"]
        with torch.inference_mode(False):  # what is kept must serve training too
            parts = (grid.drift, grid.reach, grid.free, grid.ends)
            return Grid(grid.nodes, grid.step, *(torch.from_numpy(x).to(device) for x in parts))
    maps, step, scale = transfer_maps(problem), problem.time_step, _per_step(problem)
    drift = (maps.drift * scale[:, None] / scale).reshape(-1, 6)
    reach = (maps.reach * scale[:, None] / step**2).reshape(len(drift), -1)
    free = np.eye(reach.shape[1]) - np.linalg.pinv(reach[-6:]) @ reach[-6:]
    ends = np.stack([reach[6 * t : 6 * t + 12] for t in range(problem.intervals)])
    return Grid(problem.nodes, step, drift, reach, free, ends)


def in_units(
    states: Float[Any, "b n 6"], radius: Float[Any, "b"], problem: Problem
) -> Float[Any, "N 6"]:
    """States of all craft, one swarm's after the other's, scaled from m and m/s."""
    scale = like(_per_step(problem), states)
    return (states * scale / radius[:, None, None]).reshape(-1, 6)


def _per_step(problem: Problem) -> Float[Array, "6"]:
    """What turns m and m/s into lengths."""
    return np.repeat([1.0, problem.time_step], 3)


@dataclass(frozen=True, eq=False)
class Encounters:
    """Pairs of craft in intervals, each an edge of the encounter graph."""

    first: Int[Array, "E"]  # first craft
    second: Int[Array, "E"]  # second craft
    interval: Int[Array, "E"]  # which interval, from 0

    def of(self, which: Int[Array, "L"]) -> "Encounters":
        """Some of them."""
        return Encounters(self.first[which], self.second[which], self.interval[which])

    @property
    def craft(self) -> Int[Array, "E 2"]:
        """First and second craft."""
        return np.stack([self.first, self.second], axis=1)

    def relative(self, states: Float[Any, "N T 6"]) -> Float[Any, "E 2 6"]:
        """States of the first craft less those of the second at both ends of the interval."""
        nodes = self.craft.T * states.shape[1] + self.interval  # (2, E), of all craft's nodes
        index = nodes[:, :, None] + np.arange(2)  # and those after them
        one, other = rows(states.reshape(-1, 6), index.reshape(-1)).reshape(2, -1, 2, 6)
        return one - other


@dataclass(frozen=True, eq=False)
class EncounterGeometry:
    """The closest approach of each encounter, through which no gradient runs."""

    share: Float[Array, "E"]  # when, as a share of the interval; 0 where it was not looked at
    distance: Float[Array, "E"]  # r_col; infinite where it was not looked at
    turns: Bool[Array, "E"]  # whether the pair comes closer before and parts after it


def encounters(
    states: Float[Array, "N T 6"], n: int, near: float = NEAR, of_extent: float = NEAR_OF_EXTENT
) -> Encounters:
    """Pairs of a swarm and intervals within ``near`` r_col, or a share of its extent."""
    within = np.maximum(near, of_extent * extents(states, n))
    return Encounters(*close_pairs(np.ascontiguousarray(states), n, within))


def extents(states: Float[Any, "N T 6"], n: int) -> Float[Any, "b"]:
    """Half of the longest side of a box around each swarm at all nodes, r_col."""
    xp, position = namespace(states), states[..., :3].reshape(states.shape[0] // n, -1, 3)
    return xp.amax(xp.amax(position, axis=1) - xp.amin(position, axis=1), axis=1) / 2


def approaches(
    met: Encounters,
    states: Float[Any, "N T 6"],
    within: Float[Array, "E"] | None = None,
    before: EncounterGeometry | None = None,
    moved: Bool[Array, "N"] | None = None,
) -> EncounterGeometry:
    """The closest approach of each encounter; beyond a distance it may be left infinite.

    Pairs of which neither craft has moved keep what was found before; by default all have.
    """
    E = len(met.first)
    share, distance, turns = np.empty(E), np.empty(E), np.empty(E, dtype=bool)
    if before is not None:
        share, distance, turns = before.share.copy(), before.distance.copy(), before.turns.copy()
    within = np.full(E, np.inf) if within is None else within
    moved = np.ones(len(states), dtype=bool) if moved is None else moved
    pairs = (met.first, met.second, met.interval)
    nearest(plain(states), *pairs, within, moved, share, distance, turns)
    return EncounterGeometry(share, distance, turns)


@dataclass(frozen=True, eq=False)
class Scene:
    """L encounters at a share of their intervals, as the first craft of each sees them."""

    interval: Int[Any, "L"]  # which it is, from 0
    share: Float[Any, "L"]  # when, through which no gradient runs
    ends: Float[Any, "L 2 6"]  # states relative to the second craft at both ends of the interval
    distance: Float[Any, "L"]  # to it
    along: Float[Any, "L 3"]  # unit vector along the gap, from the second craft: the normal
    gain: Float[Any, "L m"]  # how the craft's controls move it along the normal

    @property
    def plain(self) -> "Scene":
        """The same as arrays."""
        return Scene(*map(plain, vars(self).values()))


def scene_of(
    interval: Int[Any, "L"], share: Float[Any, "L"], ends: Float[Any, "L 2 6"], grid: Grid
) -> Scene:
    """The encounters with distances, normals and gains."""
    distance, along = normals(ends, share)
    return Scene(interval, share, ends, distance, along, gains(interval, share, along, grid))


def normals(
    ends: Float[Any, "L 2 6"], share: Float[Any, "L"]
) -> tuple[Float[Any, "L"], Float[Any, "L 3"]]:
    """Distance between the craft of each pair at a share of an interval, and the unit vector along.

    Where two craft touch, that is any across their motion, and gradients do not turn it.
    """
    gap = positions(ends, share)
    touching = _length(constant(gap)) < TOUCHING
    along = _unit(where(touching, lambda: _across(velocities(constant(ends), share)), gap))
    return (gap * along).sum(axis=1), along


def gains(
    interval: Int[Any, "L"], share: Float[Any, "L"], along: Float[Any, "L 3"], grid: Grid
) -> Float[Any, "L m"]:
    """How the controls of the first craft move it along a normal at a share of an interval."""
    weights = _hermite(like(share, along))[:, :, None] * along[:, None]  # (L, 4, 3)
    return (weights.reshape(-1, 1, 12) @ rows(grid.ends, interval))[:, 0]


def positions(ends: Float[Any, "L 2 6"], share: Float[Any, "*k L"]) -> Float[Any, "*k L 3"]:
    """Relative positions at shares of an interval."""
    return _weighted(_hermite(like(share, ends)), ends)


def velocities(ends: Float[Any, "L 2 6"], share: Float[Any, "L"]) -> Float[Any, "L 3"]:
    """Relative velocities at a share of an interval."""
    s = like(share, ends)
    weights = [6 * s * (s - 1), (1 - s) * (1 - 3 * s), 6 * s * (1 - s), s * (3 * s - 2)]
    return _weighted(namespace(ends).stack(weights, axis=-1), ends)


def accelerations(ends: Float[Any, "L 2 6"], share: Float[Any, "L"]) -> Float[Any, "L 3"]:
    """Relative accelerations at a share of an interval."""
    s = like(share, ends)
    weights = [12 * s - 6, 6 * s - 4, 6 - 12 * s, 6 * s - 2]
    return _weighted(namespace(ends).stack(weights, axis=-1), ends)


def passing(
    ends: Float[Any, "L 2 6"], share: Float[Any, "L"], along: Float[Any, "L 3"]
) -> tuple[Float[Any, "L 3"], Float[Any, "L"]]:
    """Unit vector of the motion past each other, at right angles to a normal, and the speed."""
    speed = velocities(ends, share)
    past = speed - (speed * along).sum(axis=1)[:, None] * along
    past = where(_length(past) < STILL, lambda: _across(along), past)
    return _unit(past), _length(speed)[:, 0]


def _hermite(s: Float[Any, "*k L"]) -> Float[Any, "*k L 4"]:
    """Hermite weights of position and velocity at one end, then at the other."""
    r = 1 - s
    weights = [r * r * (1 + 2 * s), s * r * r, s * s * (1 + 2 * r), -s * s * r]
    return namespace(s).stack(weights, axis=-1)


def _weighted(weights: Float[Any, "*k L 4"], ends: Float[Any, "L 2 6"]) -> Float[Any, "*k L 3"]:
    each = "lk,lkx->lx" if weights.ndim == 2 else "tlk,lkx->tlx"
    return namespace(ends).einsum(each, weights, ends.reshape(-1, 4, 3))


def _across(vector: Float[Any, "L 3"]) -> Float[Any, "L 3"]:
    """Some vector at right angles to each, also to none."""
    xp = namespace(vector)
    axis = rows(like(np.eye(3), vector), xp.argmin(abs(vector), axis=1))
    across = xp.linalg.cross(vector, axis)
    return xp.where(_length(across) < STILL, axis, across)


def _unit(vector: Float[Any, "L 3"]) -> Float[Any, "L 3"]:
    return vector / namespace(vector).clip(_length(vector), 1e-12, None)


def _length(vector: Float[Any, "L 3"]) -> Float[Any, "L 1"]:
    return namespace(vector).linalg.vector_norm(vector, axis=1, keepdims=True)
