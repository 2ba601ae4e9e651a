"""What is found wrong with a scenario, and by how much, against independent computations."""

from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest
from judge import exact_step
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from pipeline.errors import InputError
from pipeline.expert import decoupled_optima
from pipeline.orbit.decoupled import minimum_limits
from pipeline.orbit.problem import Problem
from pipeline.orbit.rings import pro_states
from pipeline.scenario import Scenario, diagnostics, draw
from pipeline.scenario.spacecraft import Spacecraft
from pipeline.scenario.waypoint import Waypoint

E = Problem().mean_motion
ORBIT = 2 * np.pi / E

A = np.zeros((6, 6))  # Eq. 1 as a first-order system
A[:3, 3:] = np.eye(3)
A[3, 0], A[3, 4], A[4, 3], A[5, 2] = 3 * E**2, 2 * E, -2 * E, -(E**2)


def drifted(state, times):
    """Free drift by numerical integration, (times, 6)."""
    return solve_ivp(
        lambda _, s: A @ s, (0, times[-1]), state, t_eval=times, rtol=1e-10, atol=1e-9
    ).y.T


def wrong(scenario):
    return {(one.end, one.rule): one.cases for one in diagnostics(scenario) if not one.fine}


def test_a_draw_is_fine_in_every_respect():
    found = diagnostics(draw("rings", 0, 6, 0, Problem(max_acceleration=5e-3)))
    assert all(one.fine for one in found)
    assert len(found) == 8


@pytest.mark.parametrize(
    ("size", "hours"), [(200.0, 264), (30_000.0, 1 / 3)], ids=["eleven days", "thirty km"]
)
def test_a_linear_model_that_is_off_by_more_than_the_collision_radius_is_said(size, hours):
    problem = Problem(nodes=41, time_step=hours * 90.0)
    ends = [pro_states(a, 0.0, np.array([0.0, 1.5]), 0.0, E, 0.0) for a in (size, 0.5 * size)]
    found = wrong(Scenario(problem, *ends))
    (case,) = found.pop(("transfer", "linear model"))
    assert not found
    assert case.numbers["curvature"] + case.numbers["oblateness"] > 100


def test_all_that_is_wrong_is_found_at_once():
    drawn = draw("rings", 0, 5, 0, Problem(max_acceleration=1e-5))
    initial, goal = drawn.initial.copy(), drawn.goal.copy()
    initial[3, :3] = initial[1, :3] + [3, 0, 4]
    goal[2, 4] += 0.02
    found = wrong(replace(drawn, initial=initial, goal=goal))
    assert found[("initial", "craft apart")][0].craft == (1, 3)
    assert found[("initial", "craft apart")][0].numbers["distance"] == pytest.approx(5)
    assert [case.craft for case in found[("initial", "energy-matched")]] == [(3,)]
    assert [case.craft for case in found[("goal", "energy-matched")]] == [(2,)]
    assert {case.craft for case in found[("transfer", "within reach")]} >= {(0,), (4,)}


def test_the_drift_of_an_orbit_is_what_an_integrator_finds_and_the_cure_stops_it():
    drawn = draw("rings", 1, 3, 0, Problem())
    goal = drawn.goal.copy()
    goal[1, 4] -= 0.004
    (case,) = wrong(replace(drawn, goal=goal))[("goal", "energy-matched")]
    moved = drifted(goal[1], np.array([0, ORBIT]))[-1] - goal[1]
    assert case.numbers["drift_per_orbit"] == pytest.approx(moved[1], rel=1e-5)
    goal[1, 4] = case.numbers["vy_wanted"]
    assert drifted(goal[1], np.array([0, ORBIT]))[-1] == pytest.approx(goal[1], abs=1e-4)


def test_who_comes_how_close_in_free_drift_and_when_is_what_an_integrator_finds():
    """Two craft on rings of other tilt and centre, far apart at first, that pass closely."""
    one = pro_states(200.0, 0.3, np.array([0.0]), 0.0, E)
    other = pro_states(190.0, -0.3, np.array([0.4]), 0.0, E, 90.0)
    away = pro_states(100.0, 0.0, np.array([0.0]), 0.0, E, 2000.0)
    states = np.concatenate([one, away, other])
    problem = Problem(collision_radius=60.0)
    found = wrong(Scenario(problem, states, states))
    assert set(found) == {("initial", "passively safe"), ("goal", "passively safe")}
    (case,) = found[("goal", "passively safe")]
    times = np.linspace(0, ORBIT, 20001)
    apart = np.linalg.norm(drifted((one - other)[0], times)[:, :3], axis=1)
    assert apart[0] > problem.collision_radius
    assert case.craft == (0, 2)
    assert case.numbers["distance"] == pytest.approx(apart.min(), abs=1e-3)
    assert case.numbers["time"] == pytest.approx(times[apart.argmin()], abs=1.0)


@pytest.mark.parametrize("nodes", [4, 11])
def test_the_least_thrust_limit_is_that_of_cvxpy(nodes):
    problem = Problem(nodes=nodes, time_step=90.0)
    drawn = draw("independent", 2, 4, 0, problem)
    free, pushed = exact_step(problem.mean_motion, problem.time_step)
    least = []
    for start, end in zip(drawn.initial, drawn.goal, strict=True):
        u, state = cp.Variable((problem.intervals, 3)), start
        for k in range(problem.intervals):
            state = free @ state + pushed @ u[k]
        weight = np.array([1, 1, 1, 1e3, 1e3, 1e3])  # velocities on the scale of positions
        arrive = [cp.multiply(weight, state) == weight * end]
        scaled = cp.Problem(cp.Minimize(1e4 * cp.norm_inf(cp.vec(u, order="C"))), arrive)
        least.append(scaled.solve(solver=cp.CLARABEL) / 1e4)
    assert minimum_limits(drawn.initial, drawn.goal, problem) == pytest.approx(least, rel=1e-4)


@pytest.mark.parametrize(("share", "enough"), [(1 - 2e-7, True), (1 - 5e-6, False)])
def test_a_limit_below_the_least_by_rounding_is_enough_for_check_as_for_plans(share, enough):
    drawn = draw("rings", 4, 1, 0, Problem())
    (least,) = minimum_limits(drawn.initial, drawn.goal, drawn.problem)
    problem = Problem(max_acceleration=share * least)
    assert (("transfer", "within reach") not in wrong(replace(drawn, problem=problem))) == enough
    found = decoupled_optima(drawn.initial, drawn.goal, problem)
    assert found.impossible[0] == (not enough)


def test_the_expert_flies_within_the_limit_that_is_asked_for_and_proves_that_less_is_too_little():
    drawn = draw("rings", 4, 5, 0, Problem(max_acceleration=1e-6))
    cases = wrong(drawn)[("transfer", "within reach")]
    assert len(cases) == 5
    for case in cases:
        (k,), least = case.craft, case.numbers["least_limit"]
        ends = drawn.initial[[k]], drawn.goal[[k]]
        asked = float(case.text.split("at least ")[1].split(" m/s")[0])
        for enough in (asked, least):
            assert decoupled_optima(*ends, Problem(max_acceleration=enough)).feasible[0]
        assert decoupled_optima(*ends, Problem(max_acceleration=least * 0.999)).impossible[0]


def test_a_craft_that_stays_on_its_orbit_needs_no_thrust():
    problem = Problem()
    start = pro_states(200.0, 0.3, np.array([0.1]), 0.0, E)
    end = pro_states(200.0, 0.3, np.array([0.1 + E * problem.duration]), 0.0, E)
    assert minimum_limits(start, end, problem) == pytest.approx(0, abs=1e-15)


def test_a_waypoint_far_away_counts_for_the_linear_model():
    drawn = draw("rings", 0, 2, 0, Problem())
    far = replace(drawn, waypoints=[Waypoint(1, (0.0, -3e4, 4e4))])
    (case,) = wrong(far)[("transfer", "linear model")]
    assert case.numbers["reach"] == pytest.approx(5e4)


@pytest.mark.parametrize("place", [((0.0, 0.0, 7e5), None), ((0.0, 9.0, 0.0), (0.0, 0.0, 1e7))])
def test_a_waypoint_where_the_linear_model_has_no_meaning_is_refused(place):
    drawn = draw("rings", 0, 2, 0, Problem())
    with pytest.raises(InputError, match=r"waypoints\[0\] reaches .* 10% of the reference orbit's"):
        replace(drawn, waypoints=[Waypoint(1, *place)])


def test_near_whole_periods_least_limit_and_delta_v_are_those_of_the_only_control():
    """Two intervals have a unique solution; near whole periods its equations are near singular."""
    drawn = draw("rings", 0, 3, 0, Problem())
    for off, close in ((0.1, 1e-4), (1.0, 1e-6)):
        problem = Problem(time_step=ORBIT + off, nodes=3)
        block = np.block([[A, np.eye(6, 3, -3)], [np.zeros((3, 9))]])
        step = expm(block * problem.time_step)
        drift, push = step[:6, :6], step[:6, 6:]
        change = drawn.goal.T - drift @ drift @ drawn.initial.T
        only = np.linalg.solve(np.hstack([drift @ push, push]), change)
        found = minimum_limits(drawn.initial, drawn.goal, problem)
        assert found == pytest.approx(np.abs(only).max(axis=0), rel=close)
        budget = replace(drawn, problem=problem, craft=[Spacecraft(delta_v=1.0)] * 3)
        cases = wrong(budget)[("transfer", "within reach")]
        needed = np.abs(only).sum(axis=0) * problem.time_step
        for case in cases:
            assert case.numbers["least_delta_v"] == pytest.approx(needed[case.craft[0]], rel=close)
        assert len(cases) == 3
    problem = Problem(time_step=ORBIT + 0.01, nodes=4)
    assert (minimum_limits(drawn.initial, drawn.goal, problem) > 1e4).all()


def test_a_time_grid_on_which_no_thrust_arrives_is_said_to_be_one():
    """Thrust held for a whole orbit moves z not at all: its effect ∫ sin e(T-t) dt is 0."""
    start = pro_states(200.0, 0.3, np.array([0.0]), 0.0, E)
    end = start.copy()
    end[0, 5] += 0.05
    problem = Problem(time_step=ORBIT, nodes=3)
    scenario = Scenario(problem, start, end)
    (case,) = wrong(scenario)[("transfer", "within reach")]
    assert "cannot reach its goal, however large its thrust" in case.text
    assert not case.numbers
    (said,) = (found for found in diagnostics(scenario) if found.rule == "within reach")
    assert "max_acceleration" not in said.cure, "which no limit mends"
