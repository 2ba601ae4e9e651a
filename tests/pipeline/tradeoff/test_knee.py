"""The knee: by hand, and where there is none."""

import numpy as np
import pytest

from pipeline import tradeoff


def knee(time, cost):
    return tradeoff.knee(np.array(time, dtype=float), np.array(cost, dtype=float))


def test_the_corner_of_two_straight_lines_is_the_knee():
    assert knee([0, 1, 2, 6, 10], [10, 6, 2, 1, 0]) == 2


def test_of_a_hyperbola_it_is_where_the_slope_is_that_of_the_chord():
    """y = 1/x on 1..9 has the chord's slope -1/9 at x = 3, for y' = -1/x²."""
    time = np.linspace(1, 9, 801)
    assert time[knee(time, 1 / time)] == pytest.approx(3, abs=0.01)


def test_units_do_not_matter():
    time, cost = np.array([1, 2, 3, 4, 5.0]), np.array([9, 4, 3, 2.5, 2.4])
    assert knee(time, cost) == knee(60 * time, cost / 120) == 1


def test_a_longer_time_that_costs_more_is_no_trade_off():
    """Without the last points the corner is at 2, and they change nothing."""
    assert knee([0, 1, 2, 6, 10, 11, 12], [10, 6, 2, 1, 0, 9, 30]) == 2
    assert knee([0, 1, 2, 3, 6, 10], [10, 6, 2, 8, 1, 0]) == 2


@pytest.mark.parametrize(
    ("time", "cost"),
    [
        ([], []),
        ([1], [1]),
        ([1, 2], [2, 1]),
        ([1, 2, 3], [3, 2, 1]),  # straight
        ([1, 2, 3], [3, 2.9, 1]),  # bends the other way
        (range(16, 41, 2), [2.83, *np.linspace(2.65, 1.53, 12)]),  # straight but for its first step
        (range(10), [*np.linspace(1, 0.45, 5), *np.linspace(0.35, 0, 5)]),  # nearly straight
        (np.linspace(20, 30, 11), 1 / np.linspace(20, 30, 11)),  # hardly bent over so short a range
        ([1, 2, 3], [1, 2, 3]),  # never pays
    ],
)
def test_where_nothing_bends_there_is_none(time, cost):
    assert knee(time, cost) is None
