"""Intervals of shares that are counted in clusters."""

import numpy as np
import pytest
from scipy.stats import binomtest

from pipeline.figures.intervals import clustered_interval, wilson


def scipy_wilson(count, trials):
    found = binomtest(count, trials).proportion_ci(0.95, "wilson")
    return found.low, found.high


@pytest.mark.parametrize(("count", "trials"), [(0, 7), (3, 40), (40, 40), (517, 1000)])
def test_of_whole_numbers_wilson_s_interval_is_scipy_s(count, trials):
    assert wilson(count / trials, float(trials)) == pytest.approx(
        scipy_wilson(count, trials), abs=1e-12
    )


def test_what_never_or_always_happened_has_an_interval_with_that_end():
    for trials in range(1, 300):  # of which rounding left 3e-18 for some
        assert wilson(0.0, trials)[0] == 0.0
        assert wilson(1.0, trials)[1] == 1.0


def test_flights_that_all_do_the_same_are_worth_one_a_scenario():
    shares = np.repeat([1.0, 0.0], [6, 34])
    assert clustered_interval(shares, 25) == pytest.approx(scipy_wilson(6, 40))


def test_what_never_happened_is_as_likely_as_the_number_of_scenarios_allows():
    assert clustered_interval(np.zeros(100), 10) == pytest.approx(scipy_wilson(0, 100))


def test_scenarios_that_are_all_alike_are_worth_all_their_flights():
    alike = np.tile([0.2, 0.4], 20)  # no more apart than flights of one kind would be
    assert clustered_interval(alike, 10) == pytest.approx(scipy_wilson(120, 400))


def test_it_holds_the_truth_as_often_as_it_says_where_counting_flights_would_not():
    """Scenarios that differ: each has a chance of its own, beta distributed about 0.1."""
    generator, truth, clusters, each, draws = np.random.default_rng(0), 0.1, 60, 10, 2000
    chance = generator.beta(0.2, 1.8, (draws, clusters))
    shares = generator.binomial(each, chance) / each
    found = np.array([clustered_interval(one, each) for one in shares])
    naive = np.array([wilson(float(one.mean()), float(clusters * each)) for one in shares])
    held, counted = (
        float(((low <= truth) & (truth <= high)).mean()) for low, high in (found.T, naive.T)
    )
    assert 0.93 < held < 0.98
    assert counted < 0.85
    whole = np.array([wilson(float(one.mean()), float(clusters)) for one in shares])
    assert (np.diff(found) < np.diff(whole)).mean() > 0.95


def test_of_nothing_there_is_no_interval():
    assert np.isnan(clustered_interval(np.zeros(0), 10)).all()
