"""Passive safety: closest approaches of a craft that has lost its thrust at a node.

One craft drifts from that node on; the others fly their plan to its end and then drift from their
goals. All of this is linear motion under controls that are constant over intervals, so the search
with proven bounds is the same as for craft in flight.

Initial and goal states alone may prove that no plan is passively safe: whatever the plan is, a
craft that loses its thrust at the first node drifts from its start, and after the last node all
other craft drift from their goals. The motion of obstacles is known.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from pipeline.arrays import Array, Bool, Float
from pipeline.orbit.approaches import Approaches, approaches_of_motions, close_approaches
from pipeline.orbit.arrays import Controls, CraftMask, Formation, States, Values
from pipeline.orbit.drift_search import BlockSearch, DriftingPaths
from pipeline.orbit.participants import Obstacle, Participants, at_the_end
from pipeline.orbit.partition import SwarmPartition
from pipeline.orbit.problem import RANGES, Problem
from pipeline.orbit.separation import ROUNDING, Separation, closest_sampled, with_closer
from pipeline.orbit.transfer import free_drift

# Drift in s below which nothing is proven by the ends alone; plans are still checked over it
SHORTEST = 2 * RANGES["time_step"][0]


def loss_encounters(
    paths: DriftingPaths,
    within: float | Float[Array, "swarms"],
    moved: CraftMask | None = None,
) -> Approaches:
    """All encounters within a distance, m, of craft adrift from a node with others.

    The distance is one for all swarms or one for each. Encounters that no controls of ``moved``
    craft affect are skipped.
    """
    swarms = paths.swarms
    reach = swarms.per_craft(within)
    moved = None if moved is None else swarms.participant_mask(moved)
    none = (np.zeros(0, dtype=int),) * 4
    near = BlockSearch(paths, reach, moved).candidates()
    lost, node, other, interval = map(np.concatenate, zip(none, *near, strict=True))
    if moved is not None:  # in the order in which further starts take their random shifts
        order = np.lexsort((interval >= paths.last, node))
        lost, node, other, interval = (one[order] for one in (lost, node, other, interval))
    cut, found = interval - node == paths.whole, []
    for length, which in ((paths.problem.time_step, ~cut), (paths.rest, cut)):
        where = lost[which], node[which], other[which], interval[which]
        found.append(_closest(paths, length, reach, where))
    return Approaches.concatenated(found)


def least_after_loss(
    states: States, controls: Controls, problem: Problem, orbits: float, swarms: SwarmPartition
) -> list[Separation]:
    """The least separation between a craft after loss of thrust and any other, in each swarm."""
    paths = DriftingPaths(states, controls, problem, orbits, swarms)
    search = partial(loss_encounters, paths)
    return with_closer(_closest_sampled(paths), search, problem, swarms)


def _closest(
    paths: DriftingPaths, length: float, reach: Values, which: Iterable[Array]
) -> Approaches:
    """The encounters among candidates."""
    lost, node, other, interval = which
    dynamics, held = paths.dynamics, paths.controls[other, interval]
    drifting = np.matvec(paths.drift(node, interval - node), paths.states[lost, node])
    start = drifting - paths.states[other, interval]
    motions, who = np.concatenate([start, -held], axis=1), (lost, other, interval, node)
    return approaches_of_motions(motions, who, reach, paths.swarms, dynamics, length)


def _closest_sampled(paths: DriftingPaths) -> list[Separation]:
    """Least separation after a loss of thrust at the first time of each block of time steps.

    The bound is lower by the rounding error.
    """
    swarms = paths.swarms
    closest = [Separation()] * len(swarms.sizes)
    lost, met = swarms.loss_pairs
    since, step = np.arange(0, paths.whole + 1, paths.width), paths.problem.time_step
    slack = ROUNDING * float(np.abs(paths.states[..., :3]).max())
    for nodes, parts in paths.batches(len(lost)):
        at = nodes[:, None] + since
        start = paths.begins[:, nodes, None]
        drifting = np.matvec(paths.from_start[at, :3], start).reshape(len(start), -1, 3)
        others = paths.states[:, at.ravel(), :3]
        for i, j in ((lost[part], met[part]) for part in parts):
            separation = swarms.separations(drifting, others, i, j)
            for swarm, distance, k, pair in closest_sampled(separation, i, j, swarms):
                if not closest[swarm].distance <= distance:
                    time, node = float(at.ravel()[k]) * step, int(nodes[k // len(since)])
                    closest[swarm] = Separation(distance, distance - slack, pair, time, node)
    return closest


@dataclass(frozen=True, eq=False)
class Ends:
    """Initial and goal states, and how many orbits craft drift after a loss of thrust.

    Radii of craft are in m; obstacles need them, and are numbered after the craft.
    """

    initial: Formation
    goal: Formation
    problem: Problem
    orbits: float
    radii: Values | None = None
    obstacles: Sequence[Obstacle] = ()

    def encounters(self) -> Iterator[Separation]:
        """Encounters of drifts from goals, and of those from starts with obstacles."""
        problem, there = self.problem, at_the_end(self.obstacles, self.problem)
        yield from self._adrift(self.goal, problem.nodes - 1, problem.duration, there)
        if self.obstacles:
            before = self._adrift(self.initial, 0, 0.0, self.obstacles)
            yield from (one for one in before if one.pair and one.pair[1] >= len(self.goal))

    def starts_with_goals(self) -> Iterator[tuple[int, int, Separation]]:
        """Encounters after the plan of craft adrift from starts with others adrift from goals."""
        n, problem = len(self.goal), self.problem
        A = problem.dynamics.drift(0, problem.intervals)
        both = np.concatenate([self.initial @ A.T, self.goal])  # where they are when the plan ends
        longer = self.orbits - problem.duration * problem.mean_motion / (2 * np.pi)
        radii = None if self.radii is None else np.tile(self.radii, 2)
        after = replace(self, orbits=longer, radii=radii)
        for one in after._adrift(both, 0, problem.duration):
            if one.pair and one.pair[0] < n <= one.pair[1]:
                craft, taken = one.pair[0], one.pair[1] - n
                yield craft, taken, replace(one, pair=(craft, taken))

    def _adrift(
        self, states: Formation, node: int, begin: float, obstacles: Sequence[Obstacle] = ()
    ) -> Iterator[Separation]:
        """Encounters within the collision radius in free drift from a time, s, after a node."""
        problem, radius = self.problem, self.problem.collision_radius
        if self.orbits * 2 * np.pi / problem.mean_motion < SHORTEST:
            return
        flown, idle, drift = free_drift(states, problem, self.orbits, begin)
        drift = replace(drift, collision_radius=radius)
        swarms = None if self.radii is None else Participants(drift, [self.radii], [obstacles])
        found = close_approaches(flown, idle, drift, radius, swarms=swarms)
        time = begin + found.times(drift)
        for k in np.flatnonzero(found.distance <= radius).tolist():
            pair, distance = (int(found.first[k]), int(found.second[k])), float(found.distance[k])
            yield Separation(distance, float(found.bound[k]), pair, float(time[k]), node)


def unavoidable_encounter(ends: Ends) -> Separation | None:
    """The closest encounter within the required separation that no plan can avoid, or None."""
    found = list(ends.encounters())
    found += [one for craft, taken, one in ends.starts_with_goals() if craft != taken]  # its own
    return min(found, key=lambda one: one.distance, default=None)


def allowed_goals(ends: Ends) -> Bool[Array, "n n"]:
    """Mask of the goals that each craft may take, where goals are not assigned yet.

    A craft whose drift from its start meets a craft that drifts from some goal must take that goal
    itself. None may take any where drifts from two goals meet, or an obstacle is in the way of a
    drift from either end. All of this holds for craft of the least of the radii.
    """
    n = len(ends.goal)
    if ends.radii is not None:
        ends = replace(ends, radii=np.full(n, ends.radii.min()))
    allowed = np.ones((n, n), dtype=bool)
    if list(ends.encounters()):
        return ~allowed
    for craft, taken, _ in ends.starts_with_goals():
        allowed[craft] &= np.arange(n) == taken
    return allowed
