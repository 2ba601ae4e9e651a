"""The collision penalty against a double loop."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import nn

from pipeline.networks.encoding import Encoding
from pipeline.networks.feedforward import FF1, FFCOL
from pipeline.networks.recipes import RECIPES
from pipeline.networks.supervised import collision_penalty
from pipeline.orbit.problem import Problem


def penalty_by_loops(positions, radius):
    total = 0.0
    for swarm in positions:
        for i in range(len(swarm)):
            for j in range(i + 1, len(swarm)):
                for t in range(swarm.shape[1]):
                    distance = np.sqrt(((swarm[i, t] - swarm[j, t]) ** 2).sum())
                    total += max(0.0, 1 - distance / radius) ** 2
    return total / len(positions)


def test_the_penalty_is_the_sum_over_pairs_and_nodes():
    positions = np.random.default_rng(0).normal(scale=12.0, size=(3, 5, 4, 3))
    expected = penalty_by_loops(positions, 15.0)
    assert expected > 0.1
    got = collision_penalty(torch.tensor(positions), 15.0)
    assert float(got) == pytest.approx(expected, rel=1e-12)


def test_the_penalty_is_nothing_without_collisions_and_one_for_a_pair_in_one_place():
    apart = torch.tensor([[[[0.0, 0, 0]], [[15.0, 0, 0]], [[0, 40.0, 0]]]])
    together = torch.zeros(1, 2, 1, 3)
    assert float(collision_penalty(apart, 15.0)) == 0
    assert float(collision_penalty(together, 15.0)) == 1
    assert float(collision_penalty(torch.zeros(1, 1, 4, 3), 15.0)) == 0  # no pair


def test_the_penalty_pushes_a_close_pair_apart_and_stays_finite_where_craft_coincide():
    positions = torch.tensor([[[[0.0, 0, 0]], [[5.0, 0, 0]]]], requires_grad=True)
    collision_penalty(positions, 15.0).backward()
    # d/dx of (1 - x/15)² at x = 5
    assert positions.grad[0, 1, 0].tolist() == pytest.approx([-2 * (1 - 5 / 15) / 15, 0, 0])
    same = torch.zeros(1, 2, 1, 3, requires_grad=True)
    collision_penalty(same, 15.0).backward()
    assert torch.isfinite(same.grad).all()


def test_the_penalty_judges_positions_in_metres():
    scales = (10.0, 10.0, 10.0, 1.0, 1.0, 1.0)
    encoding = Encoding(Problem(nodes=3), 2, "line", "offset", (100.0,) * 6, scales)
    output = torch.zeros(1, 2, 3, 6)
    output[0, 1, :, 0] = 0.6  # 6 m from the other craft at each of 3 nodes
    network = nn.Linear(36, 36).requires_grad_(False)  # which answers that, whatever it reads
    network.load_state_dict({"weight": torch.zeros(36, 36), "bias": output.flatten()})
    recipe, inputs = replace(RECIPES["tuned"], collision_weight=0.5), torch.zeros(1, 2, 3, 6)
    loss = FFCOL.loss(network, {"inputs": inputs, "target": output}, encoding, recipe)
    assert float(loss) == pytest.approx(0.5 * 3 * (1 - 6 / 15) ** 2)
    batch, without = {"inputs": inputs, "target": output + 2}, replace(recipe, collision_weight=0.0)
    for architecture, weights in ((FF1, recipe), (FFCOL, without)):
        assert float(architecture.loss(network, batch, encoding, weights)) == pytest.approx(4)
