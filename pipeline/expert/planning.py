"""The expert: scenarios, and perhaps seeds, in; plans that satisfy all that is required out."""

from collections.abc import Sequence

from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.expert.expert import nominal_plans
from pipeline.expert.risk import all_within_risk
from pipeline.expert.seeds import Seed
from pipeline.expert.settings import Settings
from pipeline.plan import AT_ALL_TIMES, Plan, Requirements
from pipeline.scenario import Scenario


def solve(
    scenario: Scenario,
    seed: Seed | None = None,
    settings: Settings | None = None,
    requirements: Requirements = AT_ALL_TIMES,
) -> Plan:
    """The expert's plan for a scenario.

    Args:
        scenario: what the swarm is to do.
        seed: node states (n, T, 6) to aim the first cuts from, m and m/s; they need neither be
            safe nor obey the dynamics. Without one the own optima are aimed from.
        settings: how to work.
        requirements: what the plan must satisfy.

    Raises:
        InputError: for a seed of another shape or with values that are not finite.
    """
    return solve_many([scenario], None if seed is None else [seed], settings, requirements)[0]


def solve_many(
    scenarios: Sequence[Scenario],
    seeds: Sequence[Float[Array, "_ T 6"] | None] | None = None,
    settings: Settings | None = None,
    requirements: Requirements = AT_ALL_TIMES,
) -> list[Plan]:
    """The expert's plans for scenarios of one problem, with what they share computed once.

    Args:
        scenarios: what swarms are to do; sizes may differ.
        seeds: for each, as in ``solve``, or None.
        settings: how to work.
        requirements: what every plan must satisfy.

    Raises:
        InputError: for a seed of another shape or with values that are not finite.
    """
    settings = settings or Settings()
    plans = nominal_plans(scenarios, seeds, settings, requirements)
    return all_within_risk(scenarios, plans, requirements, settings)
