"""Newcombe's interval, against published examples, and the rule of verdicts."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.figures.intervals import at_least, at_most, newcombe


def pairs(both, first, second, neither):
    """Trials in which both succeed, just one of them, or none."""
    a = np.repeat([1.0, 1.0, 0.0, 0.0], [both, first, second, neither])
    b = np.repeat([1.0, 0.0, 1.0, 0.0], [both, first, second, neither])
    return a, b


def test_newcombes_interval_is_that_of_the_literature():
    # Airway hyper-responsiveness before and after transplantation: M. Fagerland, S. Lydersen,
    # P. Laake, "Recommended tests and confidence intervals for paired binomial proportions",
    # Statistics in Medicine 33, 2014.
    assert newcombe(*pairs(1, 1, 7, 12)) == pytest.approx((-0.507, -0.026), abs=5e-4)


COUNTS = st.integers(0, 60)


@given(COUNTS, COUNTS, COUNTS, COUNTS)
def test_newcombes_interval_stays_within_one_and_holds_the_difference(a, b, c, d):
    first, second = pairs(a, b, c, d)
    low, high = newcombe(first, second)
    if a + b + c + d == 0:
        assert np.isnan([low, high]).all()
        return
    difference = first.mean() - second.mean()
    assert -1 - 1e-12 <= low <= difference + 1e-12
    assert difference - 1e-12 <= high <= 1 + 1e-12
    swapped = newcombe(second, first)
    assert (-swapped[1], -swapped[0]) == pytest.approx((low, high), abs=1e-12)


def test_a_claim_is_open_where_its_threshold_lies_within_the_interval():
    assert [at_least(x, 0.95) for x in ((0.95, 1.0), (0.94, 1.0), (0.9, 0.94))] == [
        *(True, None, False)
    ]
    assert [at_most(x, 1.1) for x in ((1.0, 1.1), (1.0, 1.2), (1.11, 1.2))] == [True, None, False]
    assert at_least((float("nan"),) * 2, 0.5) is None
