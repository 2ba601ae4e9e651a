"""Own optima by table on tensors, against those on arrays and against finite differences."""

import numpy as np
import pytest
import torch

from pipeline.errors import InputError
from pipeline.networks.least_fuel import least_fuel
from pipeline.orbit.decoupled import least_fuel as on_arrays
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import transfer_maps

PERIOD = 2 * np.pi / Problem().mean_motion
PROBLEMS = [Problem(), Problem(nodes=31, time_step=60.0), Problem(nodes=21, time_step=PERIOD / 10)]


def changes(problem, shape, seed=0):
    size = np.repeat([100.0, 100.0 / problem.duration], 3)
    return np.random.default_rng(seed).normal(size=(*shape, 6)) * size


@pytest.mark.parametrize("problem", PROBLEMS)
def test_it_is_that_of_arrays_for_any_batch(problem):
    miss = changes(problem, (5, 8))
    found, known = (
        least_fuel(torch.from_numpy(miss), problem),
        on_arrays(miss.reshape(-1, 6), problem),
    )
    for name in ("controls", "bound", "dual", "basis"):
        mine, theirs = getattr(found, name).numpy(), getattr(known, name)
        assert mine.reshape(theirs.shape) == pytest.approx(theirs, rel=1e-9, abs=1e-15)
    assert found.controls.shape == (5, 8, problem.intervals, 3)


@pytest.mark.parametrize("problem", PROBLEMS)
def test_in_float32_the_goal_is_met_and_the_fuel_is_the_bound_to_its_precision(problem):
    miss = changes(problem, (200,))
    found = least_fuel(torch.from_numpy(miss).float(), problem)
    flat = found.controls.double().numpy().reshape(200, -1)
    reached = flat @ transfer_maps(problem).reach[-1].T
    size = np.abs(miss).max(axis=0)
    assert (np.abs(reached - miss) / size).max() < 1e-3
    fuel, known = np.abs(flat).sum(axis=1), on_arrays(miss, problem).bound
    assert fuel == pytest.approx(known, rel=1e-4)
    assert found.bound.numpy() == pytest.approx(known, rel=1e-4)


def test_the_gradient_of_the_fuel_is_the_dual():
    """The envelope theorem: what a change of the goal costs is its price."""
    problem = Problem()
    miss = torch.from_numpy(changes(problem, (6,), seed=1)).requires_grad_()
    found = least_fuel(miss, problem)
    found.controls.abs().sum().backward()
    assert miss.grad.numpy() == pytest.approx(found.dual.numpy(), rel=1e-9)
    step = 1e-4 * torch.randn(6, 6, dtype=torch.float64) * miss.detach().abs()
    ahead, behind = (least_fuel(miss.detach() + s * step, problem).bound for s in (1, -1))
    slope = (miss.grad * step).sum(dim=1)
    assert ((ahead - behind) / 2).numpy() == pytest.approx(slope.numpy(), rel=1e-6)


def test_where_a_state_is_out_of_reach_it_says_so():
    with pytest.raises(InputError, match="no controls reach"):
        least_fuel(torch.ones(1, 6), Problem(time_step=PERIOD / 2, nodes=3))
