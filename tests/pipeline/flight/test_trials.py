"""Trials against exact answers: no errors, and probabilities that are known in closed form."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi, ncx2

from pipeline.errors import InputError
from pipeline.expert import solve
from pipeline.figures.intervals import wilson
from pipeline.flight.errors import Errors, draws
from pipeline.flight.loops import TrialSettings, flight_loops
from pipeline.flight.montecarlo import fly_all
from pipeline.flight.trials import fly_trials, open_loop
from pipeline.flight.world import Conditions, LinearWorld, world_of
from pipeline.orbit.problem import Problem
from pipeline.orbit.thrust import Thrust
from pipeline.orbit.thrust_cost import cost
from pipeline.parallel.workers import Workers
from pipeline.planners.as_flown import AsFlown
from pipeline.planners.classical import Expert
from pipeline.scenario import Scenario, draw
from pipeline.scenario.spacecraft import Spacecraft

STRAIGHT = Problem(mean_motion=1e-12, time_step=100.0, nodes=5, collision_radius=15.0)
"""So slow an orbit that motion is straight, as Gaussian geometry in closed form wants it."""


def flown(scenario, controls, errors, trials=4000, seed=1):
    drawn = draws(seed, range(trials), scenario.n, scenario.problem.intervals)
    world = LinearWorld(scenario.problem.dynamics)
    return fly_trials(scenario, world, open_loop(controls), drawn, errors)


def inside(share, trials, exact):
    low, high = wilson(share, trials)
    return low <= exact <= high


@pytest.fixture(scope="module")
def planned():
    scenario = draw("rings", 0, 8, 3, Problem(), "test")
    return scenario, solve(scenario)


def test_without_errors_a_plan_has_the_numbers_of_its_certificate(planned):
    scenario, plan = planned
    certificate = plan.certificate
    found = flown(scenario, plan.controls, Errors(), trials=3)
    assert found["min_separation"] == pytest.approx(certificate.min_separation, abs=2e-4)
    assert (found["min_separation"] >= certificate.min_separation_bound).all()
    assert (found["first_craft"][0], found["second_craft"][0]) == certificate.min_separation_pair
    assert found["min_separation_time"] == pytest.approx(certificate.min_separation_time, abs=0.1)
    assert found["goal_error"].max() < 1e-9
    assert found["goal_velocity_error"].max() < 1e-12
    assert found["delta_v"] == pytest.approx(certificate.delta_v, rel=1e-12)
    assert not found["missed_burns"].any()


LEGS = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)
THRUSTERS = Thrust(tuple(map(tuple, np.vstack([LEGS, [[1, 0, 0], [-1, 0, 0]]]).tolist())))


def weak(limit):
    """Scenario of three craft with six thrusters each; a limit, m/s², for those of one craft."""
    drawn = draw("rings", 0, 3, 3, Problem(nodes=6), "test")
    craft = Spacecraft(max_acceleration=limit), Spacecraft(), Spacecraft()
    return replace(drawn, problem=replace(drawn.problem, thrust=THRUSTERS), craft=craft)


def test_thrusters_at_their_limits_burn_what_certificates_say():
    scenario = weak(0.005)
    plan = solve(scenario)
    assert plan.status == "solved"
    used = plan.certificate.delta_v
    found = flown(scenario, plan.controls, Errors(), trials=3)["delta_v"]
    assert found == pytest.approx(used, rel=1e-9)
    assert cost(plan.controls, THRUSTERS).sum() * scenario.problem.time_step < 0.999 * used
    errors = Errors(magnitude=0.02, lost=1.0)
    several = flown(scenario, plan.controls, errors, trials=3)["delta_v"]
    assert several[0] == flown(scenario, plan.controls, errors, trials=1)["delta_v"][0]
    assert (several < used).all()


def test_a_folder_refuses_other_limits_of_thrusters(tmp_path):
    scenario, other = weak(0.005), weak(0.006)
    (loop,) = flight_loops(solve(scenario), Errors())
    world = LinearWorld(scenario.problem.dynamics)
    fly_all(tmp_path, TrialSettings(scenario, world, Errors()), [loop], 2, workers=Workers(1))
    with pytest.raises(InputError, match=r"craft_max_acceleration = "):
        fly_all(tmp_path, TrialSettings(other, world, Errors()), [loop], 2, workers=Workers(1))


def test_feedback_that_knows_states_late_leaves_a_plan_as_flown_alone():
    """In a swarm of kilometres, where nonlinear terms are decimetres; there are no errors."""
    drawn = draw("rings", 0, 3, 3, Problem(), "test")
    scenario = replace(drawn, initial=10 * drawn.initial, goal=10 * drawn.goal)
    plan = AsFlown(Expert(), Conditions().orbit(scenario.problem)).plan([scenario])[0]
    world, late = world_of(plan.scenario, Conditions()), Errors(latency=1.0)
    _, loop = flight_loops(plan, late, with_feedback=True)
    found = TrialSettings(plan.scenario, world, late).fly(loop, range(1))
    assert plan.status == "solved"
    assert found["goal_error"][0] < 1e-6
    assert found["delta_v"] == pytest.approx(plan.certificate.delta_v, rel=1e-9)


def pass_by(offset):
    """Two craft that pass each other at right angles to where they are apart."""
    initial = np.array([[0.0, -200.0, 0.0, 0.0, 1.0, 0.0], [offset, 200.0, 0.0, 0.0, -1.0, 0.0]])
    goal = initial.copy()
    goal[:, 1] *= -1
    return Scenario(STRAIGHT, initial, goal), np.zeros((2, 4, 3))


@pytest.mark.parametrize("offset", [12.0, 15.0, 18.0])
def test_one_pair_comes_as_close_as_the_rice_distribution_has_it(offset):
    # Apart at the pass: √(X² + Z²), X normal about the offset, Z about 0, both √2 σ wide.
    scenario, idle = pass_by(offset)
    sigma = 2.0
    apart = flown(scenario, idle, Errors(position=sigma))["min_separation"]
    width = np.sqrt(2) * sigma
    exact = ncx2.cdf((15.0 / width) ** 2, 2, (offset / width) ** 2)
    share = float((apart <= 15.0).mean())
    assert inside(share, len(apart), exact)
    # What would show a model that is off: errors a tenth too large, and craft half a metre nearer.
    wide = flown(scenario, idle, Errors(position=1.1 * sigma))["min_separation"]
    nearer, _ = pass_by(offset - 0.5)
    near = flown(nearer, idle, Errors(position=sigma))["min_separation"]
    off = [float((one <= 15.0).mean()) for one in (wide, near)]
    assert not all(inside(one, len(apart), exact) for one in off)


def test_noise_and_bias_at_the_first_node_add_up():
    scenario, idle = pass_by(15.0)
    apart = flown(scenario, idle, Errors(position=1.2, position_bias=1.6))["min_separation"]
    width = np.sqrt(2) * 2.0
    exact = ncx2.cdf((15.0 / width) ** 2, 2, (15.0 / width) ** 2)
    assert inside(float((apart <= 15.0).mean()), len(apart), exact)


def burning():
    """One craft with two burns whose errors, as large along as across, are a ball."""
    controls = np.zeros((1, 4, 3))
    controls[0, 0], controls[0, 2] = [3e-3, 0.0, -4e-3], [0.0, 2e-3, 0.0]
    initial = np.array([[0.0, 0.0, 0.0, 0.1, 0.0, 0.0]])
    world = LinearWorld(STRAIGHT.dynamics)
    state = initial
    for k in range(4):
        state = world.arc(state, controls[:, k], k)[:, -1, -1]
    return Scenario(STRAIGHT, initial, state), controls


ALL = Errors(
    position=0.5,
    velocity=1e-3,
    magnitude=0.03,
    direction=0.03,
    magnitude_fixed=2e-3,
    direction_fixed=2e-3,
)


def exact_miss():
    """Standard deviation of each component of the miss at the goal: sums of squares."""
    size, until_end = np.array([5e-3, 2e-3]) * 100, np.array([350.0, 150.0])  # from mid-burn
    burns = np.hypot(0.03 * size, 2e-3) * until_end
    return np.sqrt(0.5**2 + (1e-3 * 400) ** 2 + (burns**2).sum())


@pytest.mark.parametrize("quantile", [0.1, 0.5, 0.9])
def test_the_miss_at_the_goal_is_as_the_sum_of_all_errors_has_it(quantile):
    scenario, controls = burning()
    bound = chi(3).ppf(quantile) * exact_miss()
    miss = flown(scenario, controls, ALL)["goal_error"]
    assert inside(float((miss <= bound).mean()), len(miss), quantile)
    stronger = flown(scenario, controls, replace(ALL, magnitude=0.036, direction=0.036))[
        "goal_error"
    ]
    assert not inside(float((stronger <= bound).mean()), len(miss), quantile)


def test_the_model_of_late_burns_shifts_the_end_by_the_delay_times_the_burns():
    scenario, controls = burning()
    drawn = draws(0, range(500), 1, 4)
    world = LinearWorld(STRAIGHT.dynamics)
    found = fly_trials(scenario, world, open_loop(controls), drawn, Errors(timing=0.5))
    # Straight motion: each burn's whole effect comes τ later, so the end lacks Δv τ.
    lag = 0.5 * drawn.lag[:, [0, 2], 0]
    exact = np.linalg.norm(100 * lag @ controls[0, [0, 2]], axis=1)
    assert found["goal_error"] == pytest.approx(exact, rel=1e-6, abs=1e-9)
    assert found["goal_velocity_error"].max() < 1e-12


def test_a_missed_burn_leaves_the_craft_where_it_would_be_without():
    scenario, controls = burning()
    found = flown(scenario, controls, Errors(missed=1.0), trials=2)
    free = scenario.initial[0, :3] + 400 * scenario.initial[0, 3:]
    assert found["goal_error"] == pytest.approx(np.linalg.norm(scenario.goal[0, :3] - free))
    assert found["missed_burns"].tolist() == [2, 2]
    assert found["delta_v"].tolist() == [0.0, 0.0]
    assert np.isinf(found["min_separation"]).all()  # there is no pair
