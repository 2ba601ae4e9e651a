"""Message aggregation against sums over all pairs of sides, written out."""

import numpy as np
import pytest
import torch

from pipeline.arrays import plain
from pipeline.networks.refiner.geometry import Sides
from pipeline.networks.refiner.tensors import PaddedSides

CRAFT, ENCOUNTERS, H, M = 7, 12, 3, 5


@pytest.fixture
def drawn():
    """Random encounters of some of the craft, with unit vectors and messages."""
    torch.manual_seed(0)
    pair = torch.stack([torch.randperm(CRAFT - 1)[:2] for _ in range(ENCOUNTERS)])
    free = torch.nn.functional.normalize(torch.randn(ENCOUNTERS, M).double(), dim=1)
    return pair, free, torch.randn(ENCOUNTERS, 2, H).double()


def written_out(pair, free, told):
    """By the definition, over all pairs of sides of the same craft."""
    craft, flat = pair.reshape(-1), told.reshape(-1, H)
    vector = torch.stack([free, -free], dim=1).reshape(-1, M)
    same = (craft[:, None] == craft[None]).double()
    sums = [(same * (vector @ vector.T)) @ flat, same @ flat]
    return torch.cat(sums, dim=1).reshape(len(pair), 2, -1)


def test_sides_are_those_of_their_craft_in_order(drawn):
    pair, _, _ = drawn
    sides = Sides.of(plain(pair))
    craft = pair.reshape(-1)
    assert sides.craft.tolist() == sorted(set(craft.tolist()))
    assert sorted(sides.order.tolist()) == list(range(2 * ENCOUNTERS))
    for k, one in enumerate(sides.craft.tolist()):
        mine = sides.order[sides.start[k] : sides.start[k + 1]]
        assert mine.tolist() == (craft == one).nonzero()[:, 0].tolist()
    assert np.array_equal(sides.craft[sides.place], craft)


def test_an_edge_aggregates_the_messages_of_all_edges_of_its_craft(drawn):
    pair, free, told = drawn
    found = Sides.of(plain(pair)).aggregate(told, free)
    torch.testing.assert_close(found, written_out(pair, free, told))
    assert found.std() > 0.5
    same = Sides.of(plain(pair)).aggregate(plain(told), plain(free))
    assert np.array_equal(same, found.numpy())
    at_once = PaddedSides.of(pair)
    torch.testing.assert_close(at_once.aggregate(told, free), written_out(pair, free, told))
    totals = at_once.totals(told[..., 0])
    assert plain(totals) == pytest.approx(Sides.of(plain(pair)).totals(plain(told[..., 0])))


def test_gradients_are_those_of_the_definition(drawn):
    pair, free, told = drawn
    taste, sides = torch.randn(ENCOUNTERS, 2, 2 * H).double(), Sides.of(plain(pair))
    mine, theirs = told.clone().requires_grad_(), told.clone().requires_grad_()
    (sides.aggregate(mine, free) * taste).sum().backward()
    (written_out(pair, free, theirs) * taste).sum().backward()
    torch.testing.assert_close(mine.grad, theirs.grad)
