"""Feedback about a plan: what it corrects, and what is left of errors, held against trials."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from judge import Case, exact_step
from trials import Errors, corrected

from pipeline.flight import errors as flown_errors
from pipeline.flight.trials import feedback, fly_trials
from pipeline.flight.world import LinearWorld
from pipeline.orbit.covariance import Uncertainty, dispersion
from pipeline.orbit.feedback import HORIZON, feedback_gains
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.orbit.risk import collision_risk
from pipeline.orbit.transfer import fly
from pipeline.scenario import Scenario

PROBLEM = Problem()
CASE = Case(PROBLEM.mean_motion, PROBLEM.time_step, PROBLEM.nodes, PROBLEM.collision_radius)
TRIALS = 20_000


@pytest.fixture(scope="module")
def flown():
    """Two craft with large burns, corrected in many trials."""
    rng = np.random.default_rng(3)
    initial, controls = 100 * rng.normal(size=(2, 6)), 1e-3 * rng.normal(size=(2, 10, 3))
    initial[:, 3:] *= 1e-3
    states = fly(initial, controls, PROBLEM)
    trials = corrected(CASE, states, controls, Errors(0.2, 3e-4, 0.02), TRIALS, 1)
    return states, controls, trials


def test_what_is_left_of_corrected_errors_may_underflow():
    with np.errstate(all="raise"):
        problem = replace(PROBLEM, nodes=60, time_step=600.0)
        flown = dispersion(np.zeros((2, 59, 3)), problem, Uncertainty(0.05, 5e-4), closed_loop=True)
        assert np.all(flown.deviation_bound(problem) > 0)


def test_a_deviation_is_gone_after_two_intervals_where_these_are_left():
    problem = replace(PROBLEM, nodes=4)
    A, B = exact_step(problem.mean_motion, problem.time_step)
    gains = feedback_gains(problem)
    off = np.array([1.0, -2.0, 0.5, 1e-3, 2e-3, -1e-3])
    off = (A + B @ gains[1]) @ off
    assert np.abs((A + B @ gains[2]) @ off).max() < 1e-9


@pytest.mark.parametrize("step", [30.0, 120.0, 900.0])
def test_feedback_is_stable_over_many_orbits(step):
    problem = Problem(time_step=step, nodes=200)
    A, B = exact_step(problem.mean_motion, step)
    off = np.eye(6)
    within = int(np.ceil(2 * HORIZON * 2 * np.pi / problem.mean_motion / step)) + 2
    for gain in feedback_gains(problem)[: 3 * within]:
        off = (A + B @ gain) @ off
    assert np.abs(off[:3]).max() < 1.0


def test_covariances_are_those_of_trials(flown):
    _, controls, (nodes, asked, _) = flown
    spread = dispersion(controls, PROBLEM, Uncertainty(0.2, 3e-4, 0.02, 0.02), closed_loop=True)
    for craft, node in ((0, 1), (1, 4), (0, 10)):
        seen = np.cov(nodes[:, craft, node].T)
        scale = np.sqrt(np.outer(np.diag(seen), np.diag(seen)))
        found = spread.covariance[craft, node, :6, :6]
        assert found / scale == pytest.approx(seen / scale, abs=5 / TRIALS**0.5)
    for craft, interval in ((0, 1), (1, 9)):
        seen = np.cov(asked[:, craft, interval].T)
        scale = np.sqrt(np.outer(np.diag(seen), np.diag(seen)))
        found = spread.correction_covariance[craft, interval]
        assert found / scale == pytest.approx(seen / scale, abs=5 / TRIALS**0.5)


def test_state_and_control_err_together(flown):
    """What is flown answers to the state that it begins from."""
    _, controls, (nodes, _, made) = flown
    spread = dispersion(controls, PROBLEM, Uncertainty(0.2, 3e-4, 0.02, 0.02), closed_loop=True)
    both = np.concatenate([nodes[:, 0, 5], made[:, 0, 5]], axis=1)
    seen = np.cov(both.T)
    scale = np.sqrt(np.outer(np.diag(seen), np.diag(seen)))
    assert spread.covariance[0, 5] / scale == pytest.approx(seen / scale, abs=5 / TRIALS**0.5)


def test_what_corrections_cost_and_how_often_they_meet_the_limit_is_what_trials_show(flown):
    states, controls, (_, asked, _) = flown
    limit = float(np.quantile(np.abs(asked).max(axis=(1, 2, 3)), 0.99))
    problem = replace(PROBLEM, max_acceleration=limit)
    risk = collision_risk(states, controls, problem, Uncertainty(0.2, 3e-4, 0.02, 0.02), True)
    # What is asked for is right on average, so that its share along the plan's adds nothing.
    added = (np.abs(asked) - np.sign(controls) * asked).sum(axis=(1, 2, 3))
    assert risk.corrections == pytest.approx(added.mean(), rel=0.05)
    assert 0.007 < risk.saturation < 0.02
    assert risk.total >= risk.saturation


@dataclass(frozen=True)
class Watched(LinearWorld):
    """A linear world that remembers the states that intervals begin from."""

    starts: list = field(default_factory=list)

    def arc(self, states, controls, interval):
        self.starts.append(states)
        return super().arc(states, controls, interval)


FIXED = {"position": 0.05, "velocity": 5e-4, "magnitude_fixed": 2e-4, "direction_fixed": 2e-4}
BIASED = {"position_bias": 0.3, "velocity_bias": 1e-4} | {
    "magnitude_bias": 0.05,
    "direction_bias": 0.03,
}
FILTERED = {"position": 0.5, "velocity": 5e-4, "semi_major_axis": 0.2, "navigation_time": 400.0}


@pytest.mark.parametrize(
    ("orbit", "sizes"),
    [
        (None, FIXED | BIASED),
        ("eccentric", FIXED | BIASED),
        (None, FILTERED),
        (None, FILTERED | {"latency": 1.0}),
    ],
)
def test_errors_of_every_kind_spread_a_flight_as_they_are_said_to(orbit, sizes):
    """About an ellipse, too, where gains differ from node to node."""
    problem = PROBLEM
    if orbit:
        problem = PROBLEM.about(ReferenceOrbit(1.2e7, 0.4, j2=False))
    errors = flown_errors.Errors(magnitude=0.02, direction=0.02, **sizes)
    rng = np.random.default_rng(5)
    controls = 3e-4 * rng.normal(size=(1, 10, 3))
    states = fly(np.zeros((1, 6)), controls, problem)
    scenario = Scenario(problem, states[:, 0], states[:, -1], "tried", "tried")
    drawn = flown_errors.draws(0, range(6000), 1, 10)
    guide = feedback(controls, states, problem)
    world = Watched(problem.dynamics)
    fly_trials(scenario, world, guide, drawn, errors)
    spread = dispersion(controls, problem, errors.gaussian(problem.time_step), closed_loop=True)
    for node in (1, 3, 9):
        seen, found = np.cov(world.starts[node].T), spread.covariance[0, node, :6, :6]
        scale = np.sqrt(np.outer(np.diag(seen), np.diag(seen)))
        assert found / scale == pytest.approx(seen / scale, abs=0.08)


def test_without_errors_nothing_is_corrected():
    controls = np.full((2, 10, 3), 1e-3)
    spread = dispersion(controls, PROBLEM, Uncertainty(), closed_loop=True)
    assert not spread.covariance.any()
    assert not spread.correction_covariance.any()
