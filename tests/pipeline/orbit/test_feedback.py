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


def test_errors_that_are_gone_have_standard_deviations():
    """Two intervals after a burn its error is corrected but for rounding, which has either sign."""
    problem, controls = replace(PROBLEM, nodes=61, time_step=600.0), np.zeros((1, 60, 3))
    controls[0, 1, 0] = 0.01
    with np.errstate(invalid="raise"):
        flown = dispersion(controls, problem, Uncertainty(magnitude=0.02), closed_loop=True)
        assert np.isfinite(flown.correction_sigma).all()
        assert np.isfinite(flown.deviation_bound(problem)).all()


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
    spread = dispersion(controls, problem, Uncertainty(0.2, 3e-4, 0.02, 0.02), closed_loop=True)
    risk = collision_risk(states, controls, problem, spread)
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


def flown_with(problem, late, bias, noise, burns):
    """Deviations with flown controls (T, 9), and corrections, of a closed-loop flight."""
    gains, intervals = feedback_gains(problem), problem.intervals
    state, before, joint, corrections = -bias - noise[0], np.zeros(6), [], []
    for k in range(intervals):
        A, B = problem.dynamics.step(problem.time_step, k)
        estimate = state + bias + noise[k]
        correction = gains[k] @ (before if late else estimate)
        joint.append([*state, *(correction + burns[k])])
        corrections.append(correction)
        before = A @ estimate + B @ correction
        state = A @ state + B @ (correction + burns[k])
    return np.array([*joint, [*state, 0, 0, 0]]), np.array(corrections)


def summed(flights):
    """Covariances as sums over flights, each with one error of one standard deviation."""
    joint, corrections = (np.stack(one, axis=-1) for one in zip(*flights, strict=True))
    return joint @ joint.mT, corrections @ corrections.mT


@pytest.mark.parametrize("late", [False, True])
@pytest.mark.parametrize("orbit", [None, ReferenceOrbit(1.2e7, 0.4, 0.5)])
def test_covariances_are_sums_over_flights_with_one_error_each(orbit, late):
    problem, K = PROBLEM.about(orbit) if orbit else PROBLEM, 10
    controls = 3e-4 * np.random.default_rng(6).normal(size=(1, K, 3))
    errors = Uncertainty(**FIXED | BIASED, magnitude=0.02, direction=0.03, latency=float(late))
    errors = replace(errors, navigation_time=400.0)
    deviation = np.repeat([[0.3, 1e-4], [0.05, 5e-4]], 3, axis=1)
    lag = np.abs(np.subtract.outer(np.arange(K), np.arange(K))) * problem.time_step / 400.0
    memory = np.linalg.cholesky(np.exp(-lag))
    none = np.zeros(6), np.zeros((K, 6)), np.zeros((K, 3))
    flights = [(axis * deviation[0], *none[1:]) for axis in np.eye(6)]
    for axis in np.eye(6):
        flights += [(none[0], np.outer(m, axis * deviation[1]), none[2]) for m in memory.T]
    flights += [(*none[:2], 0.05 * controls[0])]
    flights += [(*none[:2], 0.03 * np.cross(axis, controls[0])) for axis in np.eye(3)]
    corrections = np.zeros((K, 3, 3))
    for _ in range(2):  # burns err by what is planned, and then by what corrections add to that
        square = np.einsum("ki,kj->kij", controls[0], controls[0]) + corrections
        size = np.trace(square, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        fixed = (2e-4 / problem.time_step) ** 2 * np.eye(3)
        root = np.linalg.cholesky(0.02**2 * square + 0.03**2 * (size - square) + fixed)
        burns = np.zeros((K, 3, K, 3))
        burns[range(K), :, range(K)] = root.mT
        each = flights + [(*none[:2], one) for one in burns.reshape(-1, K, 3)]
        joint, corrections = summed([flown_with(problem, late, *one) for one in each])
    spread = dispersion(controls, problem, errors, closed_loop=True)
    for found, wanted in (
        (spread.covariance[0], joint),
        (spread.correction_covariance[0], corrections),
    ):
        sigma = np.sqrt(np.diagonal(wanted, axis1=1, axis2=2))
        scale = np.where(sigma > 0, sigma, 1.0)
        scale = scale[:, None] * scale[:, :, None]
        assert found / scale == pytest.approx(wanted / scale, abs=1e-9)


def test_without_errors_nothing_is_corrected():
    controls = np.full((2, 10, 3), 1e-3)
    spread = dispersion(controls, PROBLEM, Uncertainty(), closed_loop=True)
    assert not spread.covariance.any()
    assert not spread.correction_covariance.any()
