"""What plans many scenarios at once: each as alone, and those of several problems not at all."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.fallback import rule
from pipeline.errors import InputError
from pipeline.expert import solve_many
from pipeline.orbit.problem import Problem
from pipeline.planners.goal_assignment import GoalAssignment
from pipeline.planners.named import NAMES, named_planner
from pipeline.scenario import draw

PLANNERS = [*map(named_planner, NAMES), GoalAssignment(named_planner("expert")), rule(2)]
EXACT = [one for one in PLANNERS if one.name not in {"refiner", "rule"}]


def id_of(planner):
    return type(planner).__name__ + planner.name


@pytest.mark.parametrize("planner", PLANNERS, ids=id_of)
@pytest.mark.parametrize("other", [{"collision_radius": 10.0}, {"max_acceleration": 1e-3}])
def test_scenarios_of_several_problems_are_refused(planner, other):
    scenario = draw("rings", 0, 3, 0, Problem())
    changed = replace(scenario, problem=replace(Problem(), **other))
    ((name, value),) = other.items()
    with pytest.raises(InputError, match=f"scenarios 0 and 2 have {name} .* and {value}; expected"):
        planner.plan([scenario, scenario, changed])


def test_equal_problems_are_one():
    ends = [draw("rings", 0, n, 0, Problem()) for n in (2, 3)]
    assert [plan.status for plan in solve_many(ends)] == ["solved", "solved"]


@pytest.mark.parametrize("planner", EXACT, ids=id_of)
def test_a_plan_is_the_same_to_the_bit_alone_and_among_others(planner):
    """But those of networks, whose products in single precision are rounded by batch."""
    scenarios = [draw("rings", 1, n, index, Problem()) for index, n in enumerate((2, 3, 1, 6, 20))]
    for scenario, plan in zip(scenarios, planner.plan(scenarios), strict=True):
        (alone,) = planner.plan([scenario])
        assert np.array_equal(plan.controls, alone.controls)
        assert np.array_equal(plan.states, alone.states)
        assert plan.certificate == alone.certificate
