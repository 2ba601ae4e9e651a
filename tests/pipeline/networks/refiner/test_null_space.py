"""Least change against Clarabel's solution of the same quadratic program."""

import cvxpy as cp
import numpy as np
import pytest
import torch

from pipeline.networks.refiner.null_space import optimum
from pipeline.networks.refiner.rounds import begin
from pipeline.networks.refiner.sides import sides_of
from pipeline.networks.swarms import swarms
from pipeline.orbit.problem import Problem
from pipeline.planners.rule import Rule
from pipeline.scenario import draw

PROBLEM = Problem()


@pytest.fixture
def programs():
    """Own optima of ten craft, and six planes between neighbours that ask a little too much."""
    scenario = draw("rings", 0, 10, 0, PROBLEM, "valid")
    task = begin(swarms(PROBLEM, scenario.initial[None], scenario.goal[None]))
    rng = np.random.default_rng(0)
    pair = torch.tensor([[0, 1], [0, 2], [1, 0], [3, 4], [0, 3], [4, 1]])
    gain = torch.from_numpy(rng.normal(size=(6, task.grid.reach.shape[1])))
    gain /= torch.linalg.vector_norm(gain, dim=1, keepdim=True)
    now = torch.stack([(gain * task.own.controls[craft]).sum(dim=1) for craft in pair.T], dim=1)
    now[:, 1] *= -1
    return task, pair, gain, now + torch.from_numpy(rng.uniform(-0.5, 1.0, size=(6, 2)))


def test_it_is_the_nearest_controls_that_meet_goal_and_planes(programs):
    task, pair, gain, asked = programs
    sides = sides_of(pair, 10)
    controls, price = optimum(task.own, sides, gain, asked, task.grid)
    for k, craft in enumerate(sides.craft.tolist()):
        own, goal = task.own.controls[craft].numpy(), task.grid.to_goal.numpy()
        rows = [(-1) ** side * gain[p].numpy() for p, side in (pair == craft).nonzero().tolist()]
        wanted = [float(asked[p, side]) for p, side in (pair == craft).nonzero().tolist()]
        u = cp.Variable(len(own))
        rules = [goal @ u == goal @ own, np.array(rows) @ u >= np.array(wanted)]
        cp.Problem(cp.Minimize(cp.sum_squares(u - own)), rules).solve(solver=cp.CLARABEL)
        assert controls[k].numpy() == pytest.approx(u.value, abs=1e-6)
    assert (price > 0).any()
    assert (price == 0).any()


def test_what_asks_nothing_changes_nothing(programs):
    task, pair, gain, asked = programs
    sides = sides_of(pair, 10)
    controls, price = optimum(task.own, sides, gain, asked - 10, task.grid)
    assert torch.equal(controls, task.own.controls[sides.craft])
    assert (price == 0).all()


def test_rounds_in_the_null_space_are_safe_and_dearer():
    some = [draw("rings", 0, 10, k, PROBLEM, "valid") for k in range(40)]
    fuel = {}
    for null_space in (False, True):
        plans = Rule(10, null_space).plan(some)
        assert sum(plan.status == "solved" for plan in plans) >= 39
        fuel[null_space] = sum(plan.certificate.fuel for plan in plans)
    assert 1.003 * fuel[False] < fuel[True] < 1.03 * fuel[False]
