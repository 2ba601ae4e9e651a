"""Least change against Clarabel's solution of the same quadratic program."""

import cvxpy as cp
import numpy as np
import pytest

from benchmarks.rule import LEAST_CHANGE, rule
from pipeline.networks.refiner.model import problem_data
from pipeline.networks.refiner.programs import sides_of
from pipeline.orbit.problem import Problem
from pipeline.scenario import draw

PROBLEM = Problem()


@pytest.fixture
def programs():
    """Own optima of ten craft, and six planes between neighbours that ask a little too much."""
    scenario = draw("rings", 0, 10, 0, PROBLEM, "valid")
    data = problem_data(PROBLEM, scenario.initial[None], scenario.goal[None], np.array([15.0]))
    rng = np.random.default_rng(0)
    pair = np.array([[0, 1], [0, 2], [1, 0], [3, 4], [0, 3], [4, 1]])
    gain = rng.normal(size=(6, data.grid.reach.shape[1]))
    gain /= np.linalg.norm(gain, axis=1, keepdims=True)
    now = np.stack([(gain * data.own.controls[craft]).sum(axis=1) for craft in pair.T], axis=1)
    now[:, 1] *= -1
    return data, pair, gain, now + rng.uniform(-0.5, 1.0, size=(6, 2))


def test_it_is_the_nearest_controls_that_meet_goal_and_planes(programs):
    data, pair, gain, asked = programs
    sides = sides_of(pair)
    controls, dual = LEAST_CHANGE.optima(data.own, sides, gain, asked, data.grid)
    for k, craft in enumerate(sides.craft.tolist()):
        own, goal = data.own.controls[craft], data.grid.reach[-6:]
        rows = [(-1) ** side * gain[p] for p, side in np.argwhere(pair == craft).tolist()]
        wanted = [float(asked[p, side]) for p, side in np.argwhere(pair == craft).tolist()]
        u = cp.Variable(len(own))
        rules = [goal @ u == goal @ own, np.array(rows) @ u >= np.array(wanted)]
        cp.Problem(cp.Minimize(cp.sum_squares(u - own)), rules).solve(solver=cp.CLARABEL)
        assert controls[k] == pytest.approx(u.value, abs=1e-6)
    assert (dual > 0).any()
    assert (dual == 0).any()


def test_what_asks_nothing_changes_nothing(programs):
    data, pair, gain, asked = programs
    sides = sides_of(pair)
    controls, dual = LEAST_CHANGE.optima(data.own, sides, gain, asked - 10, data.grid)
    assert np.array_equal(controls, data.own.controls[sides.craft])
    assert (dual == 0).all()


def test_rounds_in_the_null_space_are_safe_and_dearer():
    some = [draw("rings", 0, 10, k, PROBLEM, "valid") for k in range(40)]
    fuel = {}
    for null_space in (False, True):
        plans = rule(10, null_space).plan(some)
        assert sum(plan.status == "solved" for plan in plans) >= 39
        fuel[null_space] = sum(plan.certificate.fuel for plan in plans)
    assert 1.003 * fuel[False] < fuel[True] < 1.03 * fuel[False]
