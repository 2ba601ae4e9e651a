"""A network as a planner: its prediction flown, so that dynamics and both ends hold exactly."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isclose

import numpy as np

from pipeline.errors import InputError
from pipeline.networks.model import Model
from pipeline.orbit.transfer import project_to_flyable
from pipeline.plan import Plan, planned
from pipeline.scenario import Scenario

SAME = 1e-6
"""Relative difference in orbit or step under which two problems are the same to a network."""


@dataclass(frozen=True, eq=False)
class Flown:
    """A model's plans: predicted, then projected onto the transfers that can be flown.

    Attributes:
        model: the network.
        name: what tables and plans call it.
        lower_bounds: the fuel lower bound of each scenario, m/s², for the certificates.
    """

    model: Model
    name: str
    lower_bounds: Callable[[Sequence[Scenario]], Sequence[float]]

    def plan(self, scenarios: Sequence[Scenario]) -> list[Plan]:
        """One plan for each scenario, in order; the scenarios share one problem and one n.

        Raises:
            InputError: where the scenarios are of another orbit or time grid than the network.
        """
        if not scenarios:
            return []
        check_problem(self.model, scenarios[0])
        started = time.perf_counter()
        initial = np.stack([scenario.initial for scenario in scenarios])
        goal = np.stack([scenario.goal for scenario in scenarios])
        predicted = self.model.predict(initial, goal)
        controls = project_to_flyable(predicted, initial, goal, scenarios[0].problem)
        timing = {"plan": (time.perf_counter() - started) / len(scenarios)}
        bounds = self.lower_bounds(scenarios)
        return [
            planned(self.name, scenario, controls[k], float(bounds[k]), timing=timing)
            for k, scenario in enumerate(scenarios)
        ]


def check_problem(model: Model, scenario: Scenario) -> None:
    """Refuse a scenario of another orbit or time grid than the model was trained on.

    The collision radius and the limit on the control may differ: a network knows neither, and
    the certificate judges by the scenario's own.

    Raises:
        InputError: with the field that differs.
    """
    for field in ("nodes", "time_step", "mean_motion"):
        given, known = getattr(scenario.problem, field), getattr(model.problem, field)
        if not isclose(given, known, rel_tol=SAME):
            raise InputError(
                f"{scenario.name or 'the scenario'} has {field} {given:.9g} and the network "
                f"{model.architecture} was trained with {known:.9g}; expected the same: plan with "
                "another planner or train on data of this kind."
            )
