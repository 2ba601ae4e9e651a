"""Transfers just within a thrust limit and just beyond it, of whatever size that is."""

import numpy as np
import pytest

from pipeline.orbit.decoupled import minimum_limits
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import fly
from pipeline.plan.plan import INFEASIBLE, SOLVED
from pipeline.planners.named import NAMES, named_planner
from pipeline.scenario import Scenario


@pytest.mark.parametrize("limit", [1e-12, 1e-9, 1e-6, 1e-3])
def test_planners_agree_on_what_a_thrust_limit_allows(limit):
    """Goals that take 0.9 and 1.1 of the limit, by a linear program: the expert plans for the
    first, proves that none can for the second, and no planner claims that it does."""
    rng, problem = np.random.default_rng(0), Problem(max_acceleration=limit)
    initial = np.zeros((2, 6))
    initial[:, 1] = 0.0, 500.0
    for _ in range(3):
        controls = rng.uniform(-1, 1, size=(2, problem.intervals, 3))
        goal = fly(initial, controls, problem)[:, -1] - initial
        controls /= minimum_limits(initial, initial + goal, problem).max()
        scenarios = [
            Scenario(problem, initial, fly(initial, share * limit * controls, problem)[:, -1])
            for share in (0.9, 1.1)
        ]
        assert [p.status for p in named_planner("expert").plan(scenarios)] == [SOLVED, INFEASIBLE]
        for name in NAMES:
            (plan,) = named_planner(name).plan(scenarios[1:])
            assert plan.status != SOLVED, name
