"""Whole flights about an orbit: one arc after the other, and as an integrator flies them."""

from functools import partial

import numpy as np
import pytest
from relative import flight, pull

from pipeline.flight.world import NonlinearWorld
from pipeline.orbit.nonlinear import NonlinearFlight
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import R_EARTH
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.orbit.rings import pro_states
from pipeline.orbit.transfer import fly

RING = pro_states(300.0, 0.6, np.arange(4) * 1.5, 0.3, Problem().mean_motion)


def case(e, time_step, nodes, **changed):
    """A problem about an orbit, and random controls that move craft by about a kilometre."""
    orbit = ReferenceOrbit((R_EARTH + 500e3) / (1 - e), e, 51.6, 40.0, 30.0, 10.0, **changed)
    problem = Problem(time_step=time_step, nodes=nodes).about(orbit)
    rng = np.random.default_rng(nodes)
    size = 1000.0 / time_step**2 / problem.intervals**1.5
    return problem, rng.normal(0, size, (4, problem.intervals, 3))


CASES = {
    "one window": case(0.01, 120.0, 11),
    "many intervals": case(0.01, 100.0, 91),
    "windows within an interval": case(0.1, 7000.0, 4),
    "an eccentric orbit": case(0.8, 200.0, 61),
    "drag": case(0.01, 600.0, 21, ballistic=0.05, spread=0.9),
}


@pytest.mark.parametrize("name", CASES)
def test_a_flight_is_that_of_arcs_one_after_the_other(name):
    problem, controls = CASES[name]
    flown = NonlinearFlight(RING, controls, problem)
    states, apart = flown.states, flown.separation()
    world, state = NonlinearWorld.of(problem, 4), RING
    begin, least = states[:, 0], np.inf
    assert np.array_equal(begin, RING)
    for k in range(problem.intervals):
        arc = world.arc(state, controls[:, k], k)
        gaps = arc[:, None, ..., :3] - arc[None, ..., :3]
        gaps = np.linalg.norm(gaps, axis=-1)[np.triu_indices(4, 1)]
        least, state = min(least, gaps.min()), arc[:, -1, -1]
        assert np.abs(state - states[:, k + 1])[:, :3].max() < 1e-6
        assert np.abs(state - states[:, k + 1])[:, 3:].max() < 1e-9
    assert apart.bound <= apart.distance <= least + 1e-6
    assert 0 <= apart.time <= problem.duration


@pytest.mark.parametrize("name", ["windows within an interval", "an eccentric orbit"])
def test_a_flight_deviates_from_linear_motion_by_what_lies_between_them(name):
    """At any time, nodes included; the linear motion starts anew at each node."""
    problem, controls = CASES[name]
    flown, planned = NonlinearFlight(RING, controls, problem), fly(RING, controls, problem)
    step, rng = problem.time_step, np.random.default_rng(1)
    times = np.sort(np.append(rng.uniform(0, problem.duration, 50), [0.0, step, problem.duration]))
    off = flown.from_linear_at(planned, times)
    assert np.abs(off).max() > 0.1
    for place, time in zip(np.moveaxis(off, 1, 0), times, strict=True):
        k = min(int(time // step), problem.intervals - 1)
        A, B = problem.dynamics.step(np.array([time - k * step]), np.array([k]))
        linear = planned[:, k] @ A[0].T + controls[:, k] @ B[0].T
        since = np.full((problem.intervals, 1), time - k * step)
        there = flown.between(since)[:, k, 0]
        np.testing.assert_allclose(place, (there - linear)[:, :3], atol=1e-6)


@pytest.mark.parametrize("name", CASES)
def test_an_integrator_flies_to_the_same_nodes_and_comes_no_nearer(name):
    problem, controls = CASES[name]
    orbit = problem.orbit
    held = np.zeros(5)
    if orbit.ballistic is not None:
        held = orbit.ballistic * (1 + orbit.spread * np.array([0, -1, -1 / 3, 1 / 3, 1]))
    air = orbit.air.base, orbit.air.density, orbit.air.scale
    force = partial(pull, j2=True, ballistic=held, air=air)
    begin, parts = orbit.states(np.zeros(1))[0], max(2, 600 // problem.intervals)
    truth = flight(begin, RING, controls, (problem.time_step, parts), force)
    flown = NonlinearFlight(RING, controls, problem)
    states, apart = flown.states, flown.separation()
    assert np.abs(truth[:, :, -1] - states[:, 1:])[..., :3].max() < 1e-5
    assert np.abs(truth[:, :, -1] - states[:, 1:])[..., 3:].max() < 1e-8
    i, j = np.triu_indices(4, 1)
    looks = np.linalg.norm((truth[i] - truth[j])[..., :3], axis=-1)
    pair, interval, _ = np.unravel_index(looks.argmin(), looks.shape)
    assert apart.bound - 1e-5 <= looks.min() < apart.distance + 2.0
    assert apart.pair == (i[pair], j[pair])
    begin = interval * problem.time_step
    assert begin - problem.time_step <= apart.time <= begin + 2 * problem.time_step
    times = np.linspace(0, problem.time_step, parts + 1)
    A, B = problem.dynamics.step(times, np.arange(problem.intervals)[:, None])
    linear = np.matvec(A, states[:, :-1, None]) + np.matvec(B, controls[:, :, None])
    off = np.linalg.norm((truth - linear)[..., :3], axis=-1).max()
    assert off - 1e-5 <= flown.deviation(states) <= 1.5 * off
