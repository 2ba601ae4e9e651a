"""The planner protocol, and the identity of a planner."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, Protocol, runtime_checkable

from pipeline.errors import InputError, check_each
from pipeline.networks.recipes import code_of_others
from pipeline.plan.plan import Plan
from pipeline.plan.requirements import Requirements
from pipeline.provenance import version_of
from pipeline.scenario import Scenario


@runtime_checkable
class Planner(Protocol):
    """Protocol of planners, which turn scenarios into plans: the expert, a baseline, a network."""

    @property
    def name(self) -> str:
        """What tables and plans call it."""

    @property
    def requirements(self) -> Requirements:
        """What its plans must satisfy, and are judged by."""

    def plan(self, scenarios: Sequence[Scenario]) -> list[Plan]:
        """One plan for each scenario, in order; the scenarios share one problem and one n."""


def plans_of(planner: Planner, scenarios: Sequence[Scenario]) -> list[Plan]:
    """A planner's plans; InputError where a planner from outside does not return one for each."""
    plans = planner.plan(scenarios)
    check_each(f"what the planner {planner.name} returned", plans, Plan)
    if len(plans) != len(scenarios):
        raise InputError(
            f"the planner {planner.name} returned {len(plans)} plans for {len(scenarios)} "
            "scenarios; expected one for each, in order."
        )
    return plans


@dataclass(frozen=True)
class PlannerWrapper:
    """Base class of planners that wrap another one and have its name and requirements."""

    planner: Planner

    @property
    def name(self) -> str:
        """The wrapped planner's."""
        return self.planner.name

    @property
    def requirements(self) -> Requirements:
        """The wrapped planner's."""
        return self.planner.requirements


def requiring(planner: Planner, requirements: Requirements) -> Planner:
    """The same planner with other requirements; itself where it is no dataclass.

    A planner that wraps another one has its requirements from that one.
    """
    if not is_dataclass(planner):
        return planner
    parts = {field.name: getattr(planner, field.name) for field in fields(planner)}
    changed: dict[str, Any] = {"requirements": requirements}
    if "requirements" not in parts:
        others = {name: one for name, one in parts.items() if isinstance(one, Planner)}
        changed = {name: requiring(one, requirements) for name, one in others.items()}
    return replace(planner, **changed)


def identity(planner: Planner) -> dict[str, Any]:
    """All that decides a planner's plans, as JSON values: name, class, settings, network digest."""
    return {"name": planner.name, **_identified(planner)}


def _identified(value: Any) -> Any:
    if value is None or isinstance(value, str | int | float):
        return value
    if isinstance(value, Mapping):
        return {str(key): _identified(one) for key, one in value.items()}
    if isinstance(value, Sequence):
        return [_identified(one) for one in value]
    if isinstance(getattr(value, "digest", None), str):  # a network
        versions = {name: version_of(name) for name in code_of_others([value.architecture])}
        return {"class": type(value).__qualname__, "digest": value.digest, **versions}
    if is_dataclass(value):
        parts = {field.name: _identified(getattr(value, field.name)) for field in fields(value)}
        return {"class": type(value).__qualname__, **parts}
    kind = value if hasattr(value, "__qualname__") else type(value)
    return f"{kind.__module__}.{kind.__qualname__}"
