"""Seeds without networks: trajectories about which the expert's first cuts are linearized."""

from collections.abc import Callable

import numpy as np

from pipeline.errors import InputError
from pipeline.expert.decoupled import decoupled_optima
from pipeline.orbit.arrays import States
from pipeline.orbit.transfer import fly, minimum_energy, straight_line
from pipeline.scenario import Scenario

Seed = States


def line_seed(scenario: Scenario) -> Seed:
    """The straight line between each craft's two states, the paper's Manual(linear)."""
    return straight_line(scenario.initial, scenario.goal, scenario.problem.nodes)


def minimum_energy_seed(scenario: Scenario) -> Seed:
    """The closed-form transfer of least energy of each craft."""
    controls = minimum_energy(scenario.initial, scenario.goal, scenario.problem)
    return fly(scenario.initial, controls, scenario.problem)


def decoupled_seed(scenario: Scenario) -> Seed:
    """The decoupled optimum of each craft."""
    optima = decoupled_optima(scenario.initial, scenario.goal, scenario.problem)
    return fly(scenario.initial, optima.controls, scenario.problem)


# Seeds by the name that tables give them
SEEDS: dict[str, Callable[[Scenario], Seed] | None] = {
    "none": None,
    "straight line": line_seed,
    "minimum energy": minimum_energy_seed,
}


def checked_seed(scenario: Scenario, seed: Seed) -> Seed:
    """Validate a seed trajectory: InputError for a wrong shape or values that are not finite."""
    expected = (scenario.n, scenario.problem.nodes, 6)
    if seed.shape != expected:
        raise InputError(
            f"the seed has shape {seed.shape}; expected node states of shape {expected}."
        )
    if not np.isfinite(seed).all():
        raise InputError("the seed has values that are not finite; expected states in m and m/s.")
    return seed
