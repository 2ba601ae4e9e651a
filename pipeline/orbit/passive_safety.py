"""Passive safety: closest approaches of a craft that has lost its thrust at a node.

One craft drifts on from that node; the others fly their plan to its end and then drift on from
their goals. All of it is linear motion under controls that are constant over intervals, so the
search is that of craft in flight, with proven bounds.
"""

from collections.abc import Iterable, Iterator
from functools import lru_cache

import numpy as np

from pipeline.arrays import Array, Float, Int
from pipeline.orbit.approaches import (
    Approaches,
    Motions,
    SwarmPartition,
    balls,
    closest_to_origin,
    side_by_side,
)
from pipeline.orbit.arrays import Controls, Indices, Marked, States, Values, mapped
from pipeline.orbit.problem import Problem
from pipeline.orbit.separation import ROUNDING, Separation, closer, closest_sampled, distances_of

AT_ONCE = 1_000_000  # pairs and intervals that are compared at once, which bounds memory
NO_LENGTH = 1e-9  # a rest of an interval below this share of it is rounding


def loss_encounters(
    states: States,
    controls: Controls,
    problem: Problem,
    orbits: float,
    within: float | Float[Array, "swarms"],
    *,
    swarms: SwarmPartition | None = None,
    moved: Marked | None = None,
) -> Approaches:
    """All encounters of craft adrift from a node with others ``within`` a distance, m.

    The distance is of all swarms or of each; by default there is one. A drift takes so many orbits.
    Encounters that do not depend on the controls of ``moved`` craft are skipped.
    """
    swarms = swarms or side_by_side((len(states),))
    reach = swarms.each(within)
    paths = _Paths(swarms.beside(states), swarms.pushed(controls), problem, orbits, swarms)
    moved = None if moved is None else swarms.marked(moved)
    found = []
    for length, since in paths.pieces:
        none = (np.zeros(0, dtype=int),) * 4
        near = _candidates(paths, length, since, reach, swarms, moved)
        which = map(np.concatenate, zip(none, *near, strict=True))
        found.append(_closest(paths, length, reach, which, swarms))
    return Approaches.concatenated(found)


def least_after_loss(
    states: States, controls: Controls, problem: Problem, orbits: float, swarms: SwarmPartition
) -> list[Separation]:
    """The least distance of a drifting craft to another in each swarm, as ``least_separations``."""
    paths = _Paths(swarms.beside(states), swarms.pushed(controls), problem, orbits, swarms)
    least = _closest_at_steps(paths, swarms)
    found = loss_encounters(states, controls, problem, orbits, distances_of(least), swarms=swarms)
    return closer(least, found, problem, swarms)


class _Paths:
    """A plan flown to its end, with the drift from the goals that follows, of so many orbits."""

    def __init__(
        self,
        states: States,
        controls: Controls,
        problem: Problem,
        orbits: float,
        swarms: SwarmPartition,
    ) -> None:
        h = problem.time_step
        steps = orbits * 2 * np.pi / problem.mean_motion / h
        whole = self.whole = int(steps + NO_LENGTH)  # M, time steps of a drift
        self.problem, self.last = problem, states.shape[1] - 1  # the last node of the plan
        self.rest = max(0.0, (steps - whole) * h)  # what is left of a drift after M time steps, s
        # At nodes, and at every further time step of the drift, (n, T + M, 6), m and m/s.
        after = np.matvec(self.drift(self.last)[1:], states[:, -1:])
        idle = np.zeros((len(states), whole + 1, 3))  # after the plan
        held = swarms.held
        after[held], idle[held] = states[held, -1:], controls[held, -1:]
        self.states = np.concatenate([states, after], axis=1)
        self.controls = np.concatenate([controls, idle], axis=1)

    def drift(self, node: int | Indices, steps: Indices | None = None) -> Float[Array, "_ 6 6"]:
        """A from a node to each time step of a drift from there, of M; or to some."""
        table = _drifts(self.problem, self.whole)
        begin = node if len(table) > 1 else 0
        return table[begin] if steps is None else table[begin, steps]

    @property
    def pieces(self) -> Iterator[tuple[float, Int[Array, "steps"]]]:
        """Intervals of one length, s, and how many time steps after the loss they begin."""
        if self.whole:
            yield self.problem.time_step, np.arange(self.whole)
        if self.rest > NO_LENGTH * self.problem.time_step or not self.whole:
            yield self.rest, np.array([self.whole])


@lru_cache(maxsize=8)
def _drifts(problem: Problem, whole: int) -> Float[Array, "_ _ 6 6"]:
    """A from each node to each time step of a drift; about a circle, of one node for all."""
    nodes = np.arange(1 if problem.orbit is None else problem.nodes)[:, None]
    return problem.dynamics.drift(nodes, nodes + np.arange(whole + 1))


def _candidates(
    paths: _Paths,
    length: float,
    since: Int[Array, "steps"],
    reach: Float[Array, "craft"],
    swarms: SwarmPartition,
    moved: Marked | None,
) -> Iterator[tuple[Array, ...]]:
    """Drifting craft, node, other craft and interval whose balls are within a distance."""
    dynamics = paths.problem.dynamics

    def around(start: States, controls: Controls, interval: Indices) -> tuple[Array, Array]:
        A, B = (one[..., :3, :] for one in dynamics.step(length, interval))
        end = mapped(A, start) + mapped(B, controls)
        return balls(start, end, controls, dynamics, length, interval)

    middle, radius = around(paths.states, paths.controls, np.arange(paths.states.shape[1]))
    for node in range(paths.last + 1):
        drifting = np.matvec(paths.drift(node)[since], paths.states[:, node, None])
        centre, size = around(drifting, np.zeros((*drifting.shape[:2], 3)), node + since)
        for i, j, steps in _searched(node, paths.last, since, swarms, moved):
            at = slice(node + since[steps.start], node + since[steps.stop - 1] + 1)
            apart = swarms.apart(centre[:, steps], middle[:, at], i, j)
            pair, step = np.nonzero(apart <= size[i, steps] + radius[j, at] + reach[i, None])
            yield i[pair], np.full(len(pair), node), j[pair], at.start + step


def _searched(
    node: int, last: int, since: Int[Array, "steps"], swarms: SwarmPartition, moved: Marked | None
) -> Iterator[tuple[Int[Array, "p"], Int[Array, "p"], slice]]:
    """Pairs of a drifting craft and another, and steps of a drift from a node, in portions.

    All of them, or those that depend on the controls of ``moved`` craft.
    """
    one, other = swarms.pairs
    back = ~swarms.still(other)  # no obstacle loses its thrust
    lost, met = np.concatenate([one, other[back]]), np.concatenate([other, one[back]])
    count = len(since)
    if moved is None:
        windows = [(np.ones(len(lost), dtype=bool), 0, count)]
    else:  # from the first node and the last a drift is fixed, and so is one from a goal
        flying = int(np.clip(last - node - since[0], 0, count))
        lost_moved = moved[lost] & (0 < node < last)
        windows = [(lost_moved | moved[met], 0, flying), (lost_moved, flying, count)]
    for wanted, begin, end in windows:
        chosen = np.flatnonzero(wanted)
        if begin == end or len(chosen) == 0:
            continue
        for part in np.array_split(chosen, 1 + len(chosen) * (end - begin) // AT_ONCE):
            yield lost[part], met[part], slice(begin, end)


def _closest(
    paths: _Paths, length: float, reach: Values, which: Iterable[Array], swarms: SwarmPartition
) -> Approaches:
    """The encounters among candidates."""
    lost, node, other, interval = which
    dynamics, held = paths.problem.dynamics, paths.controls[other, interval]
    drifting = np.matvec(paths.drift(node, interval - node), paths.states[lost, node])
    start = drifting - paths.states[other, interval]
    A, B = dynamics.step(length, interval)
    end, since = np.matvec(A, start) - np.matvec(B, held), np.zeros(len(start))
    scale, beyond = swarms.asked(lost, other)
    flown = np.concatenate([end, start, -held], axis=1)
    motions = Motions(flown, reach[lost] + beyond, interval, since, scale)
    near, found = closest_to_origin(motions, dynamics, length)
    return Approaches(
        **vars(found.less(beyond, near)),
        first=lost[near],
        second=other[near],
        interval=interval[near],
        node=node[near],
    )


def _closest_at_steps(paths: _Paths, swarms: SwarmPartition) -> list[Separation]:
    """The least separation after a loss at any time step; its bound allows for rounding."""
    closest = [Separation()] * len(swarms.sizes)
    since, step = np.arange(paths.whole + 1), paths.problem.time_step
    slack = ROUNDING * float(np.abs(paths.states[..., :3]).max())
    for node in range(paths.last + 1):
        drifting = np.matvec(paths.drift(node), paths.states[:, node, None])[..., :3]
        for i, j, _ in _searched(node, paths.last, since, swarms, None):
            others = paths.states[:, node : node + len(since), :3]
            apart = swarms.apart(drifting, others, i, j)
            for swarm, distance, at, pair in closest_sampled(apart, i, j, swarms):
                if not closest[swarm].distance <= distance:
                    time = float(node + at) * step
                    closest[swarm] = Separation(distance, distance - slack, pair, time, node)
    return closest
