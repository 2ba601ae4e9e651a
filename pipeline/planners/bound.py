"""The fuel that no plan can beat, by which planners are judged."""

from functools import lru_cache

from pipeline.expert import own_optima
from pipeline.scenario import Scenario


@lru_cache(maxsize=8192)
def fuel_lower_bound(scenario: Scenario) -> float:
    """The fuel that no plan for a scenario can beat, m/s²."""
    own = own_optima(scenario.initial, scenario.goal, scenario.problem)
    return float(own.lower_bound.sum())
