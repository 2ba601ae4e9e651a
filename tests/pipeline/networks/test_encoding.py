"""What networks read and answer."""

import numpy as np
import pytest
import torch

from pipeline.dataset.examples import Examples
from pipeline.errors import InputError
from pipeline.networks.encoding import INTERIORS, Encoding, fit
from pipeline.orbit.dynamics import cw_matrices
from pipeline.orbit.problem import Problem

PROBLEM = Problem(nodes=5)


def states_of(rng, *shape):
    return rng.normal(size=(*shape, 6)) * [100, 200, 50, 0.1, 0.2, 0.05]


def examples(n=3, count=20):
    rng = np.random.default_rng(4)
    return Examples(
        PROBLEM,
        states_of(rng, count, n),
        states_of(rng, count, n),
        states_of(rng, count, n, PROBLEM.nodes),
    )


@pytest.mark.parametrize("interior", ["line", "zeros", "minimum-energy"])
@pytest.mark.parametrize("target", ["states", "offset"])
def test_decoding_undoes_the_encoding_of_targets(interior, target):
    data = examples()
    encoding = fit(data, interior, target)
    inputs = encoding.inputs(data.initial, data.goal)
    back = encoding.decode(encoding.targets(data.states, inputs), inputs)
    np.testing.assert_allclose(back.numpy(), data.states, atol=1e-10)


@pytest.mark.parametrize("target", ["states", "offset"])
def test_each_component_of_the_training_data_is_brought_to_size_one(target):
    data = examples()
    encoding = fit(data, "line", target)
    inputs = encoding.inputs(data.initial, data.goal)
    for encoded in (inputs, encoding.targets(data.states, inputs)):
        assert encoded.square().mean(dim=(0, 1, 2)).tolist() == pytest.approx([1.0] * 6)


@pytest.mark.parametrize("target", ["states", "offset"])
def test_a_common_scale_keeps_metres_and_metres_a_second_in_proportion(target):
    data = examples()
    encoding = fit(data, "line", target, "common")
    inputs = encoding.inputs(data.initial, data.goal)
    straight = INTERIORS["line"](data.initial, data.goal, PROBLEM)
    wanted = data.states - straight if target == "offset" else data.states
    for encoded, states in ((inputs, straight), (encoding.targets(data.states, inputs), wanted)):
        share = encoded.numpy() / states
        assert share.min() == pytest.approx(share.max())
        assert encoded.square().mean(dim=(0, 1, 2)).max() == pytest.approx(1.0)
    back = encoding.decode(encoding.targets(data.states, inputs), inputs)
    np.testing.assert_allclose(back.numpy(), data.states, atol=1e-10)


@pytest.mark.parametrize("interior", list(INTERIORS))
def test_every_interior_keeps_both_ends(interior):
    data = examples()
    states = INTERIORS[interior](data.initial, data.goal, PROBLEM)
    np.testing.assert_allclose(states[:, :, 0], data.initial, atol=1e-9)
    np.testing.assert_allclose(states[:, :, -1], data.goal, atol=1e-9)


def test_between_the_ends_stand_a_line_or_zeros_or_a_transfer_that_can_be_flown():
    data = examples()
    made = {name: make(data.initial, data.goal, PROBLEM) for name, make in INTERIORS.items()}
    middle = (data.initial + data.goal) / 2
    np.testing.assert_allclose(made["line"][:, :, 2], middle)
    assert (made["zeros"][:, :, 1:-1] == 0).all()
    A, B = cw_matrices(PROBLEM.mean_motion, PROBLEM.time_step)
    push = made["minimum-energy"][:, :, 1:] - made["minimum-energy"][:, :, :-1] @ A.T
    controls = np.linalg.lstsq(B, push.reshape(-1, 6).T, rcond=None)[0]
    np.testing.assert_allclose(B @ controls, push.reshape(-1, 6).T, atol=1e-9)


def test_an_offset_of_nothing_is_the_input_s_own_trajectory():
    data = examples()
    encoding = fit(data, "line", "offset")
    inputs = encoding.inputs(data.initial, data.goal)
    states = encoding.decode(torch.zeros_like(inputs), inputs)
    share = np.linspace(0, 1, 5)[:, None]
    expected = data.initial[:, :, None] * (1 - share) + data.goal[:, :, None] * share
    np.testing.assert_allclose(states.numpy(), expected, atol=1e-10)


def test_a_component_that_is_only_rounding_is_not_blown_up():
    data = examples()
    for array in (data.initial, data.goal, data.states):
        array[..., 2] = 1e-15
        array[..., 5] = 0.0
    encoding = fit(data, "line", "states")
    inputs = encoding.inputs(data.initial, data.goal)
    assert inputs[..., [2, 5]].abs().max() < 1e-6
    assert torch.isfinite(encoding.targets(data.states, inputs)).all()


def test_data_without_any_motion_still_has_scales():
    still = np.zeros((2, 3, 5, 6))
    encoding = fit(Examples(PROBLEM, still[:, :, 0], still[:, :, -1], still), "line", "offset")
    assert encoding.target_scale == (1.0,) * 6


def test_unknown_interiors_and_targets_are_refused_by_name():
    with pytest.raises(InputError, match=r"'arc'.*line or zeros or minimum-energy"):
        fit(examples(), "arc", "states")
    with pytest.raises(InputError, match="scaling is 'none'; expected common or component"):
        fit(examples(), "line", "states", "none")
    with pytest.raises(InputError, match=r"'controls'.*states or offset"):
        Encoding(PROBLEM, 3, "line", "controls", (1.0,) * 6, (1.0,) * 6)
