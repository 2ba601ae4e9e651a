"""Planners compared on the same trials, with numbers that can be worked out by hand."""

import numpy as np
import pandas as pd
import pytest

from pipeline.experiments.verdicts import compare
from pipeline.figures.intervals import mean_interval, wilson


def trials(safe, fuel, first=0):
    return pd.DataFrame(
        {"trial": range(first, first + len(safe)), "safe": safe, "fuel_ratio": fuel}
    )


def test_differences_are_those_of_the_trials_that_both_have():
    one = trials([True, True, False, True], [1.0, 2.0, 3.0, 4.0])
    other = trials([False, True, True], [1.5, 2.5, 3.0], first=1)
    held = compare(one, other)
    assert held.trials == 3
    assert held.safe == pytest.approx((1 - 1 + 0) / 3)  # trials 1, 2 and 3
    assert held.fuel == pytest.approx((0.5 + 0.5 + 1.0) / 3)
    half = 4.302653 * (1 / 12) ** 0.5 / 3**0.5  # Student's t of 2 degrees; their variance is 1/12
    of_three = mean_interval(np.array([0.5, 0.5, 1.0]))
    assert of_three == pytest.approx((held.fuel - half, held.fuel + half))


def test_trials_without_a_ratio_of_fuel_count_where_they_are_safe():
    """A ratio to a bound of 0 is none."""
    nan = float("nan")
    held = compare(trials([True] * 20, [1.0] * 20), trials([True, False] * 10, [1.5, nan] * 10))
    assert (held.trials, held.safe, held.fuel) == (20, 0.5, -0.5)
    assert held.safe_p_value == pytest.approx(2 / 2**10)


def test_the_same_trials_tell_apart_what_shares_alone_would_not():
    """8 of 100 trials are safe with the first alone: by chance once in 2^7 times."""
    second = [True] * 50 + [False] * 50
    first = [True] * 58 + [False] * 42
    held = compare(trials(first, [1.2] * 100), trials(second, [1.0] * 100))
    assert held.safe_p_value == pytest.approx(2 / 2**8)
    assert held.better, "safety comes before fuel"
    assert held.safe_interval[0] > 0
    low, high = wilson(0.58, 100), wilson(0.5, 100)
    assert low[0] < high[1], "their own intervals overlap"


def test_where_safety_may_be_chance_the_cheaper_one_is_better():
    first, second = [True] * 6 + [False] * 4, [True] * 5 + [False] * 5
    held = compare(trials(first, [1.1] * 10), trials(second, [1.2] * 10))
    assert held.safe_p_value == 1.0
    assert held.better
    assert not compare(trials(second, [1.2] * 10), trials(first, [1.1] * 10)).better
    same = trials(first, [1.0] * 10)
    assert not compare(same, same).better


def test_several_trainings_count_as_their_mean_in_each_trial():
    both = pd.concat([trials([True, True], [1.0, 1.0]), trials([True, False], [3.0, 3.0])])
    held = compare(both, trials([True, True], [1.0, 1.0]))
    assert (held.trials, held.safe, held.fuel) == (2, -0.25, 1.0)


def test_wilsons_interval_is_the_one_of_the_formula():
    z = 1.959963984540054
    assert wilson(0.0, 20) == pytest.approx((0, z**2 / (20 + z**2)))
    assert wilson(1.0, 20) == pytest.approx((20 / (20 + z**2), 1))
    p, n = 0.507, 1000
    middle = (p + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z / (1 + z**2 / n) * (p * (1 - p) / n + z**2 / (4 * n**2)) ** 0.5
    assert wilson(p, n) == pytest.approx((middle - half, middle + half))
    assert np.isnan(wilson(float("nan"), 10)).all()


def test_a_mean_has_students_interval():
    """Of 1, 2, 3: 2 ± t(2, 0.975) · 1/√3, where the table has 4.303 for t."""
    low, high = mean_interval(np.array([1.0, 2.0, 3.0]))
    assert (low, high) == pytest.approx((2 - 4.303 / 3**0.5, 2 + 4.303 / 3**0.5), abs=1e-3)
    assert mean_interval(np.array([2.0, 2.0])) == (2.0, 2.0)
    assert np.isnan(mean_interval(np.array([1.0]))).all(), "one value does not say how it varies"
