"""A registered model as a planner, alone or made safe by the expert."""

import re

from pipeline.errors import InputError
from pipeline.networks.catalogue import architecture_names
from pipeline.plan import Requirements
from pipeline.planners.named import NAMES, refuse_effort, with_expert
from pipeline.planners.network import NetworkPlanner
from pipeline.planners.planner import Planner
from registry.models import load
from registry.version import PREFIX


def model_planner(
    reference: str, requirements: Requirements, *, effort: str | None, raw: bool
) -> Planner:
    """The planner that a reference to a model names.

    Args:
        reference: a registered model.
        requirements: what its plans must satisfy.
        effort: of the expert after the model, of EFFORTS, as in ``with_expert``.
        raw: leave the model's flown plan as it is, safe or not; otherwise the expert comes after
            it, where it answers with controls only if that plan is not proven safe.

    Raises:
        InputError: for a name that no planner has, where the registry has no such model, or for
            an effort without the expert.
        ProlearnError: where the store fails.
    """
    if raw:
        refuse_effort(effort)
    _check_architecture(reference)
    model, version = load(reference)
    flown = NetworkPlanner(model, f"{version.arch}/{version.version}", requirements)
    return flown if raw else with_expert(flown, effort)


def _check_architecture(reference: str) -> None:
    """Say what a planner can be before the registry says what it lacks."""
    name = re.split(r"[@:/]", reference.removeprefix("models:/"))[0].removeprefix(PREFIX)
    if name not in architecture_names() and not reference.startswith("models:/m-"):
        raise InputError(
            f"planner is {reference!r}; expected {', '.join(NAMES)}, or a registered model of "
            f"{', '.join(architecture_names())}, such as ff1 or ff1:paper."
        )
