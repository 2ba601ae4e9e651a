"""The bound on the risk: never below the truth where that is known, and not far above it."""

import numpy as np
import pytest
from judge import Case
from scipy.stats import ncx2, norm
from trials import Errors, frequency, pairs_flown, wilson

from pipeline.expert import solve
from pipeline.orbit.covariance import Uncertainty, dispersion
from pipeline.orbit.problem import Problem
from pipeline.orbit.risk import collision_risk
from pipeline.orbit.transfer import fly
from pipeline.scenario import draw

FREE = Problem(mean_motion=1e-12, time_step=30.0, nodes=11)
"""As good as free space."""


def risk_of(states, controls, problem, uncertainty):
    """The risk in open loop."""
    return collision_risk(states, controls, problem, dispersion(controls, problem, uncertainty))


def passing(miss, speed, problem=FREE):
    """Two craft that pass each other at a constant speed, half way through."""
    half = problem.duration / 2
    initial = np.array([[0.0] * 6, [-speed * half, miss, 0, speed, 0, 0]])
    controls = np.zeros((2, problem.intervals, 3))
    return fly(initial, controls, problem), controls, problem


@pytest.mark.parametrize("speed", [0.3, 1.0, 20.0])
@pytest.mark.parametrize("sigmas", [0.5, 2.0, 3.1, 4.0])
@pytest.mark.parametrize("sigma", [0.001, 0.2, 1.0])
def test_a_pass_in_a_straight_line_is_bounded_by_at_most_twice_its_probability(
    sigma, sigmas, speed
):
    """The offset across the velocity is a Gaussian in the plane, so that its square is a
    noncentral chi-square; each craft errs by sigma, the pair by sqrt(2) of it."""
    deviation = sigma * 2**0.5
    miss = 15 + sigmas * deviation
    truth = ncx2.cdf((15 / deviation) ** 2, 2, (miss / deviation) ** 2)
    found = risk_of(*passing(miss, speed), Uncertainty(position=sigma)).total
    assert truth <= found
    assert found <= 2 * truth


@pytest.mark.parametrize("sigma", [0.3, 1.0, 20.0])
def test_a_pair_that_comes_near_by_a_jump_at_a_node_is_not_overlooked(sigma):
    """A nonlinear flight is not at the node to which linear motion from the last one leads."""
    deviation = sigma * 2**0.5
    states, controls, problem = passing(15 + 6 * deviation, 0.0)
    states[1, 5, 1] = 15 + deviation
    found = risk_of(states, controls, problem, Uncertainty(position=sigma)).total
    assert found >= ncx2.cdf((15 / deviation) ** 2, 3, (15 / deviation + 1) ** 2)


@pytest.mark.parametrize("sigmas", [1.0, 3.0])
def test_a_pair_that_nears_on_a_line_is_bounded_by_at_most_its_ends(sigmas):
    """Head on, still apart at the end: the gap is linear in time, so one of its ends is least."""
    problem, speed = FREE, 0.1
    known = Uncertainty(position=0.1, velocity=2e-3)
    at_end = np.hypot(0.1, 2e-3 * problem.duration) * 2**0.5
    initial = np.zeros((2, 6))
    initial[1, 0], initial[1, 3] = 15 + sigmas * at_end + speed * problem.duration, -speed
    controls = np.zeros((2, 10, 3))
    found = risk_of(fly(initial, controls, problem), controls, problem, known)
    assert found.total == pytest.approx(norm.sf(sigmas), rel=0.02)
    assert found.at_ends[0] == pytest.approx(norm.sf(sigmas), rel=1e-9)


@pytest.mark.parametrize("tilt", [0.003, 0.03, 1.0])
@pytest.mark.parametrize("along", [0.0, 1.0])
@pytest.mark.parametrize(("speed", "nodes"), [((0, 0.5, 0), 11), ((0, 0.5, 0), 6), ((-3, 4, 0), 6)])
def test_errors_in_one_direction_alone_are_not_overlooked(tilt, along, speed, nodes):
    """A burn errs in size alone, and that nearly across the line of sight at 150 s: a pass, half a
    pass, or craft that still near each other at the end. One normal variable decides."""
    problem = Problem(mean_motion=1e-15, time_step=30.0, nodes=nodes)
    share, burn = 0.1, np.array([tilt, along, 1 - along]) * tilt / 400
    controls = np.zeros((2, nodes - 1, 3))
    controls[1, 0] = burn
    sigma = share * burn[0] * (30**2 / 2 + 30 * 120)  # along the line of sight
    near, initial = np.array([15 + 3 * sigma, 0, 0]), np.zeros((2, 6))
    initial[1, 3:] = speed - burn * 30
    initial[1, :3] = near - 150 * np.array(speed) + burn * 30**2 / 2
    states = fly(initial, controls, problem)
    assert states[1, 5] == pytest.approx([*near, *speed], abs=1e-8)

    xi = np.linspace(-9, 9, 180_001)
    erring = share * xi[:, None] * burn
    place, moving = states[1, 1, :3] + erring * 30**2 / 2, states[1, 1, 3:] + erring * 30
    when = np.clip(-np.vecdot(place, moving) / np.vecdot(moving, moving), 0, 30 * (nodes - 2))
    near = np.linalg.norm(place + when[:, None] * moving, axis=1) < 15
    truth = norm.pdf(xi)[near].sum() * 1e-4
    found = risk_of(states, controls, problem, Uncertainty(magnitude=share)).total
    assert truth > 1e-4
    assert truth * 0.999 <= found <= 1.1 * truth


@pytest.mark.parametrize("seed", range(6))
def test_the_bound_holds_for_covariances_of_any_shape(seed):
    """Random burns that err in size or in direction, against trials in closed form."""
    rng = np.random.default_rng(seed)
    problem, trials = FREE, 200_000
    controls = np.zeros((2, 10, 3))
    controls[1, 0] = rng.normal(size=3) * 2e-3
    sizes = (0.1, 0.0) if seed % 2 else (0.02, 0.002)
    initial = np.zeros((2, 6))
    initial[1, 3:] = rng.normal(size=3) * 0.1
    states = fly(initial, controls, problem)
    speed = states[1, 5, 3:]
    side = np.cross(speed, rng.normal(size=3))
    initial[1, :3] = 15.3 * side / np.linalg.norm(side) - states[1, 5, :3]
    states = fly(initial, controls, problem)
    found = risk_of(states, controls, problem, Uncertainty(0.0, 0.0, *sizes)).total
    size = np.linalg.norm(controls[1, 0])
    axes = np.linalg.svd(controls[1, :1])[2]  # along the burn, and two across it
    erring = (rng.normal(size=(trials, 3)) * [sizes[0], sizes[1], sizes[1]]) @ axes * size
    place, speed = states[1, 1, :3] + erring * 30**2 / 2, states[1, 1, 3:] + erring * 30
    when = np.clip(-np.vecdot(place, speed) / np.vecdot(speed, speed), 0, 270)
    hits = int((np.linalg.norm(place + when[:, None] * speed, axis=1) < 15).sum())
    lower, upper = wilson(hits, trials)
    assert lower <= found
    assert found <= 3 * upper


def test_the_bound_is_between_collisions_and_passages_in_trials():
    """A bound by the planned line of sight is the mean number of passages through its plane."""
    problem, errors, parts, trials = Problem(), Errors(0.2, 2e-4, 0.01), 15, 400
    scenario = draw("rings", 0, 10, 1, problem, "valid")
    plan = solve(scenario)
    uncertainty = Uncertainty(errors.position, errors.velocity, errors.thrust, errors.thrust)
    risk = risk_of(plan.states, plan.controls, problem, uncertainty)
    case = Case(problem.mean_motion, problem.time_step, problem.nodes, problem.collision_radius)
    passages, collisions = [], []
    for seed in range(parts):  # as many trials as a processor holds
        ends = scenario.initial, plan.controls
        flown = list(pairs_flown(case, *ends, errors, trials, seed, within=30.0))
        passages.extend(sum(pair.passages(case.radius) for pair in flown))
        collisions.extend(sum(pair.least() < case.radius for pair in flown))
    passages, collisions = np.array(passages), np.array(collisions)
    error = passages.std() / (parts * trials) ** 0.5
    assert collisions.mean() > 0.5
    assert collisions.mean() - 3.5 * error <= risk.of_pair.sum() <= passages.mean() + 3.5 * error


def test_a_pair_planned_too_close_counts_in_full_and_one_far_away_not_at_all():
    uncertainty = Uncertainty(position=0.1)
    assert risk_of(*passing(14.9, 1.0), uncertainty).total == 1.0
    far = risk_of(*passing(200.0, 1.0), uncertainty)
    assert (len(far.first), far.total) == (0, pytest.approx(0, abs=1e-11))
    exact = risk_of(*passing(15.1, 1.0), Uncertainty())
    assert exact.total == pytest.approx(0, abs=1e-11)
    alone = np.zeros((1, 11, 6)), np.zeros((1, 10, 3)), FREE
    assert risk_of(*alone, uncertainty).total == 0.0


def test_thrust_errors_alone_are_enough_to_bring_craft_together():
    """A craft stops 16 m from another by burns whose errors are the only ones."""
    problem = Problem(mean_motion=1e-12, time_step=20.0, nodes=6)
    initial = np.zeros((2, 6))
    initial[1, 0], initial[1, 3] = 76.0, -1.0
    controls = np.zeros((2, 5, 3))
    controls[1, 2, 0] = 0.05  # from 36 m at 40 s to rest at 26 m
    controls[1, 3, 0], controls[1, 4, 0] = -0.025, 0.025  # and 10 m further, to rest
    states = fly(initial, controls, problem)
    assert states[1, -1] == pytest.approx([16.0, 0, 0, 0, 0, 0], abs=1e-6)
    found = risk_of(states, controls, problem, Uncertainty(magnitude=0.02, direction=0.02))
    moved = [0.05 * 20**2 * 2.5, 0.025 * 20**2 * 1.5, 0.025 * 20**2 / 2]
    last = norm.sf(1.0 / (0.02 * np.linalg.norm(moved)))
    assert found.at_ends.tolist() == [pytest.approx(last, rel=1e-6)]
    case = Case(problem.mean_motion, problem.time_step, problem.nodes, 15.0)
    hits = frequency(case, initial, controls, Errors(0, 0, 0.02), 4000)
    assert last * 0.8 < hits / 4000 < found.total * 1.2
    assert found.total < 2 * last
