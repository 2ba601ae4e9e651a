"""Planners that need no registry, by name: expert, baselines, the packaged refiner."""

from dataclasses import replace
from typing import TYPE_CHECKING

from pipeline.errors import InputError
from pipeline.expert import EFFORTS
from pipeline.networks.recipes import REFINER
from pipeline.plan.requirements import AT_ALL_TIMES, Requirements
from pipeline.planners.classical import BASELINES, Expert
from pipeline.planners.planner import Planner

if TYPE_CHECKING:
    from pipeline.planners.network import NetworkPlanner

EXPERT = "expert"
_BASELINES = {baseline.name.replace(" ", "-"): baseline for baseline in BASELINES}
# The names, with hyphens for spaces. The refiner is the one that comes with the package; those of
# the registry are named with their recipe or version.
NAMES = (EXPERT, REFINER, *_BASELINES)


def named_planner(
    name: str,
    requirements: Requirements = AT_ALL_TIMES,
    *,
    effort: str | None = None,
    raw: bool = False,
) -> Planner | None:
    """The planner of a name, or None where it is none of NAMES.

    The effort, of EFFORTS, is the expert's. By default it iterates until its plan no longer
    improves; after the refiner, it plans only where that has no safe plan, and with ``raw`` not
    at all. InputError for an option that does not apply to the planner.
    """
    if name not in NAMES:
        return None
    if name == REFINER:
        from pipeline.networks.refiner.model import packaged
        from pipeline.planners.network import NetworkPlanner

        if raw:
            refuse_effort(effort)
        network = NetworkPlanner(packaged(), REFINER, requirements)
        return network if raw else with_expert(network, effort)
    if raw:
        raise InputError(
            f"raw is given and the planner is {name}, after which there is no expert; expected "
            "a network: leave raw out."
        )
    if name == EXPERT:
        return Expert(EFFORTS[effort or "default"], requirements=requirements)
    refuse_effort(effort)
    return replace(_BASELINES[name], requirements=requirements)


def with_expert(network: "NetworkPlanner", effort: str | None) -> Planner:
    """The planner in which the expert follows a network.

    Controls that a network answers are a plan: without an effort, of EFFORTS, the expert plans only
    where it is not proven safe. States are a seed of the expert, as are controls with an effort.
    """
    from pipeline.planners.network import FallbackPlanner, Seeded

    settings = EFFORTS[effort or "first"]
    as_it_is = network.model.answers == "controls" and settings.stop == "first-safe"
    return FallbackPlanner(network, settings) if as_it_is else Seeded(network, settings)


def refuse_effort(effort: str | None) -> None:
    """Refuse an effort, with an InputError, for a planner without the expert."""
    if effort is not None:
        raise InputError(
            f"effort is {effort} and the expert has no part in the plan; expected it with the "
            "expert, or with a model and without raw: leave effort out."
        )
