"""Who gets a plane when, and who gives way by how much, by hand."""

import pytest
import torch

from pipeline.networks.refiner.bargain import Bargain, trade_of
from pipeline.networks.refiner.encounters import Encounters
from pipeline.networks.refiner.planes import Planes
from pipeline.networks.refiner.rounds import MARGIN, TURNS_ONLY, WATCHED, meets, to_give
from pipeline.networks.refiner.seen import FEATURES, Meeting
from pipeline.networks.refiner.sides import sides_of


def meeting(distance, price, first_price):
    """One encounter of two craft."""
    one = torch.zeros(1, dtype=torch.long)
    along = torch.tensor([[1.0, 0.0, 0.0]]).double()
    apart = torch.tensor([distance]).double()
    planes = Planes(apart, torch.zeros(1, 30).double(), along, along, torch.ones(1).double())
    prices = (torch.tensor([pair]).double() for pair in (price, first_price))
    return Meeting(Encounters(one, one + 1, one), torch.zeros(1).double(), planes, *prices)


def given(distance, price, first_price, trade=None):
    """What both craft are to give way, and what is needed of them together."""
    trade = None if trade is None else torch.tensor([trade])
    return to_give(meeting(distance, price, first_price), trade)[0].tolist(), 1 + MARGIN - distance


@pytest.mark.parametrize(
    ("price", "first_price"), [((1.0, 2.0), (0.5, 0.5)), ((0.0, 0.0), (1.0, 2.0))]
)
def test_the_craft_to_which_it_is_cheaper_gives_more_way(price, first_price):
    """At half the price 2⁴ times as much, by prices of the last round or of the first metre."""
    (first, second), needed = given(0.5, price, first_price)
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


def test_both_sides_find_the_same_trade():
    torch.manual_seed(0)
    network = Bargain(32, 16, 8)
    torch.nn.init.normal_(network.offer.weight)
    pairs, seen = torch.tensor([[0, 1], [1, 2], [0, 2]]), torch.randn(3, 2, FEATURES)
    free = torch.nn.functional.normalize(torch.randn(3, 30), dim=1)
    found = network(seen, sides_of(pairs, 3), free)
    turned = network(seen.flip(1), sides_of(pairs.flip(1), 3), -free)
    assert found.abs().max() > 1e-3
    assert turned.tolist() == pytest.approx((-found).tolist(), abs=1e-6)


def test_planes_stand_where_pairs_turn_and_later_also_wherever_they_are_too_close():
    distance = torch.tensor([0.9, 0.9, 1.05, 1.2, 1.4]).double()
    turns = torch.tensor([True, False, False, True, True])
    assert 1.2 < WATCHED < 1.4
    for number in range(TURNS_ONLY):
        assert meets(distance, turns, number).tolist() == [True, False, False, True, False]
    assert meets(distance, turns, TURNS_ONLY).tolist() == [True, True, False, True, False]
