"""Seeds that need no network: trajectories for the expert to aim its first cuts from."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.errors import InputError
from pipeline.expert.own import own_optima
from pipeline.orbit.transfer import fly, minimum_energy, straight_line
from pipeline.scenario import Scenario

Seed = Float[Array, "n T 6"]


def line_seed(scenario: Scenario) -> Seed:
    """The straight line between the two states of each craft, the paper's Manual(linear)."""
    return straight_line(scenario.initial, scenario.goal, scenario.problem.nodes)


def minimum_energy_seed(scenario: Scenario) -> Seed:
    """The closed-form transfer of least energy of each craft."""
    controls = minimum_energy(scenario.initial, scenario.goal, scenario.problem)
    return fly(scenario.initial, controls, scenario.problem)


def own_seed(scenario: Scenario) -> Seed:
    """The cheapest transfer of each craft on its own, by one linear program a craft."""
    own = own_optima(scenario.initial, scenario.goal, scenario.problem)
    return fly(scenario.initial, own.controls, scenario.problem)


def checked_seed(scenario: Scenario, seed: Seed) -> Seed:
    """The seed, where it is one for this scenario.

    Raises:
        InputError: for another shape or values that are not finite.
    """
    expected = (scenario.n, scenario.problem.nodes, 6)
    if seed.shape != expected:
        raise InputError(
            f"the seed has shape {seed.shape}; expected node states of shape {expected}."
        )
    if not np.isfinite(seed).all():
        raise InputError("the seed has values that are not finite; expected states in m and m/s.")
    return seed


SEEDS: dict[str, Callable[[Scenario], Seed] | None] = {
    "none": None,
    "straight line": line_seed,
    "minimum energy": minimum_energy_seed,
}
"""Seeds by the name that tables give them."""
