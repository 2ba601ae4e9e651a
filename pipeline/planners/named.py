"""Planners that a person names and that need no store: expert, baselines, the packaged refiner."""

from dataclasses import replace
from typing import Literal

from pipeline.errors import InputError
from pipeline.expert import EFFORTS
from pipeline.networks.refiner.ablations import REFINER
from pipeline.orbit.thrust_loss import check_orbits
from pipeline.planners.baselines import BASELINES
from pipeline.planners.expert import Expert
from pipeline.planners.planner import Planner

EXPERT = "expert"

Separation = Literal["continuous", "nodes"]

_BASELINES = {baseline.name.replace(" ", "-"): baseline for baseline in BASELINES}

NAMES = (EXPERT, REFINER, *_BASELINES)
"""The names, with hyphens for spaces. The refiner is the one that comes with the package; those of
the registry are named with their recipe or version."""


def named_planner(
    name: str,
    *,
    separation: Separation = "continuous",
    effort: str | None = None,
    raw: bool = False,
    passive_safety: float | None = None,
) -> Planner | None:
    """The planner of a name, or None where it is none of NAMES; what it is told holds for it.

    Args:
        name: of the planner.
        separation: keep craft apart at all times or at the nodes only; a baseline's plans, which
            keep none apart, are judged by it.
        effort: of the expert, of EFFORTS; by default it goes on until its plan no longer improves,
            and behind the refiner ends at the first safe plan.
        raw: asked for a network's plan without the expert after it.
        passive_safety: keep craft apart for so many orbits after a loss of thrust too; a
            baseline's plans are judged by it.

    Raises:
        InputError: for an option that the planner has no use for.
    """
    if name not in NAMES:
        return None
    if name == REFINER:
        return _refiner(separation, effort, raw=raw, passive_safety=passive_safety)
    if raw:
        raise InputError(
            f"--raw is given and the planner is {name}, after which there is no expert; expected "
            "a network: leave --raw out."
        )
    if name == EXPERT:
        settings = EFFORTS[effort or "default"]
        return Expert(replace(settings, separation=separation, passive_safety=passive_safety))
    refuse_effort(effort)
    at_nodes = separation == "nodes"
    return replace(_BASELINES[name], at_nodes=at_nodes, passive_safety=passive_safety)


def _refiner(
    separation: Separation, effort: str | None, *, raw: bool, passive_safety: float | None
) -> Planner:
    """The packaged refiner, alone or with the expert behind it."""
    from pipeline.networks.refiner.packaged import packaged
    from pipeline.planners.ladder import Ladder
    from pipeline.planners.network import Flown

    if raw:
        refuse_effort(effort)
    at_nodes = separation == "nodes"
    flown = Flown(packaged(), REFINER, at_nodes=at_nodes, passive_safety=passive_safety)
    return flown if raw else Ladder(flown, EFFORTS[effort or "first"])


def refuse_effort(effort: str | None) -> None:
    """Refuse an effort where the expert has no part.

    Raises:
        InputError: where one is given.
    """
    if effort is not None:
        raise InputError(
            f"--effort is {effort} and the expert has no part in the plan; expected it with the "
            "expert, or with a model and without --raw: leave --effort out."
        )


def check_passive_safety(orbits: float, separation: Separation) -> None:
    """Refuse passive safety for no length of a drift, or together with separation at nodes only.

    Raises:
        InputError: with what was given and what was expected.
    """
    check_orbits(orbits)
    if separation == "nodes":
        raise InputError(
            "--passive-safety is given with --separation nodes; expected craft that are apart at "
            "all times, in flight as adrift: leave one of the two out."
        )
