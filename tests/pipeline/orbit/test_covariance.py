"""Covariances: free space by hand, an orbit by trials, a bound over each interval."""

import numpy as np
import pytest
from judge import Case, fly
from trials import Errors, drawn

from pipeline.orbit.covariance import (
    Uncertainty,
    burn_covariance,
    dispersion,
    standard_deviation,
)
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import fly as flown

FREE = Problem(mean_motion=1e-12, time_step=10.0, nodes=4)
"""As good as free space, where a push of 10 s moves a craft by hand's arithmetic."""


def test_position_errors_in_free_space_are_those_by_hand():
    """Pushes of 0.2 along x in the first 10 s and 0.1 along y in the last, m/s²."""
    controls = np.zeros((1, 3, 3))
    controls[0, 0, 0], controls[0, 2, 1] = 0.2, 0.1
    spread = dispersion(controls, FREE, Uncertainty(0.3, 0.02, 0.05, 0.01))
    found = spread.covariance[..., :6, :6]
    known = 0.3**2 + (30 * 0.02) ** 2
    first, last = 0.2 * (50 + 10 * 20), 0.1 * 50  # what the pushes move, m
    expected = [
        known + (0.05 * first) ** 2 + (0.01 * last) ** 2,
        known + (0.01 * first) ** 2 + (0.05 * last) ** 2,
        known + (0.01 * first) ** 2 + (0.01 * last) ** 2,
    ]
    assert np.diag(found[0, 3])[:3] == pytest.approx(expected, rel=1e-9)
    moving = 30 * 0.02**2 + 0.05**2 * first * 2.0 + 0.01**2 * last * 1.0
    assert found[0, 3, 0, 3] == pytest.approx(moving, rel=1e-9)
    assert np.diag(found[0, 0]) == pytest.approx(np.repeat([0.3**2, 0.02**2], 3), rel=1e-9)


def test_a_burn_errs_in_size_along_it_and_in_direction_across_it():
    burn, problem = np.array([[[3.0, 0.0, 4.0]]]), Problem()
    ((found,),) = burn_covariance(burn, problem, Uncertainty(magnitude=0.02, direction=0.03))
    axes = np.array([[0.6, 0, 0.8], [0, 1, 0], [-0.8, 0, 0.6]])
    assert axes @ found @ axes.T == pytest.approx(np.diag([0.1, 0.15, 0.15]) ** 2, abs=1e-12)
    assert (burn_covariance(np.zeros((1, 1, 3)), problem, Uncertainty(magnitude=0.02)) == 0).all()


def test_covariances_of_a_transfer_are_those_of_many_trials():
    problem, rng = Problem(), np.random.default_rng(0)
    controls = 1e-3 * rng.normal(size=(2, 10, 3))
    spread = dispersion(controls, problem, Uncertainty(0.2, 3e-4, 0.02, 0.02))
    found = spread.covariance[..., :6, :6]
    trials, errors = 20000, Errors(0.2, 3e-4, 0.02)
    starts, pushes = drawn(np.zeros((2, 6)), controls, errors, trials, rng)
    case = Case(problem.mean_motion, problem.time_step, problem.nodes, 15.0)
    states = fly(case, starts.reshape(-1, 6), pushes.reshape(-1, 10, 3)).reshape(trials, 2, 11, 6)
    for craft, node in ((0, 4), (1, 10)):
        seen = np.cov(states[:, craft, node].T)
        scale = np.sqrt(np.outer(np.diag(seen), np.diag(seen)))
        assert found[craft, node] / scale == pytest.approx(seen / scale, abs=5 / trials**0.5)


def test_no_deviation_within_an_interval_is_above_its_bound():
    problem, rng = Problem(time_step=600.0, nodes=5), np.random.default_rng(1)
    controls = 1e-3 * rng.normal(size=(3, 4, 3))
    spread = dispersion(controls, problem, Uncertainty(0.2, 3e-4, 0.05, 0.01))
    most = spread.deviation_bound(problem)
    within = np.zeros_like(most)
    craft, interval = (one.ravel() for one in np.indices(most.shape))
    for offset in np.linspace(0, 600, 41):
        A, B = problem.dynamics.step(np.full(len(craft), offset))
        covariance = spread.covariance[craft, interval]
        axes = np.concatenate([A[:, :3], B[:, :3]], axis=2).swapaxes(0, 1)
        mean_square = sum(standard_deviation(axis, covariance) ** 2 for axis in axes)
        within = np.maximum(within, np.sqrt(mean_square).reshape(within.shape))
    assert (within <= most).all()
    assert (most < 2 * within).all()


def test_errors_do_not_depend_on_where_a_craft_is():
    """The motion is linear: what a state and a burn err by moves as a state and a burn do."""
    problem, controls = Problem(), np.full((1, 10, 3), 1e-3)
    spread = dispersion(controls, problem, Uncertainty(magnitude=0.1))
    alone = np.zeros((10, 10, 3))
    alone[range(10), range(10)] = 1e-3
    each = flown(np.zeros((10, 6)), alone, problem)[:, -1]  # by the burn of one interval
    assert (spread.covariance[0, 0, :6, :6] == 0).all()
    wanted = 0.01 * each.T @ each
    scale = np.sqrt(np.outer(np.diag(wanted), np.diag(wanted)))
    found = spread.covariance[0, 10, :6, :6]
    assert found == pytest.approx(wanted, rel=1e-9, abs=1e-9 * scale.min())
