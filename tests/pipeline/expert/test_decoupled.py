"""Decoupled optima against HiGHS, and the bound that their dual variables prove."""

import numpy as np
import pytest
from judge import exact_step
from scipy.optimize import linprog

from pipeline.expert import decoupled_optima, solve
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import fly
from pipeline.scenario import draw


def by_highs(initial, goal, problem):
    """Least ‖u‖₁ of each craft by HiGHS, with maps from matrix exponentials."""
    A, B = exact_step(problem.mean_motion, problem.time_step)
    power = [np.linalg.matrix_power(A, k) for k in range(problem.nodes)]
    reach = np.hstack([power[problem.intervals - 1 - k] @ B for k in range(problem.intervals)])
    scale, unit = 1 / np.linalg.norm(reach, axis=1), 1e-4
    limit = None if problem.max_acceleration is None else problem.max_acceleration / unit
    optima = []
    for s0, s1 in zip(initial, goal, strict=True):
        block = reach * scale[:, None] * unit
        found = linprog(
            np.ones(2 * reach.shape[1]),
            A_eq=np.hstack([block, -block]),
            b_eq=(s1 - power[-1] @ s0) * scale,
            bounds=(0, limit),
        )
        optima.append(found.fun * unit if found.status == 0 else np.nan)
    return np.array(optima)


@pytest.mark.parametrize(
    "problem",
    [
        Problem(),
        Problem(time_step=60.0, nodes=31),
        Problem(time_step=570.0, nodes=21),
        Problem(max_acceleration=7e-4),
    ],
    ids=["reference", "fine grid", "two orbits", "thrust limit"],
)
def test_fuel_and_bound_are_the_optimum_of_highs(problem):
    scenario = draw("rings", 1, 8, 0, problem)
    optima = decoupled_optima(scenario.initial, scenario.goal, problem)
    exact = by_highs(scenario.initial, scenario.goal, problem)
    assert (optima.feasible == np.isfinite(exact)).all()
    can = optima.feasible
    assert can.any()
    fuel = np.abs(optima.controls).sum(axis=(1, 2))
    assert fuel[can] == pytest.approx(exact[can], rel=1e-6)
    assert optima.lower_bound[can] == pytest.approx(exact[can], rel=1e-6)
    assert (optima.lower_bound[can] <= exact[can] * (1 + 1e-9)).all()


def test_decoupled_optima_meet_their_goals_within_the_thrust_limit():
    problem = Problem(max_acceleration=7e-4)
    scenario = draw("rings", 1, 8, 0, problem)
    optima = decoupled_optima(scenario.initial, scenario.goal, problem)
    final = fly(scenario.initial, optima.controls, problem)[:, -1]
    assert final == pytest.approx(scenario.goal, abs=1e-9)
    assert np.abs(optima.controls[optima.feasible]).max() <= problem.max_acceleration


def test_a_craft_that_has_only_to_drift_needs_no_fuel():
    problem = Problem()
    start = draw("rings", 0, 2, 0, problem).initial
    goal = fly(start, np.zeros((2, 10, 3)), problem)[:, -1]
    optima = decoupled_optima(start, goal, problem)
    assert np.abs(optima.controls).sum() < 1e-9
    assert optima.lower_bound == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize(
    ("limit", "proof"),
    [(None, "by table"), (1.0, "by table"), (7e-4, "multipliers"), (1e-6, "by table")],
)
def test_a_plan_says_how_its_bound_is_proven(limit, proof):
    """Where a limit binds a program proves more than the table; where none can fly it cannot."""
    scenario = draw("rings", 0, 10, 0, Problem(max_acceleration=limit))
    free = draw("rings", 0, 10, 0, Problem())
    certificate = solve(scenario).certificate
    assert proof in certificate.fuel_lower_bound_proof
    least = by_highs(free.initial, free.goal, free.problem).sum()
    if proof == "by table":
        assert certificate.fuel_lower_bound == pytest.approx(least, rel=1e-6)
    else:
        assert certificate.fuel_lower_bound > least * (1 + 1e-4)
