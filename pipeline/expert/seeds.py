"""Seeds that need no network: trajectories for the expert to aim its first cuts from."""

from collections.abc import Callable

from jaxtyping import Float

from pipeline.arrays import Array
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


SEEDS: dict[str, Callable[[Scenario], Seed] | None] = {
    "none": None,
    "straight line": line_seed,
    "minimum energy": minimum_energy_seed,
}
"""Seeds by the name that tables give them."""
