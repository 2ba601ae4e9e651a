"""What is said to have no plan has none, and what certainly has none is said to."""

from dataclasses import asdict, replace

import numpy as np
import pytest
from judge import judge_plan
from judged import document

from pipeline.expert import solve, solve_many
from pipeline.orbit.dynamics import cw_matrices
from pipeline.orbit.problem import Problem
from pipeline.orbit.rings import pro_states
from pipeline.plan.plan import INFEASIBLE, SOLVED
from pipeline.plan.requirements import Requirements
from pipeline.planners.named import NAMES, named_planner
from pipeline.scenario import Scenario, check, diagnostics, draw
from pipeline.scenario.spacecraft import Spacecraft

MOTION = Problem().mean_motion


def only_flight(scenario):
    """Positions of craft at 2000 times of the one transfer with two controls, solved for here."""
    problem, flown = scenario.problem, []
    A, B = cw_matrices(MOTION, problem.time_step)
    both = np.linalg.solve(
        np.hstack([A @ B, B]), (scenario.goal - scenario.initial @ (A @ A).T).T
    ).T
    middle = scenario.initial @ A.T + both[:, :3] @ B.T
    free, pushed = cw_matrices(MOTION, np.linspace(0, problem.time_step, 1000))
    for states, held in ((scenario.initial, both[:, :3]), (middle, both[:, 3:])):
        flown.append(np.einsum("tij,nj->tni", free[:, :3], states))
        flown[-1] += np.einsum("tij,nj->tni", pushed[:, :3], held)
    return np.concatenate(flown), both


@pytest.mark.parametrize("separation", ["continuous", "nodes"])
def test_with_two_intervals_the_only_controls_are_the_answer(separation):
    problem, found = Problem(nodes=3, time_step=600.0), []
    i, j = np.triu_indices(6, 1)
    for index in range(15):
        scenario = draw("rings", 5, 6, index, problem)
        flown, _ = only_flight(scenario)
        if separation == "nodes":
            flown = flown[[0, 1000, -1]]
        least = np.linalg.norm(flown[:, i] - flown[:, j], axis=-1).min()
        plan = solve(scenario, requirements=Requirements(separation))
        assert plan.status == (SOLVED if least > 15 else INFEASIBLE)
        found.append(plan.status)
    assert set(found) == {SOLVED, INFEASIBLE}


def test_two_intervals_that_act_alike_prove_nothing():
    """Half an orbit apart, cross-track controls act alike, so that other controls may do."""
    scenario = draw("rings", 5, 6, 0, Problem(nodes=3, time_step=np.pi / MOTION))
    assert "no other controls" not in solve(scenario).message


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("end", ["initial", "goal"])
@pytest.mark.parametrize("separation", ["continuous", "nodes"])
def test_a_pair_that_is_too_close_at_an_end_has_no_plan(name, end, separation):
    scenario = draw("rings", 5, 4, 0, Problem())
    states = getattr(scenario, end).copy()
    states[2] = states[1] + [0, 14.9, 0, 0, 0, 0]
    planner = named_planner(name, requirements=Requirements(separation))
    (plan,) = planner.plan([replace(scenario, **{end: states})])
    assert plan.status == INFEASIBLE
    where = {"initial": "start", "goal": "goal"}[end]
    assert f"craft 1 and 2 are 14.9 m apart at the {where}" in plan.message


@pytest.mark.parametrize("name", [name for name in NAMES if name != "refiner"])  # which refuses it
def test_a_goal_that_no_thrust_reaches_has_no_plan(name):
    """In whole orbits a constant control changes nothing cross-track."""
    problem = Problem(time_step=2 * np.pi / MOTION, nodes=4)
    initial = pro_states(100.0, 0.0, np.array([0.0, 2.0]), 0.0, MOTION)
    goal = pro_states(100.0, 0.1, np.array([0.0, 2.0]), 0.0, MOTION)
    (plan,) = named_planner(name).plan([Scenario(problem, initial, goal)])
    assert plan.status == INFEASIBLE
    assert "cannot reach its goal with any thrust" in plan.message


@pytest.mark.parametrize("name", NAMES)
def test_a_craft_that_its_thrust_limit_keeps_from_its_goal_has_no_plan(name):
    scenario = draw("rings", 5, 3, 0, Problem(max_acceleration=1e-5))
    (plan,) = named_planner(name).plan([scenario])
    assert plan.status == INFEASIBLE
    assert "cannot reach its goal within max_acceleration" in plan.message


@pytest.mark.parametrize("until", [1200.0, 1070.0])  # burns in no interval, or in the last alone
def test_a_craft_that_may_not_burn_enough_is_said_to_miss_by_what_its_drift_does(until):
    """By the state transition of Clohessy and Wiltshire in closed form."""
    problem = Problem()
    windows = Spacecraft(), Spacecraft(no_burn=((0.0, until),)), Spacecraft()
    scenario = replace(draw("rings", 5, 3, 0, problem), craft=windows)
    n, (x, y, z, vx, vy, vz) = MOTION, scenario.initial[1]
    s, c, t = np.sin(n * problem.duration), np.cos(n * problem.duration), problem.duration
    there = [
        (4 - 3 * c) * x + s / n * vx + 2 / n * (1 - c) * vy,
        6 * (s - n * t) * x + y - 2 / n * (1 - c) * vx + (4 * s / n - 3 * t) * vy,
        c * z + s / n * vz,
    ]
    apart = np.linalg.norm(there - scenario.goal[1, :3])
    assert solve(scenario).message.startswith(
        "craft 1 cannot reach its goal with any thrust, however large, in the intervals in which "
        f"it may burn, which is proven; by drift it misses by {apart:.4g} m and "
    )
    (case,) = (one for found in diagnostics(scenario) for one in found.cases if "drift" in one.text)
    assert case.craft == (1,)
    assert case.numbers["drift_miss"] == pytest.approx(apart, rel=1e-9)
    assert f"; by drift it misses by {apart:.4g} m" in case.text
    short = replace(windows[1], delta_v=0.01, no_burn=((0.0, 800.0),))  # it lacks Δv, not time
    plan = solve(replace(scenario, craft=(windows[0], short, windows[2])))
    assert plan.status == INFEASIBLE
    limited = "within its limits of thrust and delta_v, in the intervals in which it may burn"
    assert plan.message == f"craft 1 cannot reach its goal {limited}, which is proven"


def test_what_keeps_a_craft_from_its_goal_is_told_of_its_own_scenario_alone():
    short, coasting = Spacecraft(delta_v=1e-6), Spacecraft(no_burn=((0.0, Problem().duration),))
    drawn = draw("rings", 5, 3, 0, Problem())
    both = [replace(drawn, craft=(one,) * 3) for one in (short, coasting)]
    together = [plan.message for plan in solve_many(both)]
    assert together == [solve(one).message for one in both]
    assert ["burn" in message for message in together] == [False, True]
    assert ["delta_v" in message for message in together] == [True, False]


@pytest.mark.parametrize("beyond", [1e-7, 1e-6, 1e-4])
@pytest.mark.parametrize("end", ["initial", "goal"])
def test_ends_that_are_barely_apart_are_fine_and_solved(beyond, end):
    scenario = draw("rings", 5, 4, 0, Problem())
    states = getattr(scenario, end).copy()
    states[2] = states[1] + [0, 15 + beyond, 0, 0, 0, 0]
    scenario = replace(scenario, **{end: states})
    check(scenario)
    plan = solve(scenario)
    assert plan.status == SOLVED
    report = judge_plan(document(scenario), asdict(plan))
    assert 15 < report.min_separation <= 15 + beyond + 1e-9
    assert 15 < plan.certificate.min_separation_bound <= 15 + beyond + 1e-9
