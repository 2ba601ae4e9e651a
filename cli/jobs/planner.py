"""The planner that a person names: one that needs no store, or a registered model."""

from pipeline.expert.settings import Effort
from pipeline.extras import told_which_extra
from pipeline.plan import Requirements
from pipeline.planners.goal_assignment import GoalAssignment
from pipeline.planners.named import named_planner
from pipeline.planners.planner import Planner


def planner_of(
    name: str,
    requirements: Requirements,
    effort: Effort | None,
    *,
    raw: bool = False,
    assignment: str = "given",
) -> Planner:
    """The planner of a name; all but models need neither MLflow nor torch.

    With the assignment "optimal" craft are interchangeable, and take the goals that cost least.

    Raises:
        InputError: for a name that no planner has, or an option that it has no use for.
    """
    with told_which_extra():
        found = named_planner(name, requirements, effort=effort, raw=raw)
        if found is None:
            from cli.jobs.networks import model_planner

            found = model_planner(name, requirements, effort=effort, raw=raw)
    return GoalAssignment(found) if assignment == "optimal" else found
