"""Decoupled optima against HiGHS, and the bound that their dual variables prove."""

from dataclasses import replace
from math import pi

import numpy as np
import pytest
from judge import exact_step
from scipy.optimize import linprog

from pipeline.expert import decoupled_optima, solve
from pipeline.expert.conic_decoupled import Duals, dual_bounds
from pipeline.expert.decoupled import minimum_fuel
from pipeline.orbit.decoupled import facets_of, minimum_fuel_by_table
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.orbit.rings import pro_states
from pipeline.orbit.thrust import Thrust
from pipeline.orbit.transfer import fly, transfer_maps
from pipeline.scenario import draw
from pipeline.scenario.spacecraft import limits_of
from pipeline.scenario.state_constraints import state_constraints


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


OBLATE = ReferenceOrbit(7.2e6, 0.02, inclination_deg=51.6, argument_of_perigee_deg=40.0)


def changes(problem, count=12):
    """Changes of state that transfers of some 100 m bring about; the last is none at all."""
    size = np.repeat([100.0, 100.0 / problem.duration], 3)
    miss = np.random.default_rng(4).normal(size=(count, 6)) * size
    miss[-2, 2:], miss[-1] = 0.0, 0.0
    return miss


def by_scaled_program(miss, problem):
    """Least ‖u‖₁ of one change of state by HiGHS' interior points."""
    reach = transfer_maps(problem).reach[-1]
    scale = 1 / np.linalg.norm(reach, axis=1)
    block = reach * scale[:, None]
    unit = np.abs(np.linalg.pinv(block) @ (miss * scale)).max()
    equal = np.hstack([block, -block])
    goal = miss * scale / unit
    found = linprog(np.ones(equal.shape[1]), A_eq=equal, b_eq=goal, method="highs-ipm")
    return found.fun * unit


def test_on_a_fine_grid_about_an_orbit_programs_take_the_place_of_a_table():
    """All motion is coupled there, and the hull of a hundred intervals has a million facets."""
    problem = Problem(time_step=12.0, nodes=101).about(OBLATE)
    assert facets_of(problem) is None
    miss = changes(problem)
    found = minimum_fuel(miss, problem)
    assert found.exact.all()
    exact = [by_scaled_program(one, problem) for one in miss[:-1]]
    assert found.bound[:-1] == pytest.approx(exact, rel=1e-6)
    assert found.bound[-1] == 0 and (found.controls[-1] == 0).all()
    final = fly(np.zeros(miss.shape), found.controls, problem)[:, -1]
    assert final == pytest.approx(miss, abs=1e-9 * np.abs(miss).max())


def test_programs_and_table_find_the_same_bases(monkeypatch):
    problem = Problem().about(OBLATE)
    miss = changes(problem)[:-2]  # of the others several bases are optimal
    table = minimum_fuel_by_table(miss, problem)
    monkeypatch.setattr("pipeline.expert.decoupled.minimum_fuel_by_table", lambda *_: None)
    found = minimum_fuel(miss, problem)
    assert (np.sort(found.basis) == np.sort(table.basis)).all()
    assert found.controls == pytest.approx(table.controls, abs=1e-12)
    assert found.bound == pytest.approx(table.bound, rel=1e-9)
    for k in range(len(miss)):
        alone = minimum_fuel(miss[k : k + 1], problem)
        assert (alone.controls[0] == found.controls[k]).all()  # to the bit, whatever is beside it


def test_where_a_state_is_out_of_reach_there_are_no_programs_either():
    period = 2 * pi / Problem().mean_motion
    assert minimum_fuel(np.ones((1, 6)), Problem(time_step=period / 2, nodes=3)) is None
    assert minimum_fuel(np.ones((1, 6)), Problem(nodes=3).about(OBLATE)) is not None


def test_rounding_of_what_no_control_changes_costs_no_fuel():
    """Burns of half an orbit change z by 2 (u₂ - u₁) / e², at |Δz| e²/2; others are fixed."""
    e = Problem().mean_motion
    problem, phase = Problem(time_step=pi / e, nodes=3), np.array([0.0, pi])
    initial = pro_states(150.0, 0.35, phase, 0.0, e)
    goal = pro_states(250.0, 0.0, phase + 0.9, 0.0, e)
    A, B = exact_step(e, pi / e)
    plane = np.ix_([0, 1, 3, 4], [0, 1, 3, 4])
    change = (goal - initial @ (A @ A).T)[:, [0, 1, 3, 4]]
    burns = np.linalg.solve(np.hstack([A @ B, B])[plane], change.T)
    fuel = np.abs(burns).sum(axis=0) + np.abs(initial[:, 2]) * e**2 / 2
    found = decoupled_optima(initial, goal, problem)
    assert found.lower_bound == pytest.approx(fuel, rel=1e-6)
    assert np.abs(found.controls).sum(axis=(1, 2)) == pytest.approx(fuel, rel=1e-6)


def test_rounding_of_a_drift_is_no_proof_of_fuel_where_controls_have_no_effect():
    """With steps of half an orbit controls do not change vz, whose dual variable is then free."""
    problem = Problem(nodes=5, thrust=Thrust("norm"))
    problem = replace(problem, time_step=np.pi / problem.mean_motion)
    initial = np.array([[100.0, 200.0, 50.0, 0.1, -0.2, 0.1]])
    goal = fly(initial, np.zeros((1, 4, 3)), problem)[:, -1]
    at = replace(state_constraints(initial, goal, problem, {}), miss=np.full((1, 6), 1e-13))
    y = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 1e9]])
    along = (y @ at.reach).reshape(1, 4, 3)
    assert np.linalg.norm(along, axis=2).max() < 1  # dual feasible
    duals = Duals(np.vecdot(y, at.miss), along, 0 * along, np.abs(y) @ at.rounding)
    assert dual_bounds(duals, limits_of((), 1, problem), problem) == 0.0
