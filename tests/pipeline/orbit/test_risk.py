"""The bound on the risk: never below the truth where that is known, and not far above it."""

import numpy as np
import pytest
from judge import Case
from scipy.integrate import quad
from scipy.stats import multivariate_normal, ncx2, norm
from trials import Errors, frequency, pairs_flown

from pipeline.expert import solve
from pipeline.orbit.problem import Problem
from pipeline.orbit.risk import collision_risk, crossing_rate
from pipeline.orbit.transfer import fly
from pipeline.orbit.uncertainty import Uncertainty
from pipeline.scenario import draw

FREE = Problem(mean_motion=1e-12, time_step=30.0, nodes=11)
"""As good as free space."""


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
    found = collision_risk(*passing(miss, speed), Uncertainty(position=sigma)).total
    assert truth <= found
    assert found <= 2 * truth


@pytest.mark.parametrize("sigmas", [1.0, 3.0])
def test_a_pair_that_nears_on_a_line_is_bounded_by_at_most_its_ends(sigmas):
    """Head on, still apart at the end: the gap is linear in time, so one of its ends is least."""
    problem, speed = FREE, 0.1
    known = Uncertainty(position=0.1, velocity=2e-3)
    at_end = np.hypot(0.1, 2e-3 * problem.duration) * 2**0.5
    initial = np.zeros((2, 6))
    initial[1, 0], initial[1, 3] = 15 + sigmas * at_end + speed * problem.duration, -speed
    controls = np.zeros((2, 10, 3))
    found = collision_risk(fly(initial, controls, problem), controls, problem, known)
    assert found.total == pytest.approx(norm.sf(sigmas), rel=0.02)
    assert found.at_ends[0] == pytest.approx(norm.sf(sigmas), rel=1e-9)


def test_rices_formula_counts_the_crossings_of_a_random_line():
    """x + v t, both Gaussian and correlated, crosses down where it begins above and ends below."""
    mean, slope, end = 1.5, -0.2, 5.0
    covariance = np.array([[1.0, 0.1], [0.1, 0.09]])

    def rate(t):
        move = np.array([[1.0, t], [0.0, 1.0]])
        at = [np.array([x]) for x in (mean + slope * t, slope)]
        return crossing_rate(*at, (move @ covariance @ move.T)[None])[0]

    ends = np.array([[-1.0, 0.0], [1.0, end]])  # both below 0: begins above, ends below
    below = multivariate_normal(ends @ [mean, slope], ends @ covariance @ ends.T)
    assert quad(rate, 0, end)[0] == pytest.approx(below.cdf([0, 0]), rel=1e-6)


def test_the_bound_is_the_mean_number_of_passages_in_trials():
    """Down-crossings are counted in trials, so that covariances, formula and quadrature are all
    held against something else, on both sides."""
    problem, errors, trials = Problem(), Errors(0.2, 2e-4, 0.01), 6000
    scenario = draw("rings", 0, 10, 1, problem, "valid")
    plan = solve(scenario)
    uncertainty = Uncertainty(errors.position, errors.velocity, errors.thrust, errors.thrust)
    risk = collision_risk(plan.states, plan.controls, problem, uncertainty)
    case = Case(problem.mean_motion, problem.time_step, problem.nodes, problem.collision_radius)
    flown = pairs_flown(case, scenario.initial, plan.controls, errors, trials, 0, within=60.0)
    passages = sum(pair.passages(case.radius) for pair in flown)
    error = passages.std() / trials**0.5
    assert passages.mean() > 0.5
    assert risk.of_pair.sum() == pytest.approx(passages.mean(), abs=3.5 * error)


def test_a_pair_planned_too_close_counts_in_full_and_one_far_away_not_at_all():
    uncertainty = Uncertainty(position=0.1)
    assert collision_risk(*passing(14.9, 1.0), uncertainty).total == 1.0
    far = collision_risk(*passing(200.0, 1.0), uncertainty)
    assert (len(far.first), far.total) == (0, pytest.approx(0, abs=1e-11))
    exact = collision_risk(*passing(15.1, 1.0), Uncertainty())
    assert exact.total == pytest.approx(0, abs=1e-11)
    alone = np.zeros((1, 11, 6)), np.zeros((1, 10, 3)), FREE
    assert collision_risk(*alone, uncertainty).total == 0.0


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
    found = collision_risk(states, controls, problem, Uncertainty(magnitude=0.02, direction=0.02))
    moved = [0.05 * 20**2 * 2.5, 0.025 * 20**2 * 1.5, 0.025 * 20**2 / 2]
    last = norm.sf(1.0 / (0.02 * np.linalg.norm(moved)))
    assert found.at_ends.tolist() == [pytest.approx(last, rel=1e-6)]
    case = Case(problem.mean_motion, problem.time_step, problem.nodes, 15.0)
    hits = frequency(case, initial, controls, Errors(0, 0, 0.02), 4000)
    assert last * 0.8 < hits / 4000 < found.total * 1.2
    assert found.total < 2 * last
