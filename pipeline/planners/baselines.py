"""Planners that need neither a network nor a joint program: they belong in every table."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import perf_counter

from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.expert import own_optima
from pipeline.orbit.transfer import minimum_energy, project_to_flyable, straight_line
from pipeline.plan import Plan, planned
from pipeline.planners.bound import fuel_lower_bound
from pipeline.scenario import Scenario

Controls = Float[Array, "n intervals 3"]


@dataclass(frozen=True)
class Baseline:
    """A planner that plans each craft on its own.

    Attributes:
        name: what tables call it.
        controls: from a scenario to controls in m/s² that meet the goal.
        at_nodes: judge plans by separation at the nodes only, the paper's criterion.
    """

    name: str
    controls: Callable[[Scenario], Controls]
    at_nodes: bool = False

    def plan(self, scenarios: Sequence[Scenario]) -> list[Plan]:
        """One plan for each scenario."""
        return [self._plan(scenario) for scenario in scenarios]

    def _plan(self, scenario: Scenario) -> Plan:
        started = perf_counter()
        controls = self.controls(scenario)
        timing = {"plan": perf_counter() - started}
        return planned(
            self.name,
            scenario,
            controls,
            fuel_lower_bound(scenario),
            at_nodes=self.at_nodes,
            timing=timing,
        )


def _line(scenario: Scenario) -> Controls:
    ends = scenario.initial, scenario.goal
    states = straight_line(*ends, scenario.problem.nodes)
    return project_to_flyable(states, *ends, scenario.problem)


def _energy(scenario: Scenario) -> Controls:
    return minimum_energy(scenario.initial, scenario.goal, scenario.problem)


def _own(scenario: Scenario) -> Controls:
    return own_optima(scenario.initial, scenario.goal, scenario.problem).controls


BASELINES = (
    Baseline("straight line", _line),
    Baseline("minimum energy", _energy),
    Baseline("own LP", _own),
)
"""The straight line made flyable, the closed-form minimum-energy transfer, the own optima."""
