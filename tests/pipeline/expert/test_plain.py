"""The plain SCP: its programs against HiGHS, its plans against numpy, its memory against none."""

from functools import cache
from itertools import combinations

import cvxpy as cp
import numpy as np
import pytest
from scipy.optimize import linprog

from benchmarks.peers import SwarmModel
from pipeline.errors import InputError
from pipeline.expert import solve
from pipeline.expert.plain import MARGIN, UNIT, PlainScp
from pipeline.expert.seeds import decoupled_seed, line_seed
from pipeline.orbit.dynamics import cw_matrices
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import fly
from pipeline.plan.requirements import Requirements
from pipeline.scenario import draw

N = 8
SCENARIOS = [draw("rings", 0, N, k, Problem()) for k in range(4)]


@pytest.fixture(scope="module")
def scp():
    return PlainScp(N, Problem())


@pytest.fixture(scope="module")
def plans(scp):
    """Plans of the scenarios from a kind of seed, or from none."""
    return cache(lambda make: [scp.solve(s, make and make(s)) for s in SCENARIOS])


def rolled_out(initial, controls, problem):
    """Positions at the nodes by stepping Eq. 2: (n, T, 3)."""
    A, B = cw_matrices(problem.mean_motion, problem.time_step)
    states = [initial]
    for t in range(problem.intervals):
        states.append(states[-1] @ A.T + controls[:, t] @ B.T)
    return np.stack(states, axis=1)[..., :3]


def first_program_by_highs(scenario, seed):
    """Least fuel with every pair apart along its direction in the seed: a dense linear program."""
    problem, n = scenario.problem, scenario.n
    m, unit = 3 * problem.intervals, 1e-3
    A, B = cw_matrices(problem.mean_motion, problem.time_step)
    drift, reach = [np.eye(6)], [np.zeros((6, m))]
    for t in range(problem.intervals):
        step = A @ reach[-1]
        step[:, 3 * t : 3 * t + 3] += B
        drift.append(A @ drift[-1])
        reach.append(step)
    size = np.linalg.norm(reach[-1], axis=1)[:, None]
    goals = np.kron(np.eye(n), unit * reach[-1] / size)
    miss = ((scenario.goal - scenario.initial @ drift[-1].T) / size.T).ravel()
    rows, least = [], []
    for t in range(1, problem.nodes - 1):
        for i, j in combinations(range(n), 2):
            gap = seed[i, t, :3] - seed[j, t, :3]
            normal = gap / np.linalg.norm(gap)
            row = np.zeros((n, m))
            row[i] = unit * normal @ reach[t][:3]
            row[j] = -row[i]
            free = normal @ drift[t][:3] @ (scenario.initial[i] - scenario.initial[j])
            rows.append(row.ravel())
            least.append(problem.collision_radius + MARGIN - free)
    rows = np.array(rows)
    found = linprog(
        np.ones(2 * n * m),
        A_ub=-np.hstack([rows, -rows]),
        b_ub=-np.array(least),
        A_eq=np.hstack([goals, -goals]),
        b_eq=miss,
    )
    assert found.success
    return found.fun * unit


@pytest.mark.parametrize("make", [decoupled_seed, line_seed])
def test_its_first_program_has_the_optimum_that_highs_finds(scp, make, monkeypatch):
    scenario = SCENARIOS[1]
    monkeypatch.setattr("pipeline.expert.plain.MAX_ROUNDS", 1)
    plan = scp.solve(scenario, make(scenario))
    assert plan.convex_solves == 1
    exact = first_program_by_highs(scenario, make(scenario))
    assert plan.certificate.fuel == pytest.approx(exact, rel=1e-5)


@pytest.mark.parametrize("make", [None, line_seed, decoupled_seed])
def test_its_plans_obey_the_dynamics_reach_the_goal_and_are_clear_at_every_node(plans, make):
    for scenario, plan in zip(SCENARIOS, plans(make), strict=True):
        assert plan.status == "solved"
        position = rolled_out(scenario.initial, plan.controls, scenario.problem)
        assert np.abs(position[:, -1] - scenario.goal[:, :3]).max() < 1e-6
        for i, j in combinations(range(N), 2):
            assert np.linalg.norm(position[i] - position[j], axis=1).min() > 15.0


def test_a_plan_does_not_depend_on_what_was_solved_before(plans):
    again = plans(line_seed)[2]
    fresh = PlainScp(N, Problem()).solve(SCENARIOS[2], line_seed(SCENARIOS[2]))
    np.testing.assert_array_equal(again.controls, fresh.controls)
    assert again.convex_solves == fresh.convex_solves


@pytest.mark.parametrize("limit", [None, 2e-3])
def test_its_programs_have_the_optima_that_cvxpy_finds(limit):
    """The same program as one writes it there, round after round."""
    problem = Problem(max_acceleration=limit)
    scenario, scp = draw("rings", 0, 6, 0, problem), PlainScp(6, problem)
    aim = line_seed(scenario)
    for _ in range(3):
        found = scp._optimum(scenario, aim)
        assert np.abs(found).sum() == pytest.approx(by_cvxpy(scenario, aim), rel=1e-6)
        aim = fly(scenario.initial, found, problem)


def by_cvxpy(scenario, aim):
    """Least fuel with every pair apart along its direction in a trajectory."""
    model = SwarmModel(scenario)
    i, j = np.triu_indices(scenario.n, 1)
    apart = []
    for t, gap in enumerate(model.relative_positions(), start=1):
        normal = aim[i, t, :3] - aim[j, t, :3]
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        along = cp.sum(cp.multiply(normal, gap), axis=1)
        apart.append(along >= scenario.problem.collision_radius + MARGIN)
    program = cp.Problem(model.objective, model.constraints + apart)
    return UNIT * program.solve(solver=cp.CLARABEL)


def test_the_nearer_a_seed_is_to_the_optimum_the_fewer_solves_it_takes(plans):
    def optimal_seed(scenario):
        return solve(scenario, requirements=Requirements("nodes")).states

    optimum, line, blank = (
        np.mean([plan.convex_solves for plan in plans(make)])
        for make in (optimal_seed, line_seed, None)
    )
    assert optimum < line < blank
    assert optimum < 2


def test_a_limit_that_no_transfer_keeps_leaves_the_scenario_unsolved():
    problem = Problem(max_acceleration=1e-5)
    plan = PlainScp(3, problem).solve(draw("rings", 0, 3, 0, problem))
    assert plan.status == "unsolved"
    assert "no plan clear at the nodes after 1 convex solves" in plan.message


def test_a_thrust_limit_is_kept():
    free, limited = (draw("rings", 0, 4, 0, Problem(max_acceleration=a)) for a in (None, 2e-3))
    plan = PlainScp(4, limited.problem).solve(limited, decoupled_seed(limited))
    assert plan.status == "solved"
    assert np.abs(plan.controls).max() <= 2e-3
    assert np.abs(PlainScp(4, Problem()).solve(free, decoupled_seed(free)).controls).max() > 2e-3


def test_one_craft_has_its_own_optimum():
    plan = PlainScp(1, Problem()).solve(draw("rings", 0, 1, 0, Problem()))
    assert plan.status == "solved"
    assert plan.certificate.optimality_gap == pytest.approx(0, abs=1e-6)


def test_scenarios_and_seeds_that_it_was_not_compiled_for_are_refused(scp):
    with pytest.raises(InputError, match="3 craft"):
        scp.solve(draw("rings", 0, 3, 0, Problem()))
    with pytest.raises(InputError, match="time_step=90"):
        scp.solve(draw("rings", 0, N, 0, Problem(time_step=90.0)))
    with pytest.raises(InputError, match="the seed has shape"):
        scp.solve(SCENARIOS[0], line_seed(SCENARIOS[0])[:, :5])
