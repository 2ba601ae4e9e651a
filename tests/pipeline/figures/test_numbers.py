"""Numbers as a reader wants them."""

import pytest

from pipeline.figures.labels import count, error, number, ratio, share


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (0.04996, "0.0500"),
        (1.906, "1.91"),
        (99.96, "100"),
        (12345.6, "12,346"),
        (2.27e-13, "2.27e-13"),
        (0.00123, "0.00123"),
        (0.00099999, "0.00100"),
        (-0.5, "-0.500"),
        (float("nan"), "–"),
        (float("inf"), "∞"),
    ],
)
def test_numbers_have_three_significant_digits(value, text):
    assert number(value) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1.0, "100 %"),
        (0.0, "0 %"),
        (0.9999, "> 99.9 %"),
        (0.0001, "< 0.1 %"),
        (0.25, "25 %"),
        (0.996, "99.6 %"),
        (float("nan"), "–"),
    ],
)
def test_shares_read_all_or_nothing_only_where_they_are(value, text):
    assert share(value) == text


def test_ratios_counts_and_errors_suit_their_kind():
    assert (ratio(1.0111), ratio(26.54), count(1234.0)) == ("1.011", "26.5", "1,234")
    assert (error(3e-13), error(0.02), error(float("nan"))) == ("< 1e-6", "0.0200", "–")
