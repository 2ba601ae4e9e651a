"""The filter of estimates, held against least squares and against how far it is off in trials."""

from dataclasses import replace

import numpy as np
import pytest
from judge import exact_step

from pipeline.flight.errors import PRESETS, Errors
from pipeline.flight.estimation import Filter
from pipeline.orbit.covariance import Uncertainty, navigation_roots
from pipeline.orbit.problem import Problem

PROBLEM = Problem()
H = PROBLEM.time_step
A, B = exact_step(PROBLEM.mean_motion, H)
TRIALS = 2000
NOISELESS = dict.fromkeys(("position", "velocity", "semi_major_axis"), 0.0)


def drifted(errors, rng, controls, trials=TRIALS, start=(80.0, -200.0, 40.0, 0.0, -0.18, 0.02)):
    """True states (nodes, trials, 6) of a craft whose burns err, and estimates of them.

    Written out here anew: Gates's errors across and along a burn, biases of its thrusters, errors
    of navigation with a memory.
    """
    noise, bias = navigation_roots(errors, PROBLEM)
    kept = np.exp(-H / errors.navigation_time) if errors.navigation_time else 0.0
    offset, memory = rng.normal(size=(trials, 6)) @ bias.T, rng.normal(size=(trials, 6))
    size, turn = rng.normal(size=(trials, 1)), rng.normal(size=(trials, 3))
    state = np.array(start) - offset - memory @ noise.T
    truth, seen = [state], [np.broadcast_to(np.array(start), state.shape)]
    for u in controls:
        length = np.linalg.norm(u)
        unit = u / length if length else np.zeros(3)
        draw = rng.normal(size=(trials, 3))
        along = (draw @ unit)[:, None] * unit
        fixed = errors.magnitude_fixed / H
        off = np.hypot(errors.magnitude * length, fixed) * along
        off = off + np.hypot(errors.direction * length, fixed) * (draw - along)
        made = u + (off if length else 0.0)
        made = made + errors.magnitude_bias * size * u + errors.direction_bias * np.cross(turn, u)
        state = state @ A.T + made @ B.T
        memory = kept * memory + np.sqrt(1 - kept**2) * rng.normal(size=(trials, 6))
        truth.append(state)
        seen.append(state + offset + memory @ noise.T)
    return np.stack(truth), np.stack(seen)


def burns(rng, intervals=8):
    """A transfer's: large ones at both ends, small ones between."""
    sizes = np.array([2e-3, 1e-3, 1e-5, 0.0, 1e-5, 0.0, 1e-3, 2e-3])
    return rng.normal(size=(intervals, 3)) * sizes[:intervals, None]


def filtered(errors, seen, controls):
    """Filtered states (nodes, trials, 6), and their covariances."""
    made, states, covariances = Filter(PROBLEM, errors), [], []
    for node, estimate in enumerate(seen):
        commanded = None
        if node:
            commanded = np.broadcast_to(controls[node - 1], (len(estimate), 1, 3))
        states.append(made(node, estimate[:, None], commanded)[:, 0])
        covariances.append(made.covariance)
    return np.stack(states), np.stack(covariances)


@pytest.mark.parametrize("name", ["cold-gas", "calibrated", "uncalibrated"])
def test_filtered_states_err_as_much_as_the_filter_says_and_less_than_estimates(name):
    rng, errors = np.random.default_rng(1), PRESETS[name].gaussian(H)
    controls = burns(rng)
    truth, seen = drifted(errors, rng, controls)
    states, covariances = filtered(errors, seen, controls)
    for node in range(2, 9):
        off = states[node] - truth[node]
        weighed = np.linalg.solve(covariances[node], off[..., None])[..., 0]
        # Of six components; what the linear model leaves out is expected too, and is not there.
        assert 0.6 < (off * weighed).sum(axis=1).mean() / 6 < 1.06
        raw = seen[node] - truth[node]
        assert (off[:, 3:].std(axis=0) < 1.02 * raw[:, 3:].std(axis=0)).all()
    coasting = states[6] - truth[6], seen[6] - truth[6]
    assert coasting[0][:, [3, 5]].std() < coasting[1][:, [3, 5]].std() / 2


def test_without_errors_of_burns_and_biases_it_is_least_squares_of_all_estimates():
    """Near the reference, where the linear model leaves out nothing."""
    rng, errors = np.random.default_rng(2), Uncertainty(0.05, 5e-4)
    controls = np.zeros((6, 3))
    start = (1e-3, 2e-3, -1e-3, 0.0, 1e-6, 0.0)
    _, seen = drifted(errors, rng, controls, 4, start)
    states, _ = filtered(errors, seen, controls)
    weight = 1 / np.repeat([0.05, 5e-4], 3)
    for node in range(1, 7):
        rows = [np.linalg.matrix_power(A, k) for k in range(node + 1)]
        stacked = np.concatenate([weight[:, None] * row for row in rows])
        values = np.concatenate([weight[:, None] * seen[k].T for k in range(node + 1)])
        first = np.linalg.lstsq(stacked, values, rcond=None)[0]
        wanted = (np.linalg.matrix_power(A, node) @ first).T
        assert (np.abs(states[node] - wanted) < 1e-3 / weight).all()


def test_after_a_missed_burn_the_estimate_counts_alone():
    rng, errors = np.random.default_rng(3), PRESETS["cold-gas"].gaussian(H)
    commanded = burns(rng)
    made = commanded.copy()
    made[1] = 0.0  # 0.1 m/s or so
    _, seen = drifted(errors, rng, made, 50)
    states, covariances = filtered(errors, seen, commanded)
    np.testing.assert_allclose(states[2], seen[2], rtol=0, atol=1e-12)
    known = np.diag(covariances[2][0])[[0, 3]] ** 0.5
    np.testing.assert_allclose(known, [np.hypot(0.05, 0.02), np.hypot(5e-4, 1e-4)], rtol=1e-9)
    assert not np.allclose(states[3], seen[3], rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", ["cold-gas", "electric"])
def test_estimates_with_a_bias_alone_are_filtered_too(name):
    """What is new in them has no more than the three components of a burn's error."""
    rng, errors = np.random.default_rng(6), replace(PRESETS[name].gaussian(H), **NOISELESS)
    controls = burns(rng)
    truth, seen = drifted(errors, rng, controls, 300)
    states, covariances = filtered(errors, seen, controls)
    for node in range(1, 9):
        off, raw = states[node] - truth[node], seen[node] - truth[node]
        expected = np.diagonal(covariances[node], axis1=1, axis2=2).mean(axis=0)
        assert ((off**2).mean(axis=0) < 1.15**2 * expected).all()
        assert (off.std(axis=0) < 1.05 * raw.std(axis=0)).all()


def test_states_that_are_known_exactly_are_left_alone():
    rng, errors = np.random.default_rng(4), Errors(magnitude=0.1).gaussian(H)
    controls = burns(rng)
    truth, seen = drifted(errors, rng, controls, 5)
    states, covariances = filtered(errors, seen, controls)
    assert np.array_equal(states, truth)
    assert not covariances.any()


def test_late_estimates_are_filtered_as_what_they_are():
    """Of the node before, carried on by what was commanded since; the last burn's error is new."""
    rng = np.random.default_rng(5)
    errors = Uncertainty(0.05, 5e-4, 0.02, 0.02, latency=1.0)
    controls = burns(rng)
    truth, seen = drifted(errors, rng, controls)
    carried = np.concatenate([seen[:1], seen[:-1] @ A.T + (controls @ B.T)[:, None]])
    states, covariances = filtered(errors, carried, controls)
    for node in range(2, 9):
        known = truth[node - 1] @ A.T + controls[node - 1] @ B.T
        off = states[node] - known
        weighed = np.linalg.solve(covariances[node], off[..., None])[..., 0]
        assert 0.6 < (off * weighed).sum(axis=1).mean() / 6 < 1.06
