"""Planners by the name that a person gives: baseline or registered model."""

import re

from pipeline.errors import InputError
from pipeline.evaluation.baselines import BASELINES, fuel_lower_bounds
from pipeline.expert import Seeded
from pipeline.networks.catalogue import architecture_names
from pipeline.networks.flown import Flown
from pipeline.plan import Planner
from registry.models import load
from registry.version import PREFIX


def planner_of(reference: str, *, raw: bool = False) -> Planner:
    """The planner that a reference names.

    Args:
        reference: a baseline's name with hyphens for spaces, or a registered model.
        raw: leave a model's flown plan as it is, safe or not; otherwise it seeds the expert.

    Raises:
        InputError: for a name that is none of these, or where the registry has no such model.
        ProlearnError: where the store fails.
    """
    for baseline in BASELINES:
        if baseline.name.replace(" ", "-") == reference:
            return baseline
    _check_architecture(reference)
    model, version = load(reference)
    flown = Flown(model, version.label, fuel_lower_bounds)
    return flown if raw else Seeded(flown)


def _check_architecture(reference: str) -> None:
    """Say what a planner can be before the registry says what it lacks."""
    name = re.split(r"[@:/]", reference.removeprefix("models:/"))[0].removeprefix(PREFIX)
    if name not in architecture_names() and not reference.startswith("models:/m-"):
        baselines = ", ".join(baseline.name.replace(" ", "-") for baseline in BASELINES)
        raise InputError(
            f"planner is {reference!r}; expected expert, {baselines}, or a registered model of "
            f"{', '.join(architecture_names())}, such as ff1 or ff1:paper."
        )
