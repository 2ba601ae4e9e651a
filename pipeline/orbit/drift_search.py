"""Search for close approaches of craft adrift, by blocks of time steps that are halved."""

from collections.abc import Iterator, Sequence
from functools import lru_cache
from math import ceil

import numpy as np

from pipeline.arrays import Array, Bool, Float, Int
from pipeline.errors import InputError
from pipeline.orbit.approaches import chord_distances
from pipeline.orbit.arrays import Controls, CraftMask, Indices, States, norm
from pipeline.orbit.dynamics import Dynamics
from pipeline.orbit.linearized import LinearizedDynamics
from pipeline.orbit.partition import SwarmPartition
from pipeline.orbit.problem import Problem

# Node of loss, number of the pair, first time step, and bound on the acceleration adrift, m/s²
Near = tuple[Int[Array, "_"], Int[Array, "_"], Int[Array, "_"], Float[Array, "_"]]

AT_ONCE = 50_000  # blocks of time steps that are compared at once, which bounds memory
PARTS = 2  # into which blocks of time steps are cut
WIDEST = 0.3  # largest angle by which the reference turns in a block of several steps, rad
MOST_STEPS = 10_000_000  # time steps of a drift, whose maps take some 10 GB
NO_LENGTH = 1e-9  # share of an interval below which a remainder of a drift is rounding


class DriftingPaths:
    """Trajectories of craft and obstacles: the plan, then free drift for a number of orbits.

    InputError where the drift takes too many time steps for memory.
    """

    def __init__(
        self,
        states: States,
        controls: Controls,
        problem: Problem,
        orbits: float,
        swarms: SwarmPartition,
    ) -> None:
        self.swarms = swarms
        states, controls = swarms.all_states(states), swarms.all_controls(controls)
        h = problem.time_step
        steps = orbits * 2 * np.pi / problem.mean_motion / h
        if steps > MOST_STEPS:
            raise InputError(
                f"passive safety is asked for over {orbits:g} orbits, {steps:.3g} time steps of "
                f"{h:g} s; expected at most {MOST_STEPS:,} steps: ask for fewer orbits, or give a "
                "longer time_step."
            )
        whole = self.whole = int(steps + NO_LENGTH)  # M, whole time steps of a drift
        last = self.last = states.shape[1] - 1  # the last node of the plan
        self.problem = problem
        self.rest = max(0.0, (steps - whole) * h)  # remainder of a drift after M time steps, s
        self.steps = whole + (self.rest > NO_LENGTH * h or not whole)  # the remainder included
        width, angle = 1, problem.dynamics.fastest * h
        while width * PARTS * angle <= WIDEST and width * PARTS <= self.steps:
            width *= PARTS
        self.width = width  # time steps in a block
        self.blocks = ceil(self.steps / width) + (width > 1)  # that a drift from any node meets
        total = (last // width + self.blocks) * width
        self.dynamics = self.coarse = problem.dynamics  # of time steps and of blocks
        if problem.orbit is not None:  # all of the drift is computed at once
            self.dynamics = LinearizedDynamics(problem.orbit, h, total)
            self.coarse = LinearizedDynamics(problem.orbit, width * h, total // width)
        self.from_start, self.to_start = _drifts(self.dynamics, last, total)
        # At nodes, and at every further time step up to the last block's end, m and m/s.
        after = np.matvec(self.drift(last, np.arange(1, total - last + 1)), states[:, -1:])
        idle = np.zeros((len(states), total - last, 3))  # after the plan
        held = swarms.held
        after[held], idle[held] = states[held, -1:], controls[held, -1:]
        self.states = np.concatenate([states, after], axis=1)
        self.controls = np.concatenate([controls, idle], axis=1)
        # The states at the first node from which free drift leads to those at each node.
        self.begins = np.matvec(self.to_start, states)

    def drift(self, node: int | Indices, steps: Indices) -> Float[Array, "_ 6 6"]:
        """State transition matrices A from a node to some time steps of a drift."""
        if self.problem.orbit is None:
            return self.from_start[steps]
        return self.from_start[node + steps] @ self.to_start[node]

    def batches(self, pairs: int) -> Iterator[tuple[Int[Array, "k"], list[Int[Array, "_"]]]]:
        """Nodes of loss, and parts of pairs by number, whose blocks are compared at once."""
        each = max(1, pairs * self.blocks)
        parts = np.array_split(np.arange(pairs), 1 + each // AT_ONCE)
        few = max(1, AT_ONCE // each)
        for node in range(0, self.last + 1, few):
            yield np.arange(node, min(node + few, self.last + 1)), parts


@lru_cache(maxsize=8)
def _drifts(
    dynamics: Dynamics, last: int, steps: int
) -> tuple[Float[Array, "_ 6 6"], Float[Array, "nodes 6 6"]]:
    """State transition matrices from the first node to time steps, and from nodes back to it."""
    drift = dynamics.drift
    return drift(0, np.arange(steps + 1)), drift(np.arange(last + 1), 0)


class BlockSearch:
    """Broad phase of the search for close approaches after a loss of thrust.

    It finds drifting craft, nodes, other craft and intervals that may be within a distance. Over a
    block of time steps both craft stay near their chords, by which most blocks are left out at
    once. The others are cut into parts, down to single steps.
    """

    def __init__(
        self, paths: DriftingPaths, reach: Float[Array, "craft"], moved: CraftMask | None
    ) -> None:
        self.paths, self.reach, self.moved = paths, reach, moved
        lost, met = paths.swarms.loss_pairs
        if moved is not None:
            affected = moved[lost] | moved[met]
            lost, met = lost[affected], met[affected]
        self.lost, self.met = lost, met
        self.scale, beyond = paths.swarms.separation_scaling(lost, met)
        self.within = reach[lost] + beyond
        h, each = paths.problem.time_step, np.arange(paths.controls.shape[1])
        most = paths.dynamics.acceleration_bound(paths.states[:, :-1], paths.controls, h, each)
        self.sag = most * h**2 / 8

    def candidates(self) -> Iterator[tuple[Array, ...]]:
        """Drifting craft, node, other craft and interval of pairs that may be near, in batches."""
        widths = [self.paths.width]
        while widths[-1] > 1:
            widths.append(widths[-1] // PARTS)
        bends = [self._bends(width) for width in widths]
        for batch in self.paths.batches(len(self.lost)):
            for near in self._blocks(*batch, bends[0]):
                for width, bend in zip(widths[1:], bends[1:], strict=True):
                    near = self._parts(near, width, bend)
                node, pair, interval, _ = near
                yield self.lost[pair], node, self.met[pair], interval

    def _bends(self, width: int) -> Float[Array, "n blocks"]:
        """Bound on the deviation of flown paths from their chords over blocks, m."""
        position = self.paths.states[..., :3]
        begin, end = position[:, :-1:width, None], position[:, width::width, None]
        chord = begin + np.arange(width)[:, None] / width * (end - begin)
        off = norm(position[:, :-1].reshape(chord.shape) - chord)
        return np.asarray(off.max(axis=-1) + self.sag.reshape(off.shape).max(axis=-1))

    def _blocks(
        self,
        nodes: Int[Array, "k"],
        parts: Sequence[Int[Array, "_"]],
        bends: Float[Array, "n blocks"],
    ) -> Iterator[Near]:
        """The widest blocks in which bounding balls of two craft are near, by parts of pairs."""
        paths, width = self.paths, self.paths.width
        length = width * paths.problem.time_step
        ends = nodes[:, None] // width * width + width * np.arange(paths.blocks + 1)
        begin, block = ends[:, :-1], ends[:, :-1] // width
        adrift = np.matvec(paths.from_start[ends], paths.begins[:, nodes, None])
        start = adrift[:, :, :-1]
        idle = np.zeros_like(start[..., :3])
        most = paths.coarse.acceleration_bound(start, idle, length, block)
        centre, size = _block_balls(adrift, length**2 / 8 * most)
        middle, radius = _block_balls(paths.states[:, ends], bends[:, block])
        size[: len(self.reach)] += self.reach[:, None]
        for part in parts:
            lost, met = self.lost[part], self.met[part]
            separation = paths.swarms.separations(centre, middle, lost, met)
            near = separation <= size.take(lost, 0) + radius.take(met, 0)
            near = near.reshape(len(part), *begin.shape).swapaxes(0, 1)
            near &= self._wanted(nodes[:, None, None], part[:, None], begin[:, None], width)
            node, pair, at = near.nonzero()
            yield nodes[node], part[pair], begin[node, at], most[lost[pair], node, at]

    def _parts(self, near: Near, width: int, bends: Float[Array, "n blocks"]) -> Near:
        """The parts of blocks in which two craft's relative chord is near the origin."""
        paths, (node, pair, begin, most) = self.paths, near
        lost, met = self.lost[pair], self.met[pair, None]
        ends = begin[:, None] + width * np.arange(PARTS + 1)
        drifting = np.matvec(paths.from_start[ends, :3], paths.begins[lost, node, None])
        gap = np.moveaxis(drifting - paths.states[met, ends, :3], -1, 0)
        if self.scale is not None:
            gap = gap * self.scale[pair].T[:, :, None]
        half, parts = (gap[..., 1:] - gap[..., :-1]) / 2, ends[:, :-1]
        sag = (width * paths.problem.time_step) ** 2 / 8 * most[:, None]
        within = self.within[pair, None] + sag + bends[met, parts // width]
        close = chord_distances(gap[..., :-1] + half, half) <= within
        close &= self._wanted(node[:, None], pair[:, None], parts, width)
        row, step = close.nonzero()
        return node[row], pair[row], parts[row, step], most[row]

    def _wanted(self, node: Array, pair: Array, begin: Array, width: int) -> Bool[Array, "*some"]:
        """Whether blocks are part of a drift, and controls of moved craft affect them."""
        inside = (begin + width > node) & (begin < node + self.paths.steps)
        if self.moved is None:
            return inside
        # Drifts from the first and the last node are fixed, and so are those from goals.
        last = self.paths.last
        affected = self.moved[self.lost[pair]] & (node > 0) & (node < last)
        return inside & (affected | (self.moved[self.met[pair]] & (begin < last)))


def _block_balls(
    states: Float[Array, "n k ends 6"], sag: Float[Array, "n k blocks"]
) -> tuple[Float[Array, "n times 3"], Float[Array, "n times"]]:
    """Bounding ball of each craft's path in each block of time steps: centre and radius, m.

    About the middle of its chord, from which it strays up to ``sag``, m.
    """
    begin, end = states[:, :, :-1, :3], states[:, :, 1:, :3]
    centre, size = (begin + end) / 2, norm(end - begin) / 2 + sag
    return centre.reshape(len(size), -1, 3), size.reshape(len(size), -1)
