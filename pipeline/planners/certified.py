"""Plans with certificates from controls that a planner answers with."""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.expert.batch import Batch
from pipeline.plan import INFEASIBLE, Made, Plan, Requirements, planned_all
from pipeline.scenario import Scenario


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
    made = [
        Made(
            *(controls[craft], *batch.bound(k)), timing=timing, least_share=batch.least_share(craft)
        )
        for k, craft in enumerate(batch.craft)
    ]
    plans = planned_all(planner, scenarios, made, requirements)
    return [
        replace(plan, status=INFEASIBLE, message=why) if why else plan
        for plan, why in zip(plans, batch.infeasible(), strict=True)
    ]


def stacked_ends(batch: Batch) -> tuple[Float[Array, "b n 6"], Float[Array, "b n 6"]]:
    """Initial and goal states of scenarios of one n, m and m/s."""
    shape = len(batch.scenarios), -1, 6
    return batch.initial.reshape(shape), batch.goal.reshape(shape)
