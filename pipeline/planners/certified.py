"""Controls of any planner made plans: flown and certified, with the bound that no plan beats."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.expert import own_optima
from pipeline.plan import Made, Plan, planned_all
from pipeline.scenario import Scenario


def certified(
    planner: str,
    scenarios: Sequence[Scenario],
    controls: Float[Array, "n intervals 3"],
    seconds: float,
    *,
    at_nodes: bool,
) -> list[Plan]:
    """The plans of controls for scenarios of one problem.

    Args:
        planner: its name.
        scenarios: what was asked.
        controls: of all their craft, one after the other, m/s².
        seconds: that it took to make them all.
        at_nodes: judge by separation at the nodes only, the paper's criterion.
    """
    if not scenarios:
        return []
    own = own_optima(*ends(scenarios), scenarios[0].problem)
    starts = np.cumsum([0, *(scenario.n for scenario in scenarios)])
    made = []
    for first, end in pairwise(starts.tolist()):
        bound = own.bound(slice(first, end))
        made.append(Made(controls[first:end], *bound, timing={"plan": seconds / len(scenarios)}))
    return planned_all(planner, scenarios, made, at_nodes=at_nodes)


def ends(scenarios: Sequence[Scenario]) -> tuple[Float[Array, "n 6"], Float[Array, "n 6"]]:
    """Initial and goal states of the craft of all scenarios, one after the other."""
    return (
        np.concatenate([scenario.initial for scenario in scenarios]),
        np.concatenate([scenario.goal for scenario in scenarios]),
    )
