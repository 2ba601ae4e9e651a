"""Probabilities of Gaussian variables that bounds on the risk of a collision are made of."""

import numpy as np

from pipeline.arrays import Array, Float
from pipeline.orbit.arrays import Values, Vectors
from pipeline.orbit.bezier import norm

TINY = 1e-100  # divisor in place of 0
APART = 1e-30  # least distance in m that has a direction
NEWTON_STEPS = 8  # more than enough near the likeliest point; any direction gives a bound


def falls_below(
    mean: Values, variance: Values, step: Values, mixed: Values, step_variance: Values
) -> Values:
    """P(X ≥ 0, X + D < 0) of jointly Gaussian X and D, by Owen's T function.

    Owen 1956, "Tables for computing bivariate normal probabilities". Means and variances are of X
    and of the step D, since X + D may be all but X itself; ``mixed`` is their covariance.
    """
    from scipy.special import ndtr, owens_t  # slow to import, and only a risk needs it

    after, variance_after = mean + step, np.maximum(variance + 2 * mixed + step_variance, 0.0)
    rest = step_variance - mixed**2 / np.maximum(variance, TINY)  # of D, given X
    rest = np.maximum(np.sqrt(np.maximum(rest, 0.0)), TINY)
    before, after = (np.where(one == 0, TINY, one) for one in (mean, after))
    sigma, sigma_after = (np.maximum(np.sqrt(v), TINY) for v in (variance, variance_after))
    with np.errstate(over="ignore"):
        slope = (step - mixed / sigma**2 * before) * sigma / (before * rest)
        back = (mixed + step_variance) / sigma_after**2 * after - step
        slope_after = back * sigma_after**2 / (sigma * after * rest)
    u, v = before / sigma, after / sigma_after
    chance = (ndtr(-v) - ndtr(-u)) / 2 + owens_t(u, slope) + owens_t(v, slope_after)
    return np.maximum(chance + np.where((u > 0) == (v > 0), 0.0, 0.5), 0.0)


def likeliest_direction(mean: Vectors, covariance: Float[Array, "k 3 3"], radius: float) -> Vectors:
    """Unit vectors to the points of a sphere at which Gaussian points outside it are likeliest.

    The plane through the likeliest point q of the sphere that is square to it is the one that the
    most standard deviations lie before (the first-order reliability method). Lagrange's rule gives
    (1 + μ Σ) q = mean, with μ from ‖q‖ = radius by Newton's method on 1/‖q‖. Means and the radius
    in m, covariances in m².
    """
    spread, axes = np.linalg.eigh(covariance)
    spread = np.maximum(spread / np.maximum(spread[:, -1:], TINY), 0.0)
    along, multiplier = np.vecmat(mean, axes), np.zeros((len(mean), 1))
    for _ in range(NEWTON_STEPS):
        point = along / (1 + multiplier * spread)
        far = np.maximum(norm(point), APART)[:, None]
        slope = (point**2 * spread / (1 + multiplier * spread)).sum(axis=1, keepdims=True) / far**3
        step = (1 / radius - 1 / far) / np.where(slope > 0, slope, np.inf)
        multiplier = np.clip(multiplier + step, 0.0, 1 / TINY**0.1)
    point = along / (1 + multiplier * spread)
    return np.matvec(axes, point / np.maximum(norm(point), APART)[:, None])
