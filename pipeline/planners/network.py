"""A network as a planner: its answer flown, so that dynamics and both ends hold exactly."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isclose

from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.errors import InputError
from pipeline.networks.document import TrainedNetwork
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import meet_goal, project_to_flyable
from pipeline.plan import AT_ALL_TIMES, Plan, Requirements
from pipeline.planners.certified import Ends, certified_answers
from pipeline.scenario import Scenario

SAME = 1e-6
"""Relative difference in orbit or step under which two problems are the same to a network."""


@dataclass(frozen=True, eq=False)
class Flown:
    """A model's plans, which obey the dynamics and meet the goal whatever it answers.

    States are projected onto the transfers that can be flown; controls get the correction of
    least energy.

    Attributes:
        model: the network.
        name: what tables and plans call it.
        requirements: what its plans are judged by; the network knows the collision radius alone.
    """

    model: TrainedNetwork
    name: str
    requirements: Requirements = AT_ALL_TIMES

    def plan(self, scenarios: Sequence[Scenario]) -> list[Plan]:
        """One plan for each scenario, in order; the scenarios share one problem and one n.

        On another orbit or time grid than that of its training the network answers with the same
        weights; what that is worth the certificate says.

        Raises:
            InputError: where the weights do not fit the scenarios' number of nodes.
        """

        def answer(initial: Ends, goal: Ends) -> Float[Array, "b n _ 3"]:
            problem = scenarios[0].problem
            model = self.model if _fault(self.model, problem) is None else self.model.on(problem)
            found = model.answer(initial, goal, problem.collision_radius)
            if model.answers == "states":
                return project_to_flyable(found, initial, goal, problem)
            return meet_goal(initial, found, goal, problem)

        return certified_answers(self.name, scenarios, answer, self.requirements)


def check_problem(model: TrainedNetwork, problem: Problem, where: str) -> None:
    """Refuse a problem of another orbit or time grid than the model was trained on.

    The collision radius and the limit on the control may differ: no network knows the limit,
    one that reads the radius is told the scenario's, and the certificate judges by these.

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


def _fault(model: TrainedNetwork, problem: Problem) -> str | None:
    """The first field in which a problem differs from that of the training, as networks see it."""
    for field in ("nodes", "time_step", "mean_motion"):
        if not isclose(getattr(problem, field), getattr(model.problem, field), rel_tol=SAME):
            return field
    return None
