"""Scenarios of several problems are refused by whatever plans many at once."""

from dataclasses import replace

import pytest

from benchmarks.fallback import rule
from pipeline.errors import InputError
from pipeline.expert import solve_many
from pipeline.orbit.problem import Problem
from pipeline.planners.goal_assignment import GoalAssignment
from pipeline.planners.named import NAMES, named_planner
from pipeline.scenario import draw

PLANNERS = [*map(named_planner, NAMES), GoalAssignment(named_planner("expert")), rule(2)]


@pytest.mark.parametrize("planner", PLANNERS, ids=lambda one: type(one).__name__ + one.name)
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
