"""Conflict detection: where craft come closer than a plan's requirements allow.

In flight, after a loss of thrust where passive safety is required, and with a back-off for errors
(a chance constraint).
"""

from dataclasses import dataclass, replace

import numpy as np

from pipeline.arrays import Array, Bool, Float, Int
from pipeline.expert.cuts import Cuts, corridor_cuts, cuts_at, normals, passive_safety_cuts
from pipeline.orbit.approaches import PROVABLE, TOLERANCE, close_approaches
from pipeline.orbit.arrays import Controls, CraftMask, Indices, Rows, States, Values
from pipeline.orbit.corridors import margins
from pipeline.orbit.covariance import Dispersion, Uncertainty, dispersion, standard_deviation
from pipeline.orbit.drift_search import DriftingPaths
from pipeline.orbit.partition import SwarmPartition, least_of_each
from pipeline.orbit.passive_safety import loss_encounters
from pipeline.orbit.problem import Problem
from pipeline.orbit.risk import sigma_levels
from pipeline.plan.requirements import Requirements

BLOCKS = 40  # of intervals in a transfer, in each of which a pair has at most one cut
ENDS = 2 * PROVABLE  # slack of back-offs at the ends, which no control can change, m


@dataclass(frozen=True, eq=False)
class Trajectory(Rows):
    """Motion of all craft."""

    controls: Controls  # m/s²
    states: States  # node states that the controls fly, m and m/s

    def set(self, craft: Int[Array, "_"] | Bool[Array, "_"], part: "Trajectory") -> None:
        """Replace the motion of some craft, by their indices or a mask."""
        self.controls[craft], self.states[craft] = part.controls, part.states


@dataclass(frozen=True)
class BackOff:
    """Back-off of the chance constraints: standard deviations kept beyond the collision radius.

    A pair need not keep more of them than it has at its ends: in the first interval than at the
    start, in the last than at the goal.
    """

    uncertainty: Uncertainty  # 1-σ errors of navigation and of thrust execution
    sigmas: float  # how many standard deviations, along the line between the two craft
    closed_loop: bool = False  # whether deviations are corrected at each node

    def dispersion(self, controls: Controls, problem: Problem) -> Dispersion:
        """Dispersion about the plan of craft that fly some controls, m/s²."""
        return dispersion(controls, problem, self.uncertainty, self.closed_loop)

    def shortfall(
        self, flown: Trajectory, problem: Problem, asked: Requirements, swarms: SwarmPartition
    ) -> Float[Array, "S"]:
        """Largest violation, m, of collision radius and back-off by a pair of each swarm, or 0."""
        radius = problem.collision_radius
        detection = ConflictDetection(problem, asked, swarms, back_off=self)
        cuts, bound = detection.conflicts(flown, radius)
        short = np.zeros(len(swarms.sizes))
        np.maximum.at(short, swarms.label[cuts.first], np.maximum(radius - bound, TOLERANCE))
        return short


@dataclass(frozen=True, eq=False)
class ConflictDetection:
    """Conflict detection by a plan's requirements, with a margin and an optional back-off."""

    problem: Problem
    # whether separation counts at all times or at nodes, and whether after a loss of thrust
    requirements: Requirements
    swarms: SwarmPartition  # which craft belong together
    margin: float = 0.0  # asked for beyond the collision radius, m
    back_off: BackOff | None = None  # required besides, because of errors

    def conflicts(
        self, flown: Trajectory, within: float, moved: CraftMask | None = None, spread: float = 0.0
    ) -> tuple[Cuts, Values]:
        """Cuts where craft come within a distance, and lower bounds on how close they come.

        The trajectory meets both ends. The distance of interest is ``within`` and the back-off, m,
        and the lower bound that on the separation less the back-off. Only pairs with ``moved``
        craft are examined. On a grid of more than BLOCKS intervals a pair has one cut, where it
        comes closest, in a block of them. As closest approaches shift, cuts are made with a
        ``spread`` in all intervals, and that share of one before and after each as well, but not
        where separation counts at nodes only.
        """
        if moved is None:
            moved = np.ones(len(flown.states), dtype=bool)
        if self.back_off is None:
            cuts, bound = self._in_flight(flown, within, moved, spread)
        else:
            errors = self.back_off.dispersion(flown.controls, self.problem)
            deviation = 2**0.5 * float(errors.deviation_bound(self.problem).max())
            most = within + self.back_off.sigmas * deviation
            cuts, bound = self._in_flight(flown, most, moved, spread)
            bound = bound - self._chance_back_off(cuts, flown, errors)
            near = bound <= within
            cuts, bound = cuts[near], bound[near]
            if not spread:
                closest = self._closest_in_blocks(bound, cuts.first, cuts.second, cuts.interval)
                cuts, bound = cuts[closest], bound[closest]
        if (faces := self.swarms.faces) is not None:
            at = flown.states, flown.controls, self.problem, faces
            radius, inside = self.problem.collision_radius, margins(*at, moved)
            inside = inside[inside.bound + radius <= within]
            cuts += corridor_cuts(inside, faces, radius)
            bound = np.concatenate([bound, inside.bound + radius])
        orbits = self.requirements.passive_safety
        if orbits is None:
            return cuts, bound
        paths = DriftingPaths(flown.states, flown.controls, self.problem, orbits, self.swarms)
        found = loss_encounters(paths, within, moved)
        assert found.node is not None  # at which the first craft lost its thrust
        where = found.first, found.second, found.interval, found.node
        found = found[self._closest_in_blocks(found.bound, *where)]
        drifting = passive_safety_cuts(found, flown.states, self.problem, self.swarms)
        return cuts + drifting, np.concatenate([bound, found.bound])

    def back_off_of(self, cuts: Cuts, flown: Trajectory) -> Values:
        """Back-off of each cut for a trajectory's burns, m; passive-safety cuts have none.

        Without errors, the additional separation by the sizes of participants, if any.
        """
        if self.back_off is None:
            return cuts.beyond
        found, flying = np.zeros(len(cuts)), np.ones(len(cuts), dtype=bool)
        if cuts.other is not None:
            flying, cuts = cuts.in_flight, replace(cuts, other=None)
        cuts = cuts[flying]
        # The dispersions of the craft of these cuts alone, numbered anew.
        craft, place = np.unique(np.stack([cuts.first, cuts.second]), return_inverse=True)
        cuts, flown = replace(cuts, first=place[0], second=place[1]), flown[craft]
        errors = self.back_off.dispersion(flown.controls, self.problem)
        found[flying] = self._chance_back_off(cuts, flown, errors)
        return found

    def _chance_back_off(self, cuts: Cuts, flown: Trajectory, errors: Dispersion) -> Values:
        """Back-off of cuts of craft in flight, m: up to its standard deviations by errors."""
        assert self.back_off is not None
        problem, i, j, k = self.problem, cuts.first, cuts.second, cuts.interval
        normal = normals(cuts, flown.states, flown.controls)
        maps = cuts.state_map, cuts.control_map
        along = np.concatenate([np.vecmat(normal, one) for one in maps], axis=1)
        deviation = standard_deviation(along, errors.of_pairs(i, j, k))
        sigmas = np.full(len(cuts), self.back_off.sigmas)
        kept = problem.collision_radius + self.margin + ENDS
        for node, interval in ((0, 0), (problem.intervals, problem.intervals - 1)):
            at = np.flatnonzero(k == interval)
            there = sigma_levels(node, i[at], j[at], flown.states, errors, kept)
            sigmas[at] = np.clip(there, 0.0, sigmas[at])
        return sigmas * deviation

    def _in_flight(
        self, flown: Trajectory, within: float, moved: CraftMask, spread: float
    ) -> tuple[Cuts, Values]:
        """Conflicts of craft that both fly their plans."""
        problem, states, swarms = self.problem, flown.states, self.swarms
        if self.requirements.at_nodes:
            (i, j), moved = swarms.pairs, swarms.participant_mask(moved)
            touched = moved[i] | moved[j]
            i, j = i[touched], j[touched]
            positions = swarms.all_states(states)[:, :-1, :3]
            distance = swarms.separations(positions, positions, i, j)
            row, node = np.nonzero(distance <= within)
            cuts = cuts_at(i[row], j[row], node, np.zeros(len(row)), problem)
            bound, spread = distance[row, node], 0.0
        else:
            found = close_approaches(
                states, flown.controls, problem, within, swarms=swarms, moved=moved
            )
            pairs = found.first, found.second, found.interval
            maps, bound = (found.state_map, found.control_map), found.bound
            cuts = Cuts(*pairs, *maps, np.zeros(len(found)))
        if problem.intervals > BLOCKS and self.back_off is None and not spread:
            closest = self._closest_in_blocks(bound, cuts.first, cuts.second, cuts.interval)
            cuts, bound = cuts[closest], bound[closest]
        h = problem.time_step
        for way in (-spread, spread) if spread else ():
            cuts += cuts_at(*pairs, np.clip(found.offset + way * h, 0.0, h), problem)
            bound = np.concatenate([bound, found.bound])
        return cuts.of_craft(cuts.first, cuts.second, swarms), bound

    def _closest_in_blocks(self, bound: Values, *where: Indices) -> Int[Array, "_"] | slice:
        """The encounter of least bound, m, of each pair in each block of intervals.

        ``where``: indices of both craft, of the interval and, after a loss of thrust, of its node.
        """
        width = -(-self.problem.intervals // BLOCKS)
        if width == 1 or len(bound) == 0:
            return slice(None)
        keys = *where[:2], *(one // width for one in where[2:])
        label = np.ravel_multi_index(keys, [int(key.max()) + 1 for key in keys])
        return np.sort(least_of_each(bound, label)[1])
