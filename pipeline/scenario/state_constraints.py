"""Goals and waypoints of each craft, as linear equality constraints on its controls."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pipeline.arrays import Array, Bool, Float
from pipeline.orbit.arrays import Formation, States
from pipeline.orbit.decoupled import MISSED, acceleration_scale
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import state_weight, transfer_maps
from pipeline.scenario.scenario import Scenario
from pipeline.scenario.waypoint import Waypoint, of_craft

MET = 1e-9  # error of a state that counts as zero, m; velocities over e
NO_EFFECT = 1e-14  # share of the largest effect of a control below which one is rounding


@dataclass(frozen=True, eq=False)
class StateConstraints:
    """Equality constraints of each craft, reach · u = miss, on its flattened controls u; SI units.

    The first six are those of the goal; then there are six for each node with a waypoint.
    """

    reach: Float[Array, "r m"]
    miss: Float[Array, "n r"]  # what the controls of each craft must bring about, m and m/s
    targets: Float[Array, "n r"]  # components of the states that each craft must have, m and m/s
    nodes: tuple[int, ...]  # when
    constrained: Bool[Array, "n r"]  # which of them apply to which craft; of others the miss is 0
    weight: Float[Array, "r"]  # by which velocities count like positions, m
    scale: Float[Array, "r"]  # to accelerations of one order, m/s²

    def __len__(self) -> int:
        return len(self.miss)

    def __getitem__(self, craft: Any) -> "StateConstraints":
        """The constraints of some craft."""
        rows = {name: getattr(self, name)[craft] for name in ("miss", "targets", "constrained")}
        return replace(self, **rows)

    @property
    def rounding(self) -> Float[Array, "r"]:
        """Misses that count as zero, m and m/s."""
        return np.asarray(MET / self.weight)

    def residuals(self, states: States) -> Float[Array, "n r"]:
        """The targets minus node states, 0 where not constrained, m and m/s."""
        there = states[:, list(self.nodes)].reshape(len(self), -1)
        return np.where(self.constrained, self.targets - there, 0.0)

    def missed_by_drift(self, k: int) -> tuple[float, str]:
        """The largest distance, m, by which craft k without burns misses, and that in words."""
        far, fast = np.linalg.norm(self.miss[k].reshape(-1, 2, 3), axis=2).max(axis=0).tolist()
        return far, f"by drift it misses by {far:.4g} m and {fast:.4g} m/s"


def timed_constraints(scenario: Scenario) -> StateConstraints:
    """The constraints of a scenario's goals, and of its waypoints as far as they have a time."""
    problem = scenario.problem
    passed = {
        craft: [(node, one) for one in some if (node := one.node(problem)) is not None]
        for craft, some in of_craft(scenario.waypoints).items()
    }
    return state_constraints(scenario.initial, scenario.goal, problem, passed)


def state_constraints(
    initial: Formation,
    goal: Formation,
    problem: Problem,
    passed: Mapping[int, Sequence[tuple[int, Waypoint]]],
) -> StateConstraints:
    """The constraints of n craft, some of which pass waypoints at nodes."""
    maps, n = transfer_maps(problem), len(initial)
    inner = sorted({node for some in passed.values() for node, _ in some})
    nodes = [problem.intervals, *inner]
    targets = np.zeros((n, len(nodes), 6))
    constrained = np.zeros(targets.shape, dtype=bool)
    targets[:, 0], constrained[:, 0] = goal, True
    for craft, some in passed.items():
        for node, waypoint in some:
            row = 1 + inner.index(node)
            targets[craft, row, :3], constrained[craft, row, :3] = waypoint.position, True
            if waypoint.velocity is not None:
                targets[craft, row, 3:], constrained[craft, row, 3:] = waypoint.velocity, True
    miss = np.where(constrained, targets - np.matvec(maps.drift[nodes], initial[:, None]), 0.0)
    times = len(nodes)
    reach = maps.reach[nodes].reshape(6 * times, -1)
    scale = np.tile(acceleration_scale(problem), times)
    effect = np.abs(reach).max(axis=1) * scale
    # What no control changes, such as vz in intervals of half an orbit, and is right asks nothing.
    idle = (effect < NO_EFFECT * effect.max()).reshape(-1, 6) & (np.abs(miss) <= MISSED)
    return StateConstraints(
        reach=reach,
        miss=np.where(idle, 0.0, miss).reshape(n, -1),
        targets=targets.reshape(n, -1),
        nodes=tuple(nodes),
        constrained=(constrained & ~idle).reshape(n, -1),
        weight=np.tile(state_weight(problem), times),
        scale=scale,
    )
