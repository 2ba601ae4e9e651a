"""Half-space cuts: pairs, times and directions in which a separation is required."""

from dataclasses import dataclass, replace

import numpy as np

from pipeline.arrays import Array, Bool, Float
from pipeline.orbit.approaches import Approaches
from pipeline.orbit.arrays import Controls, Formation, Indices, Rows, States, Values, Vectors
from pipeline.orbit.corridors import Faces, Margins
from pipeline.orbit.participants import Participants
from pipeline.orbit.partition import SwarmPartition
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import transfer_maps

BEYOND = 1e7  # distance from a corridor's face to the plane from which cuts measure, m
TOUCHING = 1e-3  # distance, m, below which two positions define no direction


@dataclass(frozen=True, eq=False)
class SecondCraft(Rows):
    """Linear maps to positions of cuts' second craft, where they differ from the first's."""

    interval: Indices  # interval at whose start the craft's state is taken
    state_map: Float[Array, "k 3 6"]  # from that state to its position
    control_map: Float[Array, "k 3 3"]  # from its control in that interval to its position
    offset: Vectors  # fixed part of the first's position less that of the second's, m


@dataclass(frozen=True, eq=False)
class Cuts(Rows):
    """Pairs and times at which a separation is required."""

    first: Indices
    second: Indices
    interval: Indices  # of the time
    state_map: Float[Array, "k 3 6"]  # from a craft's state at the interval's start to its position
    control_map: Float[Array, "k 3 3"]  # from its control in the interval to its position
    beyond: Values  # required beyond the collision radius, by sizes, m
    other: SecondCraft | None = None  # of the second craft, where some maps differ

    def __add__(self, more: "Cuts") -> "Cuts":
        parts = [self, more]
        if any(cuts.other is not None for cuts in parts):
            parts = [replace(cuts, other=cuts.other or cuts.as_first) for cuts in parts]
        return Cuts.concatenated(parts)

    @property
    def as_first(self) -> SecondCraft:
        """The maps of the second craft where it flies its plan as the first does."""
        return SecondCraft(
            self.interval, self.state_map, self.control_map, np.zeros((len(self), 3))
        )

    @property
    def in_flight(self) -> Bool[Array, "k"]:
        """Mask of the cuts of two craft that both fly their plans."""
        other = self.other or self.as_first
        both = zip(vars(self.as_first).values(), vars(other).values(), strict=True)
        return ~np.any([(a != b).reshape(len(self), -1).any(axis=1) for a, b in both], axis=0)

    def of_craft(self, first: Indices, second: Indices, swarms: SwarmPartition) -> "Cuts":
        """These cuts of pairs of participants as cuts of craft alone.

        Their axes are scaled. Where the second participant is an obstacle, the cut has the first
        craft as both, so that it links no two craft.
        """
        if not isinstance(swarms, Participants):
            return self
        scale, beyond = swarms.separation_scaling(first, second)
        second_craft, obstacle = self.other or self.as_first, swarms.is_obstacle(second)
        rows, interval = second[obstacle], second_craft.interval[obstacle]
        maps = second_craft.state_map[obstacle], second_craft.control_map[obstacle]
        offset = second_craft.offset.copy()
        offset[obstacle] -= swarms.obstacle_positions(rows, interval, maps)
        axes = scale[:, :, None]
        return replace(
            self,
            second=np.where(obstacle, first, self.second),
            state_map=self.state_map * axes,
            control_map=self.control_map * axes,
            other=SecondCraft(
                interval=np.where(obstacle, 0, second_craft.interval),
                state_map=_unless(obstacle, second_craft.state_map * axes),
                control_map=_unless(obstacle, second_craft.control_map * axes),
                offset=offset * scale,
            ),
            beyond=beyond,
        )


def cuts_at(
    first: Indices, second: Indices, interval: Indices, offset: Values, problem: Problem
) -> Cuts:
    """Cuts at times since the starts of their intervals, s."""
    A, B = problem.dynamics.step(offset, interval)
    return Cuts(first, second, interval, A[:, :3], B[:, :3], np.zeros(len(first)))


def corridor_cuts(found: Margins, faces: Faces, collision_radius: float) -> Cuts:
    """Cuts that keep craft inside faces of corridors, with the margin of a separation.

    The gap of each is measured from a plane so far outside the face that it always points inward.
    """
    normal, craft = faces.normal[found.face], faces.craft[found.face]
    inward = -normal[:, :, None] * normal[:, None]
    none = np.zeros_like(craft)
    offset = normal * (faces.offset[found.face] + BEYOND)[:, None]
    return Cuts(
        first=craft,
        second=craft,
        interval=found.interval,
        state_map=inward @ found.state_map,
        control_map=inward @ found.control_map,
        other=SecondCraft(
            none, np.zeros_like(found.state_map), np.zeros_like(found.control_map), offset
        ),
        beyond=np.full(len(craft), BEYOND - collision_radius),
    )


def passive_safety_cuts(
    found: Approaches, states: States, problem: Problem, swarms: SwarmPartition
) -> Cuts:
    """Cuts at encounters of a craft that drifts since a node with another craft.

    The controls of the drifting craft act up to that node, so none if it is the first, and those
    of the other until its goal. Where no control of one acts, its position is fixed, and the cut
    has the other craft as both, so that it links no two craft. In each encounter the controls of
    at least one craft act. States are in m and m/s.
    """
    dynamics, last, node = problem.dynamics, problem.nodes - 1, found.node
    assert node is not None  # at which the first craft lost its thrust
    drifting = found.state_map @ dynamics.drift(node, found.interval)
    beyond = dynamics.drift(last, np.maximum(found.interval, last))
    obstacle = swarms.is_obstacle(found.second)
    second = np.where(obstacle, found.first, found.second)
    goal = np.matvec(found.state_map @ beyond, states[second, last])
    start = np.matvec(drifting, states[found.first, node])
    fixed, arrived = node == 0, (found.interval >= last) & ~obstacle
    cuts = Cuts(
        first=np.where(fixed, found.second, found.first),
        second=np.where(arrived, found.first, found.second),
        interval=node,
        state_map=_unless(fixed, drifting),
        control_map=np.zeros_like(found.control_map),
        beyond=np.zeros(len(node)),
        other=SecondCraft(
            interval=np.where(arrived, 0, found.interval),
            state_map=_unless(arrived, found.state_map),
            control_map=_unless(arrived, found.control_map),
            offset=_unless(~fixed, start) - _unless(~arrived, goal),
        ),
    )
    return cuts.of_craft(found.first, found.second, swarms)


def _unless(mask: Bool[Array, "k"], values: Float[Array, "k *rest"]) -> Float[Array, "k *rest"]:
    """The values, with zero where the mask is true."""
    return np.where(mask.reshape(-1, *[1] * (values.ndim - 1)), 0.0, values)


def gaps(cuts: Cuts, states: States, controls: Controls) -> Vectors:
    """Position of each cut's first craft relative to its second at the cut's time, m."""
    i, j, k = cuts.first, cuts.second, cuts.interval
    if cuts.other is not None:
        other, t = cuts.other, cuts.other.interval
        position = np.matvec(cuts.state_map, states[i, k])
        position += np.matvec(cuts.control_map, controls[i, k])
        from_other = np.matvec(other.state_map, states[j, t])
        return other.offset + position - from_other - np.matvec(other.control_map, controls[j, t])
    gap = np.matvec(cuts.state_map, states[i, k] - states[j, k])
    return gap + np.matvec(cuts.control_map, controls[i, k] - controls[j, k])


def normals(
    cuts: Cuts, states: States, controls: Controls, shift: Vectors | float = 0.0
) -> Vectors:
    """Direction n̂ of each cut; a shift of the gaps, m, makes craft pass on another side."""
    velocity = states[cuts.first, cuts.interval, 3:] - states[cuts.second, cuts.interval, 3:]
    return directions(gaps(cuts, states, controls) + shift, velocity)


def directions(gap: Vectors, velocity: Vectors) -> Vectors:
    """Unit vectors along each gap; normal to the relative velocity where the gap is about 0."""
    distance = np.linalg.norm(gap, axis=1)
    touching = distance < TOUCHING
    if touching.any():
        axis = np.eye(3)[np.abs(velocity).argmin(axis=1)]
        across = np.cross(velocity, axis)
        across = np.where(np.linalg.norm(across, axis=1, keepdims=True) > 0, across, axis)
        gap = np.where(touching[:, None], across, gap)
        distance = np.linalg.norm(gap, axis=1)
    return gap / distance[:, None]


@dataclass(frozen=True, eq=False)
class HalfSpaces(Rows):
    """Cuts with directions: row · uᵢ - other · uⱼ ≥ required bounds the separation."""

    row: Float[Array, "k m"]  # m per m/s²
    required: Values  # m
    other: Float[Array, "k m"] | None = None  # m per m/s²; None where it is ``row``


def half_spaces(
    cuts: Cuts, normal: Vectors, initial: Formation, problem: Problem, separation: Values | float
) -> HalfSpaces:
    """Linearized cuts: normal · (pᵢ - pⱼ) ≥ separation at their times (m, m/s)."""
    maps = transfer_maps(problem)

    def effect(to_state: Array, interval: Indices, control_map: Array) -> Array:
        """Effect of a craft's controls along each normal, m per m/s²."""
        row = np.vecmat(to_state, maps.reach[interval])
        columns = 3 * interval[:, None] + np.arange(3)
        row[np.arange(len(interval))[:, None], columns] += np.vecmat(normal, control_map)
        return row

    i, j, k = cuts.first, cuts.second, cuts.interval
    to_state = np.vecmat(normal, cuts.state_map)
    row = effect(to_state, k, cuts.control_map)
    if cuts.other is not None:
        second, t = cuts.other, cuts.other.interval
        to_second = np.vecmat(normal, second.state_map)
        fixed = np.vecdot(normal, second.offset)
        fixed += np.vecdot(to_state, np.matvec(maps.drift[k], initial[i]))
        fixed -= np.vecdot(to_second, np.matvec(maps.drift[t], initial[j]))
        return HalfSpaces(row, separation - fixed, effect(to_second, t, second.control_map))
    drifted = np.matvec(maps.drift[k], initial[i] - initial[j])
    return HalfSpaces(row, separation - np.vecdot(to_state, drifted))
