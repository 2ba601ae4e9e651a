"""The planner that a person names: one that needs no store, or a registered model."""

import re

from pipeline.errors import InputError, check_choice, check_kind, missing_extra_hint
from pipeline.expert.settings import EFFORTS, Effort
from pipeline.networks.recipes import architecture_names
from pipeline.plan.requirements import AT_ALL_TIMES, Requirements
from pipeline.planners.goal_assignment import GoalAssignment
from pipeline.planners.named import NAMES, named_planner, refuse_effort, with_expert
from pipeline.planners.planner import Planner


def planner_of(
    name: str = "expert",
    requirements: Requirements = AT_ALL_TIMES,
    effort: Effort | None = None,
    *,
    raw: bool = False,
    assignment: str = "given",
) -> Planner:
    """The planner of a name, whose ``plan`` takes several scenarios of one problem and one n.

    All but registered models need neither MLflow nor torch.

    Args:
        name: expert, refiner, minimum-energy, straight-line, decoupled-optimum, or a registered
            model such as lstm2 or ff1:paper.
        requirements: what its plans must satisfy; by default separation at all times.
        effort: of the expert: first, default or best. By default the second; after a model the
            first, and after the refiner that only where it has no safe plan.
        raw: a model's own plan, safe or not, without the expert after it.
        assignment: optimal, if craft are interchangeable and take the goals that cost least.

    Raises:
        InputError: for a name that no planner has, or an option that it has no use for.
    """
    check_kind("planner", name, str)
    check_kind("requirements", requirements, Requirements)
    check_kind("raw", raw, bool)
    check_choice("assignment", assignment, ("given", "optimal"))
    if effort is not None:
        check_choice("effort", effort, EFFORTS)
    with missing_extra_hint():
        found = named_planner(name, requirements, effort=effort, raw=raw)
        if found is None:
            _refuse_unknown(name)  # before what the registry lacks, or what is not installed
            if raw:
                refuse_effort(effort)
            from registry.models import load

            model, version = load(name)
            # Imported last: where MLflow is missing, the message names the extra that has both.
            from pipeline.planners.network import NetworkPlanner

            network = NetworkPlanner(model, f"{version.arch}/{version.version}", requirements)
            found = network if raw else with_expert(network, effort)
    return GoalAssignment(found) if assignment == "optimal" else found


def _refuse_unknown(reference: str) -> None:
    name = re.split(r"[@:/]", reference.removeprefix("models:/"))[0].removeprefix("prolearn-")
    known = architecture_names()
    if name not in known and not reference.startswith("models:/m-"):
        raise InputError(
            f"planner is {reference!r}; expected {', '.join(NAMES)}, or a registered model of "
            f"{', '.join(known)}, such as ff1 or ff1:paper."
        )
