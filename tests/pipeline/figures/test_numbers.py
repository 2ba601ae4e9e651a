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


@pytest.mark.parametrize(
    ("form", "value", "spread", "said"),
    [
        (number, 1.9, 0.0472, "1.90 ± 0.05"),
        (number, 0.057, 1e-5, "0.0570 ± < 0.0001"),
        (number, 1.9, 0.0, "1.90 ± 0"),
        (number, 1234.0, 1001.0, "1,234 ± 1,001"),
        (number, 7.45e-4, 1e-5, "7.45e-4 ± 1.00e-5"),
        (number, 0.0, 0.03, "0 ± 0.0300"),
        (number, float("nan"), float("nan"), "–"),
        (ratio, 1.0111, 0.0004, "1.011 ± < 0.001"),
        (share, 0.44, 0.021, "44.0 % ± 2.1 %"),
        (share, 0.44, 0.05, "44 % ± 5 %"),
        (share, 0.45, 0.0004, "45.0 % ± < 0.1 %"),
        (share, 1.0, 0.0, "100 % ± 0 %"),
    ],
)
def test_a_spread_has_as_many_decimals_as_its_value(form, value, spread, said):
    assert form(value, spread) == said
