"""The bound on the risk held against Alfano's conjunctions, of which the probability is known."""

from functools import cache

import numpy as np
import pytest
from alfano import CASES, flown, trials
from relative import MU
from scipy.integrate import quad
from scipy.special import ndtr
from trials import wilson

from pipeline.orbit.covariance import Dispersion
from pipeline.orbit.inertial import lvlh_frame
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.orbit.risk import collision_risk

NODES = 201
SHARE, WEIGHT = np.polynomial.legendre.leggauss(32)
WIDTH = 7.0  # of a quadrature over so many standard deviations

# How much larger than published the bound may be, of craft that are far apart at first
LOOSE = {1: 2.2, 2: 12, 3: 1.8, 4: 1.6, 5: 1.1, 6: 1.5, 7: 17, 8: 3, 10: 1.4}


@cache
def linear(case):
    """States, controls, problem and dispersion of a conjunction, about the first craft's orbit."""
    middle, before = case.craft[0].inertial, flown(case.craft[0].inertial[None], -case.half)[0]
    orbit = ReferenceOrbit.through(before, j2=False)
    step = 2 * case.half / (NODES - 1)
    problem = Problem(time_step=step, nodes=NODES, collision_radius=case.radius).about(orbit)
    nodes = np.stack([problem.dynamics.drift(0, k) for k in range(NODES)])
    nodes = nodes @ np.linalg.inv(nodes[NODES // 2])
    frame = lvlh_frame(middle, -MU * middle[:3] / np.linalg.norm(middle[:3]) ** 3)
    states, roots = [], []
    for craft in case.craft:
        values, axes = np.linalg.eigh(craft.covariance)
        root = axes * np.sqrt(np.maximum(values, 0.0))
        states.append(nodes @ frame.from_inertial(craft.inertial - middle))
        roots.append(nodes @ frame.from_inertial(root.T).T)
    none = np.zeros((2, NODES - 1, 3))
    covariance = np.zeros((2, NODES, 9, 9))
    covariance[..., :6, :6] = np.stack(roots) @ np.stack(roots).mT
    spread = Dispersion(covariance, np.zeros((*none.shape, 3)), 6)
    return np.stack(states), none, problem, spread


def entries(mean, covariance, radius):
    """Mean rate at which Gaussian states enter a sphere, 1/s, by Rice's formula.

    The flux of their density through it, at points a along the least error, and at angles ψ about
    that axis where errors along the second axis are (the area is radius da dψ).
    """
    placed = covariance[:3, :3]
    variances, axes = np.linalg.eigh(placed)
    middle, most = axes.T @ mean[:3], WIDTH * np.sqrt(variances)
    low, high = np.clip(middle[0] + np.array([-1, 1]) * most[0], -radius, radius)
    least = (low + high + SHARE * (high - low)) / 2
    ring = np.sqrt(radius**2 - least**2)[:, None]
    sides = (middle[1] + np.array([-1, 1]) * most[1]) / np.maximum(ring, 1e-12)
    low_angle, high_angle = np.arcsin(np.clip(sides, -1, 1)).T[..., None]
    angle = (low_angle + high_angle + SHARE * (high_angle - low_angle)) / 2
    area = np.outer(WEIGHT, WEIGHT) * (high - low) / 2 * (high_angle - low_angle) / 2 / radius
    across = [np.broadcast_to(least[:, None], angle.shape), ring * np.sin(angle)]
    caps = [np.stack([*across, sign * ring * np.cos(angle)], axis=-1) for sign in (1, -1)]
    out = np.stack(caps).reshape(-1, 3) @ axes.T / radius
    away = (radius * out - mean[:3]) @ axes / np.sqrt(variances)
    density = np.exp(-np.vecdot(away, away) / 2) / np.sqrt((2 * np.pi) ** 3 * variances.prod())
    gain = covariance[3:, :3] @ np.linalg.inv(placed)
    rest = covariance[3:, 3:] - gain @ covariance[:3, 3:]
    inward = -np.vecdot(out, mean[3:] + (radius * out - mean[:3]) @ gain.T)
    sigma = np.sqrt(np.maximum(np.vecdot(out @ rest, out), 1e-30))
    ratio = inward / sigma
    flux = sigma * np.exp(-(ratio**2) / 2) / np.sqrt(2 * np.pi) + inward * ndtr(ratio)
    return radius**2 * np.sum(np.tile(area.ravel(), 2) * density * flux)


def expected_entries(states, _, problem, spread):
    """Over the whole time, at moments that are dense about the closest approach."""
    gap, errors, step = (
        states[1] - states[0],
        spread.covariance[..., :6, :6].sum(axis=0),
        problem.time_step,
    )

    def rate(along):
        time = problem.duration / 2 * (1 + along**3)
        k = int(min(time // step, NODES - 2))
        to = problem.dynamics.step(time - k * step, k)[0]
        found = entries(to @ gap[k], to @ errors[k] @ to.T, problem.collision_radius)
        return found * 3 * along**2 * problem.duration / 2

    return quad(rate, -1, 1, points=np.linspace(-0.8, 0.8, 9), epsrel=5e-4, limit=200)[0]


@pytest.mark.parametrize("number", CASES)
def test_craft_with_given_covariances_enter_the_radius_as_often_as_is_published(number):
    """Linear motion and our covariances against "3D-Nc", which is two-body in other elements; and
    against trials, where craft within the radius at first do not count."""
    case = CASES[number]
    found = expected_entries(*linear(case))
    assert found == pytest.approx(case.entries, rel=3e-3)


@pytest.mark.parametrize(("number", "most"), LOOSE.items())
def test_the_bound_is_above_what_is_published(number, most):
    case = CASES[number]
    found = collision_risk(*linear(case)).total
    assert case.entered[1] < found < most * case.entries


@pytest.mark.parametrize(("number", "most"), [(9, 1.3), (11, 1.5), (12, 1.5)])
def test_craft_that_stay_near_each_other_are_within_the_radius_at_most_as_often_as_bounded(
    number, most
):
    """At first, and at any time, by two-body motion; published are those that enter it alone."""
    case, count = CASES[number], 20_000
    states, controls, problem, spread = linear(case)
    risk = collision_risk(states, controls, problem, spread)
    begins, ever = trials(case, count, pieces=40)
    lower, upper = wilson(int((ever & ~begins).sum()), count)
    assert lower < case.entered[1]
    assert case.entered[0] < upper
    lower, upper = wilson(int(ever.sum()), count)
    assert lower < risk.total < most * upper
    lower, upper = wilson(int(begins.sum()), count)
    assert lower < risk.at_ends[0]
