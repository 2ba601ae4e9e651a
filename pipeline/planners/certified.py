"""Controls of any planner made plans: flown and certified, with the bound that no plan beats."""

from collections.abc import Sequence

from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.expert import own_optima
from pipeline.expert.batch import Batch
from pipeline.plan import Made, Plan, planned_all
from pipeline.scenario import Scenario


def certified(
    planner: str,
    scenarios: Sequence[Scenario],
    controls: Float[Array, "n intervals 3"],
    seconds: float,
    *,
    at_nodes: bool,
    passive_safety: float | None = None,
) -> list[Plan]:
    """The plans of controls for scenarios of one problem.

    Args:
        planner: its name.
        scenarios: what was asked.
        controls: of all their craft, one after the other, m/s².
        seconds: that it took to make them all.
        at_nodes: judge by separation at the nodes only, the paper's criterion.
        passive_safety: judge by it after a loss of thrust too, for so many orbits, or None.
    """
    if not scenarios:
        return []
    batch, timing = Batch(scenarios), {"plan": seconds / len(scenarios)}
    own = own_optima(batch.initial, batch.goal, batch.problem)
    made = [Made(controls[craft], *own.bound(craft), timing=timing) for craft in batch.craft]
    return planned_all(planner, scenarios, made, at_nodes=at_nodes, passive_safety=passive_safety)
