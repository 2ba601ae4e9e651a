"""Who gets a plane when, and who gives way by how much, by hand."""

import numpy as np
import pytest
import torch

from pipeline.arrays import plain
from pipeline.networks.refiner.geometry import Sides
from pipeline.networks.refiner.model import (
    FEATURES,
    MARGIN,
    MINIMA_ONLY,
    PLANE_DISTANCE,
    gets_plane,
    separation_shares,
    trade_of,
    trades,
)
from pipeline.networks.refiner.refiner import MessagePassing


def given(distance, dual, first_dual, trade=0.0):
    """What both craft are to give way, and what is needed of them together."""
    one = separation_shares(*(np.array([x]) for x in (distance, dual, first_dual, trade)))
    return one[0].tolist(), 1 + MARGIN - distance


@pytest.mark.parametrize(
    ("dual", "first_dual"), [((1.0, 2.0), (0.5, 0.5)), ((0.0, 0.0), (1.0, 2.0))]
)
def test_the_craft_to_which_it_is_cheaper_gives_more_way(dual, first_dual):
    """At half the price 2⁴ times as much, by prices of the last round or of the first metre."""
    (first, second), needed = given(0.5, dual, first_dual)
    assert first == pytest.approx(16 / 17 * needed)
    assert second == pytest.approx(1 / 17 * needed)


def test_the_craft_to_which_it_is_dearer_gets_more_way_back():
    """At twice the price twice as much, whatever the first metre was."""
    (first, second), needed = given(2.0, (1.0, 2.0), (5.0, 0.1))
    assert needed < 0
    assert first == pytest.approx(1 / 3 * needed, rel=1e-5)
    assert second == pytest.approx(2 / 3 * needed, rel=1e-5)


def test_a_trade_is_what_one_craft_gives_beyond_its_share_and_the_other_less():
    (first, second), needed = given(0.5, (1.0, 1.0), (1.0, 1.0), trade=0.25)
    assert (first, second) == pytest.approx((needed / 2 + 0.25, needed / 2 - 0.25))


def test_who_offers_more_gives_more_and_nobody_beyond_the_limit():
    offers = torch.tensor([2.0, -1.0, 50.0]), torch.tensor([-1.0, 2.0, -50.0])
    first, second = trade_of(*offers), trade_of(*reversed(offers))
    assert first.tolist() == pytest.approx([0.3 * 0.99505, -0.3 * 0.99505, 0.3], rel=1e-4)
    assert torch.equal(first, -second)


def test_both_sides_find_the_same_trade_with_numpy_as_with_torch():
    torch.manual_seed(0)
    network = MessagePassing(32, 16, 8).double()
    torch.nn.init.normal_(network.offer.weight)
    pairs, seen = np.array([[0, 1], [1, 2], [0, 2]]), torch.randn(3, 2, FEATURES).double()
    free = torch.nn.functional.normalize(torch.randn(3, 30).double(), dim=1)
    found = trades(network.weights, seen, free, Sides.of(pairs)).detach()
    turned = trades(network.weights, seen.flip(1), -free, Sides.of(pairs[:, ::-1])).detach()
    assert found.abs().max() > 1e-3
    assert turned.tolist() == pytest.approx((-found).tolist(), abs=1e-12)
    same = trades(network.arrays, plain(seen), plain(free), Sides.of(pairs))
    assert same == pytest.approx(found.numpy(), rel=1e-9, abs=1e-12)


def test_message_passing_is_that_of_torch_s_own_layers():
    torch.manual_seed(0)
    network = MessagePassing(32, 16, 8)
    torch.nn.init.normal_(network.offer.weight)
    seen = torch.randn(1, 2, FEATURES)
    free = torch.nn.functional.normalize(torch.randn(1, 30), dim=1)
    said = network.read(torch.cat([seen, seen.flip(1)], dim=2))
    heard = network.tell(said).repeat(1, 1, 2)  # nobody else is there to be heard
    every = torch.cat([said, heard, heard.flip(1)], dim=2)
    one, other = network.offer(network.weigh(every))[..., 0].T
    trade = trades(network.weights, seen, free, Sides.of(np.array([[0, 1]])))
    assert trade.item() == pytest.approx(trade_of(one, other).item(), rel=1e-5)


def test_planes_stand_where_pairs_turn_and_later_also_wherever_they_are_too_close():
    distance = np.array([0.9, 0.9, 1.05, 1.2, 1.4])
    is_minimum = np.array([True, False, False, True, True])
    assert 1.2 < PLANE_DISTANCE < 1.4
    for number in range(MINIMA_ONLY):
        assert gets_plane(distance, is_minimum, number).tolist() == [
            True,
            False,
            False,
            True,
            False,
        ]
    assert gets_plane(distance, is_minimum, MINIMA_ONLY).tolist() == [
        True,
        True,
        False,
        True,
        False,
    ]
