"""A network as a planner: its prediction flown, so that dynamics and both ends hold exactly."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isclose

import numpy as np

from pipeline.errors import InputError
from pipeline.networks.model import Model
from pipeline.orbit.problem import Problem
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
        at_nodes: judge plans by separation at the nodes only, the paper's criterion.
    """

    model: Model
    name: str
    lower_bounds: Callable[[Sequence[Scenario]], Sequence[float]]
    at_nodes: bool = False

    def plan(self, scenarios: Sequence[Scenario]) -> list[Plan]:
        """One plan for each scenario, in order; the scenarios share one problem and one n.

        On another orbit or time grid than that of its training the network answers with the same
        weights; what that is worth the certificate says.

        Raises:
            InputError: where the weights do not fit the scenarios' number of nodes.
        """
        if not scenarios:
            return []
        problem = scenarios[0].problem
        model = self.model if _fault(self.model, problem) is None else self.model.on(problem)
        started = time.perf_counter()
        initial = np.stack([scenario.initial for scenario in scenarios])
        goal = np.stack([scenario.goal for scenario in scenarios])
        controls = project_to_flyable(model.predict(initial, goal), initial, goal, problem)
        timing = {"plan": (time.perf_counter() - started) / len(scenarios)}
        bounds = self.lower_bounds(scenarios)
        return [
            planned(
                self.name,
                scenario,
                controls[k],
                float(bounds[k]),
                at_nodes=self.at_nodes,
                timing=timing,
            )
            for k, scenario in enumerate(scenarios)
        ]


def check_problem(model: Model, problem: Problem, where: str) -> None:
    """Refuse a problem of another orbit or time grid than the model was trained on.

    The collision radius and the limit on the control may differ: a network knows neither, and
    the certificate judges by the scenario's own.

    Args:
        model: the network.
        problem: what it is to be tried on.
        where: what has that problem, such as a dataset's folder.

    Raises:
        InputError: with the field that differs.
    """
    field = _fault(model, problem)
    if field is not None:
        raise InputError(
            f"{where} has {field} {getattr(problem, field):.9g} and the network "
            f"{model.architecture} was trained with {getattr(model.problem, field):.9g}; expected "
            "the same: take data of this kind or other models."
        )


def _fault(model: Model, problem: Problem) -> str | None:
    """The first field in which a problem differs from that of the training, as networks see it."""
    for field in ("nodes", "time_step", "mean_motion"):
        if not isclose(getattr(problem, field), getattr(model.problem, field), rel_tol=SAME):
            return field
    return None
