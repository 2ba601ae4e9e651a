"""Scenarios with thrusters of any kind, limits of craft and impulse bits, drawn at random."""

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
from judge import Case, least_fuel
from judged import document

from pipeline.orbit.problem import Problem
from pipeline.orbit.thrust import Thrust
from pipeline.scenario import Scenario, draw
from pipeline.scenario.spacecraft import Spacecraft

CORNERS = [(1, 1, 1), (-1, -1, 1), (-1, 1, -1), (1, -1, -1)]
FIVE: Any = tuple(
    tuple(map(float, np.array(one) / np.linalg.norm(one))) for one in [*CORNERS, (0, 0, -1)]
)
"""A tetrahedron of thrusters, and one more."""

AXES: Any = tuple(map(tuple, np.concatenate([np.eye(3), -np.eye(3)]).tolist()))
"""Thrusters along the axes, as directions."""

EIGHT: Any = tuple(tuple((np.array(one) / 3**0.5).tolist()) for one in product((1, -1), repeat=3))
"""Thrusters to the corners of a cube: four of them are on each facet of their hull."""

TWELVE: Any = tuple(
    tuple((np.array(one) / 2**0.5).tolist())
    for one in product((1, -1, 0), repeat=3)
    if one.count(0) == 1
)
"""Thrusters to the middles of a cube's edges."""

MODELS: Any = ("components", "norm", FIVE, AXES)


def with_thrust(
    scenario: Scenario,
    thrust: Thrust,
    craft: tuple[Spacecraft, ...] = (),
    limit: float | None = None,
) -> Scenario:
    """The scenario with other thrusters, craft, and limit of components."""
    problem = replace(scenario.problem, thrust=thrust, max_acceleration=limit)
    return replace(scenario, problem=problem, craft=craft)


def least(scenario: Scenario) -> np.ndarray:
    """The judge's least fuel of each craft on its own, m/s²; infinite where there is none."""
    return least_fuel(
        Case.of(document(scenario), scenario.n), scenario.initial, scenario.goal
    ).attained


def drawn(seed: int, *, n: int, bit: bool = False) -> Scenario:
    """A scenario with some of all that may be said of thrust, about the size of what it needs."""
    rng = np.random.default_rng(seed)
    nodes, step = int(rng.choice([3, 4, 7, 11, 21])), float(rng.choice([50, 200, 300]))
    scenario = draw("rings", seed, n, 0, Problem(time_step=step, nodes=nodes))
    model = MODELS[rng.integers(4)]
    needed = float(least(with_thrust(scenario, Thrust("norm"))).max())

    def size(low: float, high: float) -> float:
        return float(needed / (nodes - 1) * np.exp(rng.uniform(np.log(low), np.log(high))))

    def windows(chance: float) -> Any:
        if rng.random() > chance:
            return ()
        return (tuple(sorted(rng.uniform(0, scenario.problem.duration, 2).tolist())),)

    def perhaps(chance: float, low: float, high: float) -> float | None:
        return size(low, high) if rng.random() < chance else None

    smallest = step * size(0.05, 2) if bit else None
    fair = rng.random() < 0.2
    thrust = Thrust(model, perhaps(0.4, 1, 12), smallest, windows(0.2), "fair" if fair else "total")
    craft = tuple(
        Spacecraft(
            max_acceleration=perhaps(0.2, 1, 12),
            max_acceleration_norm=perhaps(0.2, 1, 12),
            delta_v=step * needed * float(rng.uniform(0.5, 3))
            if fair or rng.random() < 0.4
            else None,
            no_burn=windows(0.2),
        )
        for _ in range(n)
    )
    own = fair or rng.random() < 0.5
    return with_thrust(scenario, thrust, craft if own else (), perhaps(0.4, 1, 12))
