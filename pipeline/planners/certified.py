"""Controls of any planner made plans: flown and certified, with the bound that no plan beats."""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.expert import own_optima
from pipeline.expert.batch import Batch
from pipeline.expert.refuted import refuted
from pipeline.plan import INFEASIBLE, Made, Plan, Requirements, planned_all
from pipeline.scenario import Scenario, shared_problem

Ends = Float[Array, "b n 6"]
"""States of all craft at one end of some transfers, m and m/s."""


def certified(
    planner: str,
    scenarios: Sequence[Scenario],
    controls: Float[Array, "n intervals 3"],
    seconds: float,
    requirements: Requirements,
) -> list[Plan]:
    """The plans of controls for scenarios of one problem; infeasible where none is proven to be.

    Args:
        planner: its name.
        scenarios: what was asked, at least one.
        controls: of all their craft, one after the other, m/s².
        seconds: that it took to make them all.
        requirements: what the plans are judged by.
    """
    batch, timing = Batch(scenarios), {"plan": seconds / len(scenarios)}
    own = own_optima(batch.initial, batch.goal, batch.problem)
    made = [Made(controls[craft], *own.bound(craft), timing=timing) for craft in batch.craft]
    plans = planned_all(planner, scenarios, made, requirements)
    return [
        replace(plan, status=INFEASIBLE, message=why) if why else plan
        for plan, why in zip(plans, refuted(batch, own), strict=True)
    ]


def certified_answers(
    planner: str,
    scenarios: Sequence[Scenario],
    answer: Callable[[Ends, Ends], Float[Array, "b n _ 3"]],
    requirements: Requirements,
) -> list[Plan]:
    """The plans of what answers scenarios of one problem and one n at once, and its time.

    Args:
        planner: its name.
        scenarios: what was asked.
        answer: from initial and goal states, m and m/s, to controls that meet the goal, m/s².
        requirements: what the plans are judged by.
    """
    if not scenarios:
        return []
    shared_problem(scenarios)
    started = time.perf_counter()
    initial = np.stack([scenario.initial for scenario in scenarios])
    goal = np.stack([scenario.goal for scenario in scenarios])
    controls = answer(initial, goal)
    seconds = time.perf_counter() - started
    flat = controls.reshape(-1, *controls.shape[2:])
    return certified(planner, scenarios, flat, seconds, requirements)
