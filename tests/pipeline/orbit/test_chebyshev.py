"""Chebyshev interpolation, integrals and bounds on derivatives, against polynomials."""

import numpy as np
import pytest
from numpy.polynomial import Polynomial

from pipeline.orbit.chebyshev import (
    COEFFICIENTS,
    INTEGRAL,
    NODES,
    POINTS,
    basis,
    derivative_bound,
)

AT = np.linspace(-1, 1, 400)


def polynomials(seed):
    rng = np.random.default_rng(seed)
    return [Polynomial(rng.normal(size=POINTS)) for _ in range(5)]


def test_points_ascend_from_end_to_end():
    assert NODES[0] == -1
    assert NODES[-1] == 1
    assert (np.diff(NODES) > 0).all()


def test_polynomials_of_as_many_coefficients_as_points_are_met_everywhere():
    for one in polynomials(0):
        np.testing.assert_allclose(basis(AT) @ COEFFICIENTS @ one(NODES), one(AT), atol=1e-13)


def test_integrals_begin_at_the_first_point():
    for one in polynomials(1):
        whole = one.integ(lbnd=-1)
        np.testing.assert_allclose(INTEGRAL @ one(NODES), whole(NODES), atol=1e-13)


@pytest.mark.parametrize("order", [1, 3])
def test_derivatives_are_bounded(order):
    """Over pieces of other lengths than 2; attained at an end where all coefficients agree."""
    half = 30.0
    for one in polynomials(2):
        attained = np.abs(one.deriv(order)(AT)).max() / half**order
        (bound,) = derivative_bound(one(NODES)[:, None], order, half)
        assert attained * (1 - 1e-12) <= bound < 5 * attained
    same = np.polynomial.Chebyshev(np.ones(POINTS))
    (bound,) = derivative_bound(same(NODES)[:, None], order, half)
    assert bound == pytest.approx(same.deriv(order)(1.0) / half**order, rel=1e-10)
