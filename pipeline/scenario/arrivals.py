"""Where each craft must be: its goal, and the waypoints on its way, as linear equations."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pipeline.arrays import Array, Bool, Float
from pipeline.orbit.arrays import Formation, States
from pipeline.orbit.decoupled import acceleration_scale
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import state_weight, transfer_maps
from pipeline.scenario.waypoint import Waypoint


@dataclass(frozen=True, eq=False)
class Arrivals:
    """Equality constraints of each craft, reach · u = miss, on its flattened controls u; SI units.

    The first six are those of the goal; then there are six for each node with a waypoint.
    """

    reach: Float[Array, "r m"]
    miss: Float[Array, "n r"]  # what the controls of each craft must bring about, m and m/s
    wanted: Float[Array, "n r"]  # where each craft must be, m and m/s
    nodes: tuple[int, ...]  # when
    asked: Bool[Array, "n r"]  # of which craft; of others the miss is 0
    weight: Float[Array, "r"]  # by which velocities count like positions, m
    scale: Float[Array, "r"]  # to accelerations of one order, m/s²

    def __len__(self) -> int:
        return len(self.miss)

    def __getitem__(self, craft: Any) -> "Arrivals":
        """The arrivals of some craft."""
        rows = {name: getattr(self, name)[craft] for name in ("miss", "wanted", "asked")}
        return replace(self, **rows)

    def missed(self, states: States) -> Float[Array, "n r"]:
        """By how much node states are not where craft must be, m and m/s."""
        there = states[:, list(self.nodes)].reshape(len(self), -1)
        return np.where(self.asked, self.wanted - there, 0.0)

    def missed_by_drift(self, k: int) -> tuple[float, str]:
        """The largest distance, m, by which craft k without burns misses, and that in words."""
        far, fast = np.linalg.norm(self.miss[k].reshape(-1, 2, 3), axis=2).max(axis=0).tolist()
        return far, f"by drift it misses by {far:.4g} m and {fast:.4g} m/s"


def arrivals_of(
    initial: Formation,
    goal: Formation,
    problem: Problem,
    passed: Mapping[int, Sequence[tuple[int, Waypoint]]],
) -> Arrivals:
    """The equations of n craft, some of which pass waypoints at nodes."""
    maps, n = transfer_maps(problem), len(initial)
    inner = sorted({node for some in passed.values() for node, _ in some})
    nodes = [problem.intervals, *inner]
    wanted = np.zeros((n, len(nodes), 6))
    asked = np.zeros(wanted.shape, dtype=bool)
    wanted[:, 0], asked[:, 0] = goal, True
    for craft, some in passed.items():
        for node, one in some:
            row = 1 + inner.index(node)
            wanted[craft, row, :3], asked[craft, row, :3] = one.position, True
            if one.velocity is not None:
                wanted[craft, row, 3:], asked[craft, row, 3:] = one.velocity, True
    miss = np.where(asked, wanted - np.matvec(maps.drift[nodes], initial[:, None]), 0.0)
    times = len(nodes)
    return Arrivals(
        reach=maps.reach[nodes].reshape(6 * times, -1),
        miss=miss.reshape(n, -1),
        wanted=wanted.reshape(n, -1),
        nodes=tuple(nodes),
        asked=asked.reshape(n, -1),
        weight=np.tile(state_weight(problem), times),
        scale=np.tile(acceleration_scale(problem), times),
    )
