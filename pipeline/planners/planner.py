"""The planner protocol, the identity of a planner, and plans from controls with a certificate."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any, Protocol, runtime_checkable

from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.expert.batch import Batch
from pipeline.plan import INFEASIBLE, Made, Plan, Requirements, planned_all
from pipeline.scenario import Scenario

Ends = Float[Array, "b n 6"]
"""States of all craft at one end of some transfers, m and m/s."""


@runtime_checkable
class Planner(Protocol):
    """Whatever turns scenarios into plans: the expert, a baseline, a network."""

    @property
    def name(self) -> str:
        """What tables and plans call it."""
        ...

    @property
    def requirements(self) -> Requirements:
        """What its plans must satisfy, and are judged by."""
        ...

    def plan(self, scenarios: Sequence[Scenario]) -> list[Plan]:
        """One plan for each scenario, in order; the scenarios share one problem and one n."""
        ...


def identity(planner: Planner) -> dict[str, Any]:
    """Name, class, settings and digest of the network of a planner, JSON-ready.

    Planners with the same identity give the same plans where the versions of the code are the
    same.
    """
    return {"name": planner.name, **_identified(planner)}


def _identified(value: Any) -> Any:
    if value is None or isinstance(value, str | int | float):
        return value
    if isinstance(value, Mapping):
        return {str(key): _identified(one) for key, one in value.items()}
    if isinstance(value, Sequence):
        return [_identified(one) for one in value]
    if isinstance(getattr(value, "digest", None), str):  # a network
        return {"class": type(value).__qualname__, "digest": value.digest}
    if is_dataclass(value):
        parts = {field.name: _identified(getattr(value, field.name)) for field in fields(value)}
        return {"class": type(value).__qualname__, **parts}
    kind = value if hasattr(value, "__qualname__") else type(value)
    return f"{kind.__module__}.{kind.__qualname__}"


def certified(
    planner: str,
    scenarios: Sequence[Scenario],
    answer: Callable[[Batch], Float[Array, "n _ 3"]],
    requirements: Requirements,
) -> list[Plan]:
    """Plans from an answer to scenarios of one problem, INFEASIBLE where that is proven.

    The answer is the controls of all their craft, one after the other, m/s², which meet the goals;
    it is asked for once, and timed.
    """
    if not scenarios:
        return []
    started, batch = time.perf_counter(), Batch(scenarios)
    controls = answer(batch)
    timing = {"plan": (time.perf_counter() - started) / len(scenarios)}
    bound = batch.optima.bound
    made = [Made(controls[craft], *bound(craft), timing=timing) for craft in batch.craft]
    plans = planned_all(planner, scenarios, made, requirements)
    return [
        replace(plan, status=INFEASIBLE, message=why) if why else plan
        for plan, why in zip(plans, batch.infeasible(), strict=True)
    ]


def stacked_ends(batch: Batch) -> tuple[Ends, Ends]:
    """Initial and goal states of scenarios of one n."""
    shape = len(batch.scenarios), -1, 6
    return batch.initial.reshape(shape), batch.goal.reshape(shape)
