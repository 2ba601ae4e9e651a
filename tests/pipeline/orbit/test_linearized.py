"""Linear time-varying motion against closed forms, integrators, and figures from the literature."""

import tracemalloc
from functools import partial

import numpy as np
import pytest
from by_brahe import acceleration_by_brahe, flown_by_brahe
from koenig import mean_elements, relative_elements, transition
from numpy.polynomial import chebyshev
from one_swarm import least_separation
from relative import (
    forced,
    linear_flight,
    linear_maps,
    pull,
    to_lvlh,
    true_anomaly,
    yamanaka_ankersen,
)
from scipy.optimize import linprog

from pipeline.expert.decoupled import decoupled_optima
from pipeline.orbit.dynamics import ClohessyWiltshire, Dynamics, cw_matrices
from pipeline.orbit.linearized import LinearizedDynamics
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import MU_EARTH, R_EARTH
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.orbit.transfer import fly, free_drift, minimum_energy

ROUNDING = 3e-11  # of products of many maps, and of small differences; depends on the processor


def orbit_of(e, perigee=500e3, nu=100.0, **others):
    """A reference orbit that begins at a true anomaly, deg."""
    shape = {"inclination_deg": 51.6, "raan_deg": 40.0, "argument_of_perigee_deg": 30.0}
    given = {**shape, "argument_of_latitude_deg": 30.0 + nu, **others}
    return ReferenceOrbit((R_EARTH + perigee) / (1 - e), e, **given)


def period(orbit):
    return 2 * np.pi / orbit.mean_motion


def forces(orbit):
    """Of an orbit, by formulas of the tests."""
    air = None if orbit.ballistic is None else orbit.air
    layer = air and (air.base, air.density, air.scale)
    return partial(pull, j2=orbit.j2, ballistic=orbit.ballistic or 0.0, air=layer)


def state_at(orbit, time):
    """Inertial, by the test's forces but for where the orbit begins."""
    begin = orbit.states(np.zeros(1))[0]
    return linear_maps(begin, np.array([time]), forces(orbit))[2][0]


def misfit(found, truth, rate):
    """Largest error, as a share of the largest entry; velocities count 1/rate s."""
    row = np.repeat([1.0, 1 / rate], 3)
    column = 1 / row if truth.shape[-1] == 6 else np.full(3, rate**2)
    scaled, error = (row[:, None] * one * column for one in (truth, found - truth))
    return (np.abs(error).max(axis=(-2, -1)) / np.abs(scaled).max(axis=(-2, -1))).max()


def test_it_is_a_dynamics():
    assert isinstance(LinearizedDynamics(orbit_of(0.1), 100.0, 3), Dynamics)


@pytest.mark.parametrize("nu", [0.0, 100.0, 180.0, 300.0])
@pytest.mark.parametrize("e", [0.0, 0.01, 0.1, 0.5, 0.85])
def test_about_a_keplerian_orbit_maps_are_those_of_yamanaka_and_ankersen(e, nu):
    """From short intervals to longer ones than an orbit, in an interval and between nodes."""
    orbit = orbit_of(e, nu=nu, j2=False)
    a, rate = orbit.semi_major_axis, orbit.fastest
    for share in (0.02, 0.3, 1.3):
        step = share * period(orbit)
        dynamics = LinearizedDynamics(orbit, step, 2)
        first, second = (true_anomaly(a, e, np.radians(nu), k * step) for k in (0, 1))
        within = yamanaka_ankersen(a, e, second, 0.7 * step)
        A, B = dynamics.step(0.7 * step, 1)
        assert misfit(A, within, rate) < 1e-10
        both = yamanaka_ankersen(a, e, first, 2 * step)
        assert misfit(dynamics.drift(0, 2), both, rate) < 1e-10
        if share < 1:
            assert misfit(B, forced(a, e, second, 0.7 * step), rate) < 1e-11


@pytest.mark.parametrize("step", [10.0, 120.0, 2000.0, 9000.0])
def test_about_a_circle_maps_are_those_of_clohessy_and_wiltshire(step):
    orbit = orbit_of(0.0, j2=False)
    dynamics = LinearizedDynamics(orbit, step, 4)
    circle = ClohessyWiltshire(orbit.mean_motion, step)
    times, k, rate = step * np.array([0.01, 0.35, 1.0]), np.arange(4)[:, None], orbit.mean_motion
    A, B = cw_matrices(rate, times)
    found = dynamics.step(times, k)
    assert misfit(found[0], np.broadcast_to(A, (4, 3, 6, 6)), rate) < 1e-12
    assert misfit(found[1], np.broadcast_to(B, (4, 3, 6, 3)), rate) < 1e-12
    rest = times * 0.6
    found, (A, B) = dynamics.step(rest, k, 0.4 * step), cw_matrices(rate, rest)
    assert misfit(found[0], np.broadcast_to(A, (4, 3, 6, 6)), rate) < 1e-12
    assert misfit(found[1], np.broadcast_to(B, (4, 3, 6, 3)), rate) < ROUNDING  # a difference
    for first, last in ((0, 4), (1, 3), (2, 2), (3, 1)):
        drift = dynamics.drift(first, last), circle.drift(first, last)
        assert misfit(*drift, rate) < 1e-11


@pytest.mark.parametrize(
    ("e", "ballistic"), [(0.0, None), (0.1, 0.02), (0.5, 1.0), (0.8, 5.0)], ids=str
)
def test_with_j2_and_drag_maps_are_those_of_an_integrator(e, ballistic):
    """The variational equations of forces whose derivatives are complex steps, by DOP853."""
    orbit = orbit_of(e, perigee=300e3, ballistic=ballistic)
    step, rate = period(orbit) / 20, orbit.fastest
    dynamics, force = LinearizedDynamics(orbit, step, 20), forces(orbit)
    begin = orbit.states(np.zeros(1))[0]
    A, _, states = linear_maps(begin, step * np.array([1.0, 15.0, 20.0]), force)
    assert misfit(dynamics.drift(0, np.array([1, 15, 20])), A, rate) < 1e-10
    np.testing.assert_allclose(
        orbit.states(step * np.arange(21.0))[[1, 15, 20]], states, rtol=1e-11
    )
    times = step * np.array([0.3, 1.0])
    A, B, _ = linear_maps(states[1], times, force)
    found = dynamics.step(times, 15)
    assert misfit(found[0], A, rate) < 1e-12
    assert misfit(found[1], B, rate) < 1e-12


@pytest.mark.parametrize("e", [0.05, 0.6])
def test_maps_are_derivatives_of_motion_in_brahe(e):
    """Central differences of nonlinear motion, with J2 and drag, in an interval late in a plan."""
    orbit = orbit_of(e, perigee=300e3, ballistic=0.5)
    step, late = period(orbit) / 40, 12
    by, held = (True, orbit.air), (0.5, 0.5)
    begin = orbit.states(np.zeros(1))[0]
    chief = flown_by_brahe(np.tile(begin, 2), np.zeros((late, 3)), by, held, step)[:6]
    force = partial(acceleration_by_brahe, j2=True, air=orbit.air, ballistic=0.5)
    inertial = np.linalg.inv(to_lvlh(chief, force(chief)))

    def moved(state, push):
        start = np.concatenate([chief, chief + inertial @ state])
        end = flown_by_brahe(start, push[None], by, held, step)
        return to_lvlh(end[:6], force(end[:6])) @ (end[6:] - end[:6])

    size = np.repeat([30.0, 30.0 * orbit.fastest, 30.0 * orbit.fastest**2], 3)
    columns = []
    for one in size * np.eye(9):
        ends = [moved(sign * one[:6], sign * one[6:]) for sign in (1, -1)]
        columns.append((ends[0] - ends[1]) / (2 * one.max()))
    truth = np.stack(columns, axis=1)
    A, B = LinearizedDynamics(orbit, step, 20).step(step, late)
    assert misfit(A, truth[:, :6], orbit.fastest) < 1e-8
    assert misfit(B, truth[:, 6:], orbit.fastest) < 1e-8


@pytest.mark.parametrize(
    ("e", "inclination", "share"), [(0.05, 51.6, 0.02), (0.05, 98.0, 0.02), (0.3, 40.0, 0.04)]
)
def test_under_j2_relative_orbits_drift_as_in_koenig_guffanti_and_d_amico(e, inclination, share):
    """Over fifteen orbits, to a share of what J2 does: their matrix and Brouwer's mean elements are
    of the first order in J2, so that what they leave out is a thousandth of it times numbers of the
    order of ten, the larger the more eccentric the orbit."""
    orbit = orbit_of(e, inclination_deg=inclination)
    step, last = period(orbit) / 16, 15 * 16 + 3
    moved = LinearizedDynamics(orbit, step, last).drift(0, last)
    states = orbit.states(np.array([0.0, last * step]))
    force = forces(orbit)
    begin, end = (relative_elements(s) @ np.linalg.inv(to_lvlh(s, force(s))) for s in states)
    found = end @ moved @ np.linalg.inv(begin)
    chief = mean_elements(states[0])
    oblate, round_ = (transition(chief, last * step, one) for one in (True, False))
    effect = np.abs(oblate - round_).max()
    assert effect > 0.2
    assert np.abs(found - oblate).max() < share * effect


def test_a_rendezvous_of_two_impulses_is_that_of_a_textbook():
    """Curtis, "Orbital Mechanics for Engineering Students", ch. 7: a chaser 20 km away on all axes
    is to reach a station on a circle of 300 km in eight hours. All components of the first impulse
    are those of e = 0.00115697 rad/s; its own figures, 7.726 km/s and 6678 km, have four digits."""
    state = np.array([20e3, 20e3, 20e3, -20.0, 20.0, -5.0])
    for rate, near in ((1.15697e-3, 1e-4), (7.726 / 6678, 0.05)):
        orbit = ReferenceOrbit((MU_EARTH / rate**2) ** (1 / 3), j2=False)
        A = LinearizedDynamics(orbit, 8 * 3600 / 16, 16).drift(0, 16)
        impulse = np.linalg.solve(A[:3, 3:], -A[:3] @ state)
        np.testing.assert_allclose(impulse, [29.3575, -66.7512, 13.0297], atol=near)


SIMBOL_X = ReferenceOrbit(106246975.3, 0.798788, argument_of_latitude_deg=135.0, j2=False)
"""The rendezvous of Arzelier and others (2011) and Benedikter and others (2019): 50,002 s from an
anomaly of 135 degrees, at least 1.7913 m/s of impulses in the 1-norm."""

DURATION = 50002.0


def simbol_x_ends():
    """They are given with x along-track and z to the Earth, m and m/s."""
    given = (18309.5, -23764.7, -0.0542, -0.0418), (335.12, -371.1, 0.00155, 0.0014)
    return [np.array([[-z, x, 0.0, -vz, vx, 0.0]]) for x, z, vx, vz in given]


def test_impulses_of_the_simbol_x_rendezvous_cost_what_is_published():
    """By HiGHS, with impulses allowed every 50 s."""
    (initial,), (goal,) = simbol_x_ends()
    dynamics, nodes = LinearizedDynamics(SIMBOL_X, DURATION / 1000, 1000), np.arange(1001)
    kicks = np.concatenate(list(dynamics.drift(nodes, 1000)[..., 3:]), axis=1)
    scale = np.repeat([1.0, DURATION], 3)
    kicks, miss = scale[:, None] * kicks, scale * (goal - dynamics.drift(0, 1000) @ initial)
    found = linprog(np.ones(6006), A_eq=np.hstack([kicks, -kicks]), b_eq=miss, method="highs")
    assert found.fun == pytest.approx(1.7913, abs=5e-5)


def test_arcs_of_the_simbol_x_rendezvous_cost_what_impulses_cost_in_the_limit():
    """An arc's push comes later than an impulse at its start, so what it costs more is of the first
    order in its length: 400 arcs still burn 0.27 percent more, and a thousand 0.1."""
    costs = []
    for intervals in (50, 100):
        problem = Problem(time_step=DURATION / intervals, nodes=intervals + 1).about(SIMBOL_X)
        found = decoupled_optima(*simbol_x_ends(), problem)
        assert found.feasible.all()
        costs.append(found.lower_bound[0] * problem.time_step)
        assert np.abs(found.controls).sum() * problem.time_step == pytest.approx(
            costs[-1], rel=1e-8
        )
    assert costs[0] > costs[1] > 1.7913
    assert 2 * costs[1] - costs[0] == pytest.approx(1.7913, rel=3e-4)


@pytest.mark.parametrize("e", [0.0, 0.1, 0.5, 0.8])
def test_bounds_on_derivatives_hold_and_are_of_use(e):
    """Against Chebyshev derivatives of velocities that an integrator gives, of other degree and
    over other pieces, around perigee and far from it, of random craft. The median bound is below
    three times the truth."""
    orbit, rng = orbit_of(e, nu=-40.0), np.random.default_rng(0)
    step, rate, parts, degree = period(orbit) / 24, orbit.fastest, 12, 13
    dynamics = LinearizedDynamics(orbit, step, 14)
    at, half = -np.cos(np.pi * np.arange(degree + 1) / degree), step / parts / 2
    times = np.concatenate([half * (1 + 2 * p + at[p > 0 :]) for p in range(parts)])
    whole = np.stack([np.arange(p * degree, (p + 1) * degree + 1) for p in range(parts)])
    for k in (0, 3, 12):
        begin = state_at(orbit, k * step) if k else orbit.states(np.zeros(1))[0]
        A, B, _ = linear_maps(begin, times, forces(orbit))
        start = rng.normal(size=(40, 6)) * np.repeat([100.0, 100.0 * rate], 3)
        push = rng.normal(size=(40, 3)) * 100.0 * rate**2 * rng.uniform(size=(40, 1))
        velocity = (start @ A[:, 3:].mT + push @ B[:, 3:].mT)[whole]
        values = np.moveaxis(velocity, 1, 0).reshape(degree + 1, -1)
        fits = chebyshev.chebfit(at, values, degree)
        interval = np.full(40, k)
        fourth = dynamics.linear_motion(k).fourth_derivative_bound(start, push, interval)
        bounds = dynamics.acceleration_bound(start, push, step, interval), fourth
        for order, bound in zip((1, 3), bounds, strict=True):
            slope = chebyshev.chebder(fits, order, 1 / half)
            found = chebyshev.chebval(np.linspace(-1, 1, 9), slope).reshape(parts, 40, 3, 9)
            most = np.linalg.norm(found, axis=2).max(axis=(0, 2))
            assert (bound > most * (1 - 1e-6)).all()
            assert np.median(bound / most) < 3


@pytest.mark.parametrize("e", [0.0, 0.5, 0.85])
def test_maps_do_not_depend_on_how_time_is_cut(e):
    """Into few intervals of many pieces, or many of one."""
    orbit = orbit_of(e, ballistic=0.02)
    step, rate = period(orbit) / 3, orbit.fastest
    coarse, fine = LinearizedDynamics(orbit, step, 3), LinearizedDynamics(orbit, step / 40, 120)
    assert misfit(coarse.drift(0, 3), fine.drift(0, 120), rate) < ROUNDING
    A, B = coarse.step(0.5 * step, 1)
    assert misfit(A, fine.drift(40, 60), rate) < ROUNDING
    steps = fine.step(step / 40, np.arange(120))[1]
    pushed = sum(fine.drift(k + 1, 60) @ steps[k] for k in range(40, 60))
    assert misfit(B, pushed, rate) < ROUNDING
    A, B = coarse.step(0.25 * step, 2, 0.5 * step)
    assert misfit(A, fine.drift(100, 110), rate) < ROUNDING
    pushed = sum(fine.drift(k + 1, 110) @ steps[k] for k in range(100, 110))
    assert misfit(B, pushed, rate) < ROUNDING


@pytest.mark.parametrize("e", [0.0, 0.7])
def test_beyond_a_plan_motion_goes_on(e):
    orbit = orbit_of(e)
    short, long = (LinearizedDynamics(orbit, 200.0, count) for count in (3, 100))
    last = np.array([3, 4, 90])
    assert misfit(short.drift(1, last), long.drift(1, last), orbit.fastest) < 1e-12
    for one, other in zip(short.step(70.0, last), long.step(70.0, last), strict=True):
        assert misfit(one, other, orbit.fastest) < 1e-12


def test_free_drift_from_a_later_time_is_that_of_an_integrator():
    problem = Problem(nodes=4).about(orbit_of(0.6))
    states = np.random.default_rng(1).normal(size=(5, 6)) * np.repeat([100.0, 0.1], 3)
    flown, idle, drift = free_drift(states, problem, 0.7, start=3000.0)
    times = drift.time_step * np.arange(1, drift.nodes)
    A, _, _ = linear_maps(state_at(problem.orbit, 3000.0), times, forces(problem.orbit))
    np.testing.assert_allclose(
        flown[:, 1:], np.einsum("tij,nj->nti", A, states), rtol=1e-8, atol=1e-6
    )
    assert drift.duration == pytest.approx(0.7 * period(problem.orbit))
    np.testing.assert_array_equal(idle, 0.0)
    np.testing.assert_allclose(fly(states, idle, drift), flown, atol=1e-9)


def test_a_plan_begun_at_a_node_has_the_maps_from_there():
    problem = Problem(nodes=9).about(orbit_of(0.6))
    rest = problem.starting_at(5)
    truth = problem.dynamics.step(120.0, np.arange(5, 8))
    for found, expected in zip(rest.dynamics.step(120.0, np.arange(3)), truth, strict=True):
        assert misfit(found, expected, problem.orbit.fastest) < 1e-12
    assert Problem().starting_at(5) == Problem()


def test_states_between_nodes_are_those_of_an_integrator():
    """Under controls that change from interval to interval."""
    problem = Problem(nodes=5, time_step=400.0).about(orbit_of(0.4, ballistic=0.02))
    rng = np.random.default_rng(2)
    states = rng.normal(size=(3, 6)) * np.repeat([100.0, 0.1], 3)
    controls = rng.normal(size=(3, 4, 3)) * 1e-3
    begin = problem.orbit.states(np.zeros(1))[0]
    truth = linear_flight(begin, 400.0, 4, 2, forces(problem.orbit))(states, controls)
    found = fly(states, controls, problem)
    np.testing.assert_allclose(found[:, 1:], truth[:, :, -1], rtol=1e-9, atol=1e-7)
    A, B = problem.dynamics.step(200.0, np.arange(4))
    middle = np.matvec(A, found[:, :-1]) + np.matvec(B, controls)
    np.testing.assert_allclose(middle, truth[:, :, 1], rtol=1e-9, atol=1e-7)


@pytest.mark.parametrize("e", [0.0, 0.6])
def test_the_least_separation_in_long_intervals_is_that_of_an_integrator(e):
    """Of many pieces, each searched by itself where cubics are far from the motion."""
    orbit = orbit_of(e)
    step, parts, rng = 0.4 * period(orbit), 4000, np.random.default_rng(4)
    problem = Problem(time_step=step, nodes=4).about(orbit)
    initial, goal = rng.normal(size=(2, 4, 6)) * np.repeat([2e3, 2e3 * orbit.mean_motion], 3)
    controls = minimum_energy(initial, goal, problem)
    states = fly(initial, controls, problem)
    found = least_separation(states, controls, problem)
    flight = linear_flight(orbit.states(np.zeros(1))[0], step, 3, parts, forces(orbit))
    flown = flight(initial, controls)[..., :3]
    i, j = np.triu_indices(4, 1)
    apart = np.linalg.norm(flown[i] - flown[j], axis=-1)
    moved = np.linalg.norm(np.diff(flown[i] - flown[j], axis=2), axis=-1)
    least = apart.min()
    assert found.distance <= least + 1e-4
    assert (apart[..., :-1] - moved).min() <= found.bound + 1e-4
    assert found.distance - found.bound < 1e-3
    pair = int(np.flatnonzero((i == found.pair[0]) & (j == found.pair[1]))[0])
    k, part = divmod(round(found.time / step * parts), parts)
    assert apart[pair, min(k, 2), part] == pytest.approx(found.distance, abs=moved[pair].max())


def test_searching_long_intervals_takes_little_memory():
    """Of sixty, where nearly all craft are far apart."""
    problem = Problem(time_step=1000.0, nodes=61).about(orbit_of(0.0))
    initial, goal = np.random.default_rng(0).normal(size=(2, 4, 6)) * np.repeat([300.0, 0.1], 3)
    controls = minimum_energy(initial, goal, problem)
    states = fly(initial, controls, problem)
    tracemalloc.start()
    least_separation(states, controls, problem)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 50e6


def test_maps_over_many_pieces_take_little_memory():
    """Over two and a half orbits of e = 0.85, in pieces that the perigee makes short: a few times
    what is kept, 17 MB."""
    orbit = orbit_of(0.85)
    tracemalloc.start()
    found = LinearizedDynamics(orbit, period(orbit) / 16, 40).arcs
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert 2 * found.maps.nbytes < 17e6
    assert peak < 80e6
