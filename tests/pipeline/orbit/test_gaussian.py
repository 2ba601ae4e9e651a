"""Gaussian probabilities against numerical integration, cases by hand and dense directions."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from pipeline.orbit.risk import crossing_probability, likeliest_direction


def below(mean, deviation, step, correlation, step_deviation):
    given = mean, deviation**2, step, correlation * deviation * step_deviation, step_deviation**2
    return float(crossing_probability(*(np.array([one], dtype=float) for one in given))[0])


def test_the_probability_of_falling_below_zero_is_that_of_the_bivariate_normal_distribution():
    rng = np.random.default_rng(0)
    for _ in range(60):
        mean, step = rng.normal(size=2)
        deviation, step_deviation = rng.uniform(0.2, 2.0, size=2)
        correlation = rng.uniform(-0.95, 0.95)
        mixed = correlation * deviation * step_deviation
        after = deviation**2 + 2 * mixed + step_deviation**2
        # of -X and X + D
        covariance = [[deviation**2, -(deviation**2) - mixed], [-(deviation**2) - mixed, after]]
        truth = multivariate_normal([-mean, mean + step], covariance).cdf([0, 0])
        found = below(mean, deviation, step, correlation, step_deviation)
        assert found == pytest.approx(truth, abs=1e-7)


@pytest.mark.parametrize(
    ("given", "truth"),
    [
        ((2.0, 1.0, 0.0, 0.0, 0.0), 0.0),  # nothing changes
        ((2.0, 0.0, -3.0, 0.0, 1.0), norm.cdf(1.0)),  # the first is known
        ((0.5, 1.0, -1.0, 0.0, 0.0), norm.cdf(0.5) - norm.cdf(-0.5)),  # the step is known
        ((1.0, 2.0, 0.0, -1.0, 4.0), norm.cdf(-0.5)),  # X + D is 2 - X
        ((3.0, 1.0, -2.0, -1.0, 1.0), 0.0),  # and is known in the end, to be above
        ((1.0, 1.0, -1e-9, 0.0, 0.0), 1e-9 * norm.pdf(1.0)),
        ((0.0, 0.0, 0.0, 0.0, 0.0), 0.0),
    ],
)
def test_falling_below_zero_where_something_is_known(given, truth):
    assert below(*given) == pytest.approx(truth, rel=1e-6, abs=1e-15)


@pytest.mark.parametrize("known", [0, 1, 2, 3])
def test_no_direction_has_more_standard_deviations_before_its_plane(known):
    """Of 200 000 directions, in three dimensions of which some are known."""
    rng = np.random.default_rng(known)
    points = rng.normal(size=(200_000, 3))
    points /= np.linalg.norm(points, axis=1)[:, None]
    for _ in range(10):
        mean, root = rng.normal(size=3), rng.normal(size=(3, 3))
        mean *= rng.uniform(15.5, 40) / np.linalg.norm(mean)
        root[:, 3 - known :] = 0.0
        covariance = root @ root.T
        (found,) = likeliest_direction(mean[None], covariance[None], 15.0)

        def levels(n, mean=mean, root=root):
            return (n @ mean - 15) / np.maximum(np.linalg.norm(n @ root, axis=-1), 1e-6)

        assert np.linalg.norm(found) == pytest.approx(1)
        assert levels(found) >= levels(points).max() * (1 - 1e-3)
