"""The nonlinear world against Kepler, secular rates, derivatives and the propagator of brahe."""

from dataclasses import replace
from itertools import pairwise

import brahe
import numpy as np
import pytest
from by_brahe import acceleration_by_brahe, flown_by_brahe
from scipy.integrate import solve_ivp

from pipeline.errors import InputError, ProlearnError
from pipeline.flight.world import LinearWorld, NonlinearWorld, World
from pipeline.orbit.forces import Atmosphere, atmosphere_near
from pipeline.orbit.inertial import Elements, Frame, lvlh_frame
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import J2, MU_EARTH, R_EARTH, mean_motion_at, radius_at
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.orbit.rings import pro_states

N = mean_motion_at(500e3)
A = radius_at(N)

ECCENTRIC = Elements(A, np.deg2rad(51.6), 0.7, 0.01, 1.1)
ORBIT = ReferenceOrbit(A, 0.01, 51.6, *np.rad2deg([0.7, 1.1, 0.4]).tolist())

RING = pro_states(300.0, 0.6, np.arange(4) * 1.5, 0.3, N)

IDLE = np.zeros((4, 3))

PUSHES = np.random.default_rng(3).normal(0, 2e-3, (10, 4, 3))
"""Controls of ten arcs, m/s²."""


def kepler(state, time):
    """Two-body motion in closed form: Kepler's equation for the step in eccentric anomaly."""
    r, v = state[:3], state[3:]
    r0, a = np.linalg.norm(r), 1 / (2 / np.linalg.norm(r) - v @ v / MU_EARTH)
    n, root = np.sqrt(MU_EARTH / a**3), np.sqrt(MU_EARTH * a)
    c, s = 1 - r0 / a, r @ v / root  # e cos E, e sin E at the start
    step = n * time
    for _ in range(50):
        short = step - c * np.sin(step) + s * (1 - np.cos(step)) - n * time
        step -= short / (1 - c * np.cos(step) + s * np.sin(step))
    f = 1 - a / r0 * (1 - np.cos(step))
    g = time - (step - np.sin(step)) / n
    position = f * r + g * v
    far = np.linalg.norm(position)
    fdot, gdot = -root / (far * r0) * np.sin(step), 1 - a / far * (1 - np.cos(step))
    return np.concatenate([position, fdot * r + gdot * v])


def by_cross_products(origin, states):
    """Inertial states of craft beside an unperturbed orbit, as textbooks have it."""
    r, v = origin[:3], origin[3:]
    h = np.cross(r, v)
    radial, cross = r / np.linalg.norm(r), h / np.linalg.norm(h)
    turn = np.stack([radial, np.cross(cross, radial), cross])
    position = states[:, :3] @ turn
    velocity = states[:, 3:] @ turn + np.cross(h / (r @ r), position)
    return np.hstack([r + position, v + velocity])


def world_of(step=120.0, intervals=10, n=1, **changed):
    """About the eccentric orbit, with what is changed."""
    return NonlinearWorld(replace(ORBIT, **changed), step, intervals, n)


def flown(world, states, controls):
    """States after every arc."""
    for k, push in enumerate(controls):
        states = world.arc(states, push, k)[:, -1, -1]
    return states


def test_it_is_a_world():
    assert isinstance(world_of(), World)


@pytest.mark.parametrize("time", [7.0, 120.0, 6000.0])
def test_without_perturbations_craft_obey_keplers_equation(time):
    world = world_of(time, 1, j2=False)
    start = ECCENTRIC.states(np.array(0.4))
    end = kepler(start, time)
    exact = np.array([kepler(one, time) for one in by_cross_products(start, RING)])
    states = world.arc(RING, IDLE, 0)[:, -1, -1]
    assert np.abs(world.orbit.states(np.array([time]))[0] - end)[:3].max() < 1e-5
    assert np.abs(by_cross_products(end, states) - exact)[:, :3].max() < 1e-6
    assert np.abs(by_cross_products(end, states) - exact)[:, 3:].max() < 1e-9


def test_several_revolutions_in_an_interval_are_keplers():
    """Craft that drift hundreds of kilometres away, about an orbit with e = 0.7."""
    semi_major_axis, time = 2.6e7, 120_000.0  # about three revolutions
    orbit = ReferenceOrbit(semi_major_axis, 0.7, 51.0, 0.0, 20.0, 10.0, j2=False)
    states = np.array([[200.0, 0, 0, 0, 0, 0], [0, 2000.0, 0, 0, 0, 0]])
    start = orbit.begin
    exact = np.array([kepler(one, 2 * time) for one in by_cross_products(start, states)])
    end = flown(NonlinearWorld(orbit, time, 2, 2), states, np.zeros((2, 2, 3)))
    found = by_cross_products(kepler(start, 2 * time), end)
    assert np.abs(end[:, 1]).max() > 1e5
    assert np.abs(found - exact)[:, :3].max() < 1e-4
    assert np.abs(found - exact)[:, 3:].max() < 1e-8


def test_elements_are_those_of_the_state():
    states = ECCENTRIC.states(np.linspace(0, 6, 50))
    r, v = states[:, :3], states[:, 3:]
    far, h = np.linalg.norm(r, axis=1), np.cross(r, v)
    energy = np.vecdot(v, v) / 2 - MU_EARTH / far
    np.testing.assert_allclose(-MU_EARTH / (2 * energy), A, rtol=1e-12)
    pointed = np.cross(v, h) / MU_EARTH - r / far[:, None]  # to the perigee
    by_hand = brahe.state_koe_to_eci(
        np.array([A, 0.01, ECCENTRIC.inclination, 0.7, 1.1, 0.0]), brahe.AngleFormat.RADIANS
    )
    perigee = by_hand[:3] / np.linalg.norm(by_hand[:3])
    np.testing.assert_allclose(pointed, np.tile(0.01 * perigee, (50, 1)), atol=1e-14)
    cross = np.cross(by_hand[:3], by_hand[3:])
    np.testing.assert_allclose(np.cross(h, cross), 0, atol=1e-12 * np.abs(h).max() ** 2)


def test_j2_turns_node_and_perigee_at_their_secular_rates():
    orbit = replace(ORBIT, inclination_deg=np.rad2deg(0.5), eccentricity=0.05)
    period, orbits, share = 2 * np.pi / N, 6, np.arange(12) / 12
    means = []
    for first in (0, orbits):
        states = orbit.states((first + share) * period)
        r, v = states[:, :3], states[:, 3:]
        h = np.cross(r, v)
        node = np.arctan2(h[:, 0], -h[:, 1])
        pointed = np.cross(v, h) / MU_EARTH - r / np.linalg.norm(r, axis=1)[:, None]
        to_node = np.stack([np.cos(node), np.sin(node), 0 * node], axis=1)
        ahead = np.cross(h, to_node) / np.linalg.norm(h, axis=1)[:, None]
        perigee = np.arctan2(np.vecdot(pointed, ahead), np.vecdot(pointed, to_node))
        means.append((node.mean(), perigee.mean()))
    (node, perigee), (later_node, later_perigee) = means
    rate = 1.5 * N * J2 * (R_EARTH / (A * (1 - 0.05**2))) ** 2
    time = orbits * period
    assert (later_node - node) / time == pytest.approx(-rate * np.cos(0.5), rel=0.01)
    expected = rate * (2 - 2.5 * np.sin(0.5) ** 2)
    assert (later_perigee - perigee) / time == pytest.approx(expected, rel=0.01)


def test_what_the_linear_model_leaves_out_falls_with_the_square_of_the_ring():
    problem = Problem(time_step=1500.0)
    world = NonlinearWorld(ReferenceOrbit(A, j2=False), 1500.0, 1)
    linear = LinearWorld(problem.dynamics)
    missed = []
    for size in (4.0, 2.0, 1.0):
        ends = [each.arc(size * RING, IDLE, 0)[:, -1, -1] for each in (world, linear)]
        missed.append(np.linalg.norm(ends[0] - ends[1], axis=1))
    assert missed[0].min() > 1e-3
    for far, near in pairwise(missed):
        np.testing.assert_allclose(far / near, 4.0, rtol=0.01)


def test_velocities_are_the_derivatives_of_positions_in_the_turning_frame():
    """By numpy's own polynomials; on an orbit whose plane J2 turns, and whose speed changes."""
    arc = world_of(200.0, 3).arc(RING, PUSHES[0], 2)[:, 0]
    points, half = -np.cos(np.pi * np.arange(12) / 11), 100.0
    for craft in arc:
        for axis in range(3):
            curve = np.polynomial.Polynomial.fit(points, craft[:, axis], 11)
            assert curve.deriv()(points) / half == pytest.approx(craft[:, 3 + axis], abs=5e-9)


def test_there_and_back_is_exact():
    rng = np.random.default_rng(0)
    origin = ECCENTRIC.states(rng.uniform(0, 6, 50))
    frame = lvlh_frame(origin, rng.normal(0, 1e-2, (50, 3)))
    states = rng.normal(0, 1e3, (7, 50, 6))
    back = frame.from_inertial(frame.to_inertial(states))
    np.testing.assert_allclose(back, states, atol=1e-9)
    still = Frame(frame.axes, np.zeros((50, 3)))
    assert np.abs(still.to_inertial(states) - frame.to_inertial(states)).max() > 0.5


def by_runge_kutta(world, states, push, interval, dragged=None, part=(0.0, 1.0)):
    """End of an arc by DOP853, each craft's difference from the reference by itself."""
    orbit, h = world.orbit, (part[1] - part[0]) * world.time_step
    origin = orbit.states(np.array([0.0, (interval + part[0]) * world.time_step]))[1]
    held = np.zeros(len(states)) if dragged is None else dragged
    own = orbit.ballistic or 0.0
    ends = []
    for state, control, coefficient in zip(states, push, held, strict=True):
        apart = lvlh_frame(origin, orbit.acceleration(origin, own)).to_inertial(state)

        def motion(_, both, control=control, coefficient=coefficient):
            reference, apart = both[:6], both[6:]
            pull = orbit.acceleration(reference, own)
            axes = lvlh_frame(reference, pull).axes
            other = orbit.acceleration(reference + apart, coefficient) + axes @ control
            return np.concatenate([reference[3:], pull, apart[3:], other - pull])

        begin = np.concatenate([origin, apart])
        tight = {"method": "DOP853", "rtol": 2.3e-14, "atol": 1e-9}
        end = solve_ivp(motion, (0.0, h), begin, **tight).y[:, -1]
        frame = lvlh_frame(end[:6], orbit.acceleration(end[:6], own))
        ends.append(frame.from_inertial(end[6:]))
    return np.array(ends)


@pytest.mark.parametrize(
    ("step", "changed"),
    [
        (120.0, {}),
        (5600.0, {}),
        (900.0, {"eccentricity": 0.5, "semi_major_axis": 2 * A}),
        (900.0, {"eccentricity": 0.8, "semi_major_axis": 5 * A}),
    ],
    ids=["two minutes", "an orbit", "e 0.5", "e 0.8"],
)
def test_an_arc_ends_where_a_runge_kutta_method_says(step, changed):
    world = world_of(step, 2, **changed)
    push = PUSHES[0] * min(1.0, 120.0 / step)
    found = world.arc(RING, push, 1)[:, -1, -1]
    truth = by_runge_kutta(world, RING, push, 1)
    assert np.abs(found - truth)[:, :3].max() < 1e-6
    assert np.abs(found - truth)[:, 3:].max() < 1e-9


@pytest.mark.parametrize("share", [1e-9, 0.3, 0.9])
def test_an_arc_whose_thrust_ends_in_it_ends_where_a_runge_kutta_method_says(share):
    world = world_of(600.0, 3)
    truth = by_runge_kutta(world, RING, PUSHES[0], 1, part=(0.0, share))
    truth = by_runge_kutta(world, truth, IDLE, 1, part=(share, 1.0))
    first = world.arc(RING, PUSHES[0], 1, (0.0, share))
    end = world.arc(first[:, -1, -1], IDLE, 1, (share, 1.0))[:, -1, -1]
    assert np.abs(end - truth)[:, :3].max() < 1e-6
    assert np.abs(end - truth)[:, 3:].max() < 1e-9
    linear = LinearWorld(Problem(time_step=600.0, nodes=4).about(world.orbit).dynamics)
    whole = linear.arc(RING, PUSHES[0], 1)[:, -1, -1]
    middle = linear.arc(RING, PUSHES[0], 1, (0.0, share))[:, -1, -1]
    again = linear.arc(middle, PUSHES[0], 1, (share, 1.0))[:, -1, -1]
    np.testing.assert_allclose(again, whole, atol=1e-8)


def test_a_craft_that_is_one_of_many_is_flown_as_well():
    """One craft of a thousand burns hard, and no mean may hide it."""
    world = world_of(600.0, 1)
    many, push = np.tile(RING[:1], (1000, 1)), np.zeros((1000, 3))
    push[500] = (0.03, -0.02, 0.05)
    alone = world.arc(many[:1], push[500:501], 0)
    assert np.abs(world.arc(many, push, 0)[500] - alone[0])[..., :3].max() < 1e-6


def test_arcs_of_one_motion_join():
    """Two arcs of a minute end as one of two minutes does; also where a plan begins later."""
    half, whole = world_of(60.0, 20), world_of(120.0, 10)
    begin = whole.arc(RING, PUSHES[0], 3)
    np.testing.assert_allclose(begin[:, 0, 0], RING, atol=1e-9)
    middle = half.arc(RING, PUSHES[0], 6)[:, -1, -1]
    end = half.arc(middle, PUSHES[0], 7)[:, -1, -1]
    np.testing.assert_allclose(begin[:, -1, -1], end, atol=1e-7)
    later = replace(whole, orbit=whole.orbit.later(360.0)).arc(RING, PUSHES[0], 0)
    np.testing.assert_allclose(later, begin, atol=1e-7)


def test_craft_hundreds_of_kilometres_away_are_flown_to_rounding():
    """The farthest that scenarios may have them, a tenth of the orbit's radius away."""
    world, push = world_of(3000.0, 1), 0.04 * PUSHES[0]
    found = world.arc(2000 * RING, push, 0)[:, -1, -1]
    assert np.abs(found[:, :3]).max() > 5e5
    truth = by_runge_kutta(world, 2000 * RING, push, 0)
    assert np.abs(found - truth)[:, :3].max() < 1e-5


@pytest.mark.parametrize(
    ("slower", "said"), [(7000.0, "did not converge"), (1000.0, "of the Earth's centre; expected")]
)
def test_craft_that_fall_through_the_earth_are_refused(slower, said):
    fallen = RING - np.array([0, 0, 0, 0, slower, 0])
    with pytest.raises(ProlearnError, match=said):
        world_of(5600.0, 1).arc(fallen, IDLE, 0)


def test_ballistic_coefficients_are_those_of_the_craft_some_times_over():
    world = world_of(600.0, 1, n=2, ballistic=0.055, spread=0.045 / 0.055)
    states = world.arc(RING[[0, 0, 0, 0]], IDLE, 0)[:, -1, -1]
    np.testing.assert_allclose(states[[0, 1]], states[[2, 3]], atol=1e-9)
    assert np.abs(states[0] - states[1])[1] > 0.1
    with pytest.raises(InputError, match=r"3 states are flown; expected a multiple of 2 craft\."):
        world.arc(RING[:3], IDLE[:3], 0)


def test_the_air_is_that_of_the_layer():
    assert atmosphere_near(420e3) == Atmosphere(400e3, 3.725e-12, 58.515e3)
    assert atmosphere_near(500e3).density_at(np.array([500e3])) == 6.967e-13
    # Vallado's example 8-4: 747.2119 km
    assert atmosphere_near(747211.9).density_at(np.array([747211.9])) == pytest.approx(
        2.1219854e-14, rel=1e-6
    )
    with pytest.raises(InputError, match="leave drag out"):
        atmosphere_near(90e3)


@pytest.mark.parametrize("dragged", [False, True], ids=["no drag", "drag"])
@pytest.mark.parametrize("j2", [False, True], ids=["two bodies", "J2"])
def test_brahe_agrees_over_a_transfer(j2, dragged):
    """To a micrometre, and absolutely to ten, where a centimetre would do."""
    world = world_of(n=4, j2=j2, **({"ballistic": 0.02, "spread": 0.9} if dragged else {}))
    air = world.orbit.air if dragged else None
    coefficients = 0.02 * (1 + 0.9 * np.array([-1, -1 / 3, 1 / 3, 1]))
    states = flown(world, RING, PUSHES)
    chief = ECCENTRIC.states(np.array(0.4))
    across = acceleration_by_brahe(chief, j2, air, 0.02)
    frame = lvlh_frame(chief, across)
    for craft in (0, 2):
        start = np.concatenate([chief, chief + frame.to_inertial(RING[craft])])
        held = (0.02, coefficients[craft])
        end = flown_by_brahe(start, PUSHES[:, craft], (j2, air), held, 120.0)
        relative = brahe.state_eci_to_rtn(end[:6], end[6:])
        assert np.abs(world.orbit.states(np.array([1200.0]))[0] - end[:6])[:3].max() < 1e-5
        assert np.abs(relative[:3] - states[craft, :3]).max() < 1e-6
