"""The planes between craft against scipy's cubics, and their gradients against differences."""

import weakref
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from scipy.interpolate import CubicHermiteSpline

from pipeline.networks.refiner.geometry import Encounters, gains, grid_of, normals, passing
from pipeline.orbit.problem import Problem

PROBLEM, CRAFT, ENCOUNTERS = Problem(), 6, 9
GRID = grid_of(PROBLEM, torch.device("cpu"))


@pytest.fixture
def drawn():
    """Random encounters of random motion, at any time of an interval, both ends included."""
    torch.manual_seed(0)
    states = torch.randn(CRAFT, PROBLEM.nodes, 6).double()
    rng = np.random.default_rng(0)
    interval = rng.integers(0, PROBLEM.intervals, ENCOUNTERS)
    interval[:2] = 0, PROBLEM.intervals - 1
    met = Encounters(rng.integers(0, 3, ENCOUNTERS), rng.integers(3, 6, ENCOUNTERS), interval)
    share = rng.random(ENCOUNTERS)
    share[:2] = 0.0, 1.0
    return met, share, states


def stand(met, share, states):
    """The planes between pairs at some time in an interval, and their motion past each other."""
    ends = met.relative(states)
    distance, along = normals(ends, share)
    gain = gains(met.interval, share, along, GRID if torch.is_tensor(states) else grid_of(PROBLEM))
    motion, speed = passing(ends.detach() if torch.is_tensor(ends) else ends, share, along)
    return SimpleNamespace(distance=distance, along=along, gain=gain, motion=motion, speed=speed)


def relative(met, share, states):
    """Positions and velocities of first craft relative to second, by scipy."""
    nodes = np.arange(PROBLEM.nodes)
    flown = CubicHermiteSpline(nodes, states[..., :3], states[..., 3:], axis=1)
    time = met.interval + share
    each = np.arange(len(time))
    return [
        (motion(time)[met.first, each] - motion(time)[met.second, each])
        for motion in (flown, flown.derivative())
    ]


def test_planes_stand_across_the_gap_and_motion_goes_along_them(drawn):
    found = stand(*drawn)
    gap, speed = relative(*drawn)
    distance = np.linalg.norm(gap, axis=1)
    assert found.distance.numpy() == pytest.approx(distance, rel=1e-9)
    assert found.along.numpy() == pytest.approx(gap / distance[:, None], abs=1e-9)
    assert found.speed.numpy() == pytest.approx(np.linalg.norm(speed, axis=1), rel=1e-9)
    past = speed - np.sum(speed * found.along.numpy(), axis=1, keepdims=True) * found.along.numpy()
    past /= np.linalg.norm(past, axis=1, keepdims=True)
    assert found.motion.numpy() == pytest.approx(past, abs=1e-9)


def test_a_gain_is_how_far_controls_move_the_first_craft_along_the_normal(drawn):
    met, share, states = drawn
    found = stand(*drawn)
    controls = torch.randn(CRAFT, GRID.reach.shape[1]).double()
    moved = states + GRID.fly(torch.zeros(CRAFT, 6).double(), controls)
    by = relative(met, share, moved)[0] - relative(met, share, states)[0]
    along = np.sum(by * found.along.numpy(), axis=1)
    mine, other = ((found.gain * controls[craft]).sum(dim=1) for craft in met.craft.T)
    assert (mine - other).numpy() == pytest.approx(along, rel=1e-9, abs=1e-9)
    assert found.gain[0].abs().max() == 0  # nobody is moved at the first node


def test_numpy_and_torch_put_up_the_same_planes(drawn):
    met, share, states = drawn
    found, same = stand(*drawn), stand(met, share, states.numpy())
    for name, values in vars(same).items():
        assert getattr(found, name).numpy() == pytest.approx(values, rel=1e-12, abs=1e-12)


def test_gradients_are_those_of_small_differences(drawn):
    met, share, states = drawn

    def some(given):
        found = stand(met, share, given)
        return found.distance, found.gain

    assert torch.autograd.gradcheck(some, (states.requires_grad_(),))


def test_planes_that_nobody_needs_any_more_leave_no_memory_behind(drawn):
    """A training makes very many; what backward keeps of one must not keep itself."""
    met, share, states = drawn
    found = stand(met, share, states.requires_grad_())
    kept = [weakref.ref(values) for values in vars(found).values()]
    del found
    assert [values() for values in kept] == [None] * len(kept)


def test_directions_are_orthogonal_even_where_craft_touch_or_stand_still():
    states = torch.zeros(6, PROBLEM.nodes, 6, dtype=torch.float64)
    states[0, :2, 3:] = torch.tensor([1.0, 2.0, 3.0])  # touches the second, moving
    states[0, 0, :3], states[0, 1, :3] = -0.5 * states[0, 0, 3:], 0.5 * states[0, 0, 3:]
    states[2, :, 0] = 2.0  # stands still
    states[4] = torch.randn(PROBLEM.nodes, 6)
    met = Encounters(np.array([0, 2, 4]), np.array([1, 3, 5]), np.zeros(3, dtype=int))
    share = np.full(3, 0.5)
    found = stand(met, share, states.requires_grad_())
    both = torch.stack([found.along, found.motion], dim=1).detach()
    eye = torch.eye(2, dtype=torch.float64).expand(3, 2, 2)
    assert (both @ both.mT).numpy() == pytest.approx(eye.numpy(), abs=1e-9)
    assert found.distance[0].item() == pytest.approx(0.0, abs=1e-9)
    assert found.distance[1].item() == pytest.approx(2.0)
    found.gain.sum().backward()
    assert (states.grad[:2] == 0).all()  # a normal that is no gap's does not turn
    assert states.grad[2:].abs().max() > 0
