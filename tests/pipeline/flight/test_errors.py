"""Errors: their distributions, the model of a late burn, and draws that are a trial's own."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chisquare, kstest

from pipeline.errors import InputError
from pipeline.flight.errors import (
    COLD_GAS,
    Errors,
    burns_made,
    draws,
    lost_thrust,
    navigation_errors,
)
from pipeline.flight.world import LinearWorld
from pipeline.orbit.covariance import burn_covariance
from pipeline.orbit.problem import Problem

H = 120.0


def test_a_trial_has_the_same_draws_in_whatever_company():
    all_of_them = draws(3, range(40), 3, 4)
    for trials in (range(40), range(7, 9), range(39, 40)):
        some = draws(3, trials, 3, 4)
        for name, values in vars(some).items():
            assert np.array_equal(values, vars(all_of_them)[name][trials.start : trials.stop])


def test_draws_of_trials_and_seeds_are_independent():
    first, second = draws(3, range(2000), 1, 2), draws(4, range(2000), 1, 2)
    columns = [
        *first.bias.reshape(2000, -1).T,
        *first.noise.reshape(2000, -1).T,
        *first.burn.reshape(2000, -1).T,
        *first.lag.reshape(2000, -1).T,
        *second.noise.reshape(2000, -1).T,
        *first.bias[np.arange(2000) - 1].reshape(2000, -1).T,  # of the trial before
    ]
    correlation = np.corrcoef(columns) - np.eye(len(columns))
    assert np.abs(correlation).max() < 5 / np.sqrt(2000)


@pytest.mark.parametrize("name", ["bias", "noise", "burn", "lag"])
def test_draws_are_normal(name):
    assert kstest(vars(draws(0, range(300), 4, 5))[name].ravel(), "norm").pvalue > 1e-3


def test_gates_errors_have_their_sizes_along_and_across_the_burn():
    errors = Errors(magnitude=0.02, direction=0.05, magnitude_fixed=3e-4, direction_fixed=4e-4)
    trials, burn = 40_000, np.array([0.0, 3e-4, -4e-4])
    commanded = np.broadcast_to(burn, (trials, 1, 3))
    made = burns_made(commanded, draws(0, range(trials), 1, 1), 0, errors, H).held[:, 0] * H
    size = 5e-4 * H
    unit = np.array([0.0, 0.6, -0.8])
    axes = np.array([unit, [1.0, 0.0, 0.0], [0.0, 0.8, 0.6]])
    spread = ((made - burn * H) @ axes.T).T
    along, across = np.hypot(0.02 * size, 3e-4), np.hypot(0.05 * size, 4e-4)
    assert spread.std(axis=1) == pytest.approx([along, across, across], rel=0.02)
    assert np.abs(np.corrcoef(spread) - np.eye(3)).max() < 0.02
    assert np.abs(spread.mean(axis=1)).max() < 5 * across / np.sqrt(trials)


def test_without_a_burn_nothing_is_burnt():
    made = burns_made(
        np.zeros((50, 2, 3)), draws(0, range(50), 2, 1), 0, replace(COLD_GAS, missed=1.0), H
    )
    assert not made.held.any()
    assert not made.late.any()
    assert not made.missed.any()


def test_burns_are_missed_as_often_as_told_and_then_whole():
    commanded = np.broadcast_to([1e-3, 0.0, 0.0], (20_000, 1, 3))
    drawn = draws(0, range(20_000), 1, 1)
    made = burns_made(commanded, drawn, 0, replace(COLD_GAS, missed=0.1), H)
    assert made.missed.mean() == pytest.approx(0.1, abs=0.01)
    assert not made.held[made.missed == 1].any()
    assert not made.late[made.missed == 1].any()
    assert made.held[made.missed == 0].any(axis=(1, 2)).all()


def test_a_slow_burn_that_moves_a_craft_is_one_and_what_rounding_leaves_of_a_coast_is_none():
    """On a geostationary orbit a burn of 10 µm/s within 20,000 s moves a craft by 0.1 m."""
    errors, problem = replace(COLD_GAS, missed=1.0), Problem(7.3e-5, 2e4)
    controls = np.array([[[5e-10, 0.0, 0.0]], [[0.0, 1e-15, 0.0]]])
    drawn = draws(0, range(1), 2, 1)
    made = burns_made(controls.swapaxes(0, 1), drawn, 0, errors, 2e4)
    assert (made.missed == 1).all()
    assert (made.held == [[0.0, 0.0, 0.0], [0.0, 1e-15, 0.0]]).all()
    slow, coast = burn_covariance(controls, problem, errors.gaussian(2e4))[:, 0]
    np.testing.assert_allclose(np.diag(slow)[1:], (1e-4 / 2e4) ** 2 + (0.02 * 5e-10) ** 2)
    assert np.abs(coast).max() < 1e-30


@pytest.mark.parametrize("lag", [0.1, 1.0, 10.0, -1.0])
def test_a_late_burn_is_two_impulses_to_second_order_in_the_delay(lag):
    problem = Problem()
    control = np.array([[1e-3, -2e-3, 5e-4]])
    start = np.array([[30.0, -80.0, 10.0, 0.02, -0.05, 0.01]])

    def flown(state, control, time):
        world = LinearWorld(replace(problem, time_step=time).dynamics)
        return world.arc(state, control, 0)[:, -1, -1]

    def coast(state, time):
        return flown(state, np.zeros((1, 3)), time)

    def thrust(state, time):
        return flown(state, control, time)

    # Begins and ends late by ``lag``; looked at 100 s after the interval.
    truth = coast(thrust(coast(start, 50.0 + lag), H), 50.0 - lag)
    impulse = np.concatenate([np.zeros((1, 3)), control * lag], axis=1)
    model = coast(thrust(coast(start, 50.0) - impulse, H) + impulse, 50.0)
    size = np.linalg.norm(control)
    assert np.abs(model - truth)[0, :3].max() < 1.01 * size * lag**2 / 2 * 2  # both ends
    assert np.abs(model - truth)[0, 3:].max() < 10 * problem.mean_motion * size * lag**2
    unmodelled = coast(thrust(coast(start, 50.0), H), 50.0)
    if abs(lag) <= 1:
        assert np.abs(model - truth).max() < np.abs(unmodelled - truth).max() / 50


def test_navigation_has_noise_that_is_new_and_a_bias_that_stays():
    errors = Errors(position=0.3, velocity=0.02, position_bias=0.4, velocity_bias=0.05)
    drawn = draws(0, range(20_000), 1, 2)
    found = navigation_errors(drawn, errors, Problem(nodes=3))
    first, second = found[:, 0, 0], found[:, 1, 0]
    for axis in range(6):
        noise, bias = ((0.3, 0.4), (0.02, 0.05))[axis // 3]
        covariance = np.cov(first[:, axis], second[:, axis])
        assert covariance[0, 0] == pytest.approx(noise**2 + bias**2, rel=0.04)
        assert covariance[0, 1] == pytest.approx(bias**2, rel=0.06)


def test_burns_are_of_whole_bits_and_smaller_ones_are_not_made():
    commanded = np.array([[[1.24e-5, -4.9e-6, 6e-6]]])
    made = burns_made(commanded, draws(0, range(1), 1, 1), 0, Errors(impulse_bit=1e-3), 100.0)
    assert made.held == pytest.approx(np.array([[[1e-5, 0.0, 1e-5]]]), abs=1e-20)


def test_a_crafts_thrusters_err_alike_in_all_its_burns():
    """A share of the burn along it, and a rotation of it by a small angle: to that of the frame."""
    errors = Errors(magnitude_bias=0.05, direction_bias=0.03)
    drawn, commanded = draws(1, range(20_000), 1, 2), np.array([0.0, 0.0, 2e-3])
    first, second = (
        burns_made(np.broadcast_to(commanded, (20_000, 1, 3)), drawn, k, errors, 60.0).held[:, 0]
        for k in (0, 1)
    )
    assert np.array_equal(first, second)
    spread = np.cov((first / 2e-3).T)
    assert spread == pytest.approx(np.diag([0.03, 0.03, 0.05]) ** 2, abs=6e-5)


def test_errors_of_a_filter_hang_together_and_know_the_orbits_size():
    problem = Problem(nodes=4)
    errors = Errors(position=0.5, velocity=1.0, semi_major_axis=0.1, navigation_time=300.0)
    found = navigation_errors(draws(0, range(20_000), 1, 3), errors, problem)[:, :, 0]
    size = 4 * found[..., 0] + 2 * found[..., 4] / problem.mean_motion
    assert size.std(axis=0) == pytest.approx(0.1, rel=0.03)
    assert found[..., 0].std(axis=0) == pytest.approx(0.5, rel=0.03)
    together = np.corrcoef(found[:, 0, 1], found[:, 2, 1])[0, 1]
    assert together == pytest.approx(np.exp(-240 / 300), abs=0.02)


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"missed": 1.5}, "missed is 1.5; expected a number from 0 to 1"),
        ({"latency": 0.5}, "latency is 0.5; expected 0 or 1"),
        ({"timing": -1.0}, "timing is -1; expected a number from 0 to 1000"),
        ({"magnitude": float("nan")}, "magnitude is nan; expected a number from 0 to 0.3"),
    ],
)
def test_what_is_no_error_is_refused(wrong, sentence):
    with pytest.raises(InputError, match=sentence):
        Errors(**wrong)


def test_any_craft_is_lost_at_any_time_alike_and_as_often_as_asked():
    problem = Problem(nodes=6)
    drawn = draws(2, range(20_000), 4, 5)
    loss = lost_thrust(drawn, Errors(lost=0.3), problem)
    lost = loss.craft >= 0
    assert lost.mean() == pytest.approx(0.3, abs=0.01)
    assert np.array_equal(lost, np.isfinite(loss.time))
    assert chisquare(np.bincount(loss.craft[lost])).pvalue > 1e-3
    assert kstest(loss.time[lost] / problem.duration, "uniform").pvalue > 1e-3
    for missed in (drawn.missed[lost, 0, 0], drawn.missed[lost, -1, -1]):
        assert abs(np.corrcoef(loss.time[lost], missed)[0, 1]) < 0.05


def test_others_know_of_a_loss_at_the_next_node_or_one_later_with_late_states():
    drawn, problem = draws(2, range(50), 4, 5), Problem(nodes=6)
    loss = lost_thrust(drawn, Errors(lost=1.0, latency=1.0), problem)
    for node in range(6):
        adrift = np.where(loss.time <= node * problem.time_step, loss.craft, -1)
        np.testing.assert_array_equal(loss.by(node), adrift)
    assert loss.latency == 1
