"""What a recipe adds to the steps of Adam, each against what is done by hand."""

from dataclasses import replace
from math import cos, pi

import pytest
import torch
from torch import nn

from pipeline.networks.recipes import RECIPES
from pipeline.training.loop import Descent


def descent(steps=4, **changes):
    torch.manual_seed(0)
    recipe = replace(RECIPES["tuned"], learning_rate=0.1, **changes)
    return Descent(nn.Linear(3, 2), recipe, steps)


def step(down, size=1.0):
    down.step(size * down.network(torch.ones(5, 3)).square().sum())


def weight(network):
    return network.weight.detach().clone()


def gradient(down):
    return torch.cat([p.grad.flatten() for p in down.network.parameters()])


def rates(down, count):
    found = []
    for _ in range(count):
        found.append(down.optimizer.param_groups[0]["lr"])
        step(down)
    return found


def test_the_rate_stays_or_falls_along_half_a_cosine():
    assert rates(descent(), 4) == [0.1] * 4
    wanted = [0.1 * (1 + cos(pi * k / 4)) / 2 for k in range(5)]
    assert rates(descent(schedule="cosine"), 5) == pytest.approx(wanted, abs=1e-12)


def test_the_steps_are_those_of_torch_s_adam_to_the_bit():
    down, copy = descent(), descent().network
    adam = torch.optim.Adam(copy.parameters(), lr=0.1)
    for size in (1.0, 100.0, 1e-3):
        step(down, size)
        adam.zero_grad()
        (size * copy(torch.ones(5, 3)).square().sum()).backward()
        adam.step()
        assert torch.equal(weight(down.network), weight(copy))


def test_a_gradient_longer_than_its_limit_is_cut_to_it_and_a_shorter_one_is_left():
    for size, limit, cut in ((100.0, 0.5, True), (1e-3, 0.5, False), (100.0, 0.0, False)):
        free, held = descent(), descent(gradient_limit=limit)
        for down in (free, held):
            step(down, size)
        free, held = (
            torch.cat([p.grad.flatten() for p in d.network.parameters()]) for d in (free, held)
        )
        if cut:
            assert float(held.norm()) == pytest.approx(limit, rel=1e-4)
            torch.testing.assert_close(held / held.norm(), free / free.norm())
        else:
            assert torch.equal(held, free)


def test_what_is_kept_is_the_mean_of_the_weights_over_the_run():
    down = descent(averaging=0.75)
    mean = None
    for _ in range(4):
        step(down)
        now = weight(down.network)
        mean = now if mean is None else 0.75 * mean + 0.25 * now
        torch.testing.assert_close(weight(down.result), mean)
    assert not torch.equal(weight(down.result), weight(down.network))


def test_without_averaging_it_is_the_network_itself():
    down = descent()
    assert down.result is down.network
