"""The nonlinear world against Kepler, secular rates, derivatives and the propagator of brahe."""

from dataclasses import replace
from functools import partial
from itertools import pairwise

import brahe
import numpy as np
import pytest

from pipeline.errors import InputError
from pipeline.flight.world import Drag, LinearWorld, NonlinearWorld, World
from pipeline.orbit.forces import Atmosphere, atmosphere_near
from pipeline.orbit.inertial import Elements, Frame, cross_product, lvlh_frame
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import J2, MU_EARTH, R_EARTH, mean_motion_at, radius_at
from pipeline.orbit.rings import pro_states

N = mean_motion_at(500e3)
A = radius_at(N)

ECCENTRIC = Elements(A, np.deg2rad(51.6), 0.7, 0.01, 1.1)

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


def flown(world, states, controls, step=120.0, pieces=4):
    """States after every arc."""
    for k, push in enumerate(controls):
        states = world.arc(states, push, k * step, step, pieces)[:, -1]
    return states


@pytest.mark.parametrize("one", [(3,), (4, 1, 3)])
def test_a_cross_product_has_the_bits_of_numpys(one):
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=one) * 7e6, rng.normal(size=(4, 5, 3))
    assert np.array_equal(cross_product(a, b), np.cross(a, b))


def test_it_is_a_world():
    assert isinstance(NonlinearWorld(ECCENTRIC), World)


@pytest.mark.parametrize("time", [7.0, 120.0, 6000.0])
def test_without_perturbations_craft_obey_keplers_equation(time):
    world = NonlinearWorld(ECCENTRIC, 0.4, j2=False)
    start = ECCENTRIC.states(np.array(0.4))
    end = kepler(start, time)
    exact = np.array([kepler(one, time) for one in by_cross_products(start, RING)])
    states = world.arc(RING, IDLE, 0.0, time, 1)[:, -1]
    assert np.abs(world.reference(time) - end)[:3].max() < 1e-5
    assert np.abs(by_cross_products(end, states) - exact)[:, :3].max() < 1e-6
    assert np.abs(by_cross_products(end, states) - exact)[:, 3:].max() < 1e-9


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
    elements = replace(ECCENTRIC, inclination=0.5, eccentricity=0.05)
    world = NonlinearWorld(elements, tolerance=0.1)
    period, orbits, share = 2 * np.pi / N, 6, np.arange(12) / 12
    means = []
    for first in (0, orbits):
        states = np.array([world.reference((first + one) * period) for one in share])
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
    world, linear = NonlinearWorld(Elements(A), j2=False), LinearWorld(Problem().dynamics)
    missed = []
    for size in (4.0, 2.0, 1.0):
        ends = [each.arc(size * RING, IDLE, 0.0, 1500.0, 1)[:, -1] for each in (world, linear)]
        missed.append(np.linalg.norm(ends[0] - ends[1], axis=1))
    assert missed[0].min() > 1e-3
    for far, near in pairwise(missed):
        np.testing.assert_allclose(far / near, 4.0, rtol=0.01)


def test_velocities_are_the_derivatives_of_positions_in_the_turning_frame():
    """Of the sixth order; on an orbit whose plane J2 turns, and whose speed changes."""
    step = 5.0
    states = NonlinearWorld(ECCENTRIC, 0.4).arc(RING, PUSHES[0], 300.0, 40 * step, 40)
    p = states[..., :3]
    slope = (
        45 * (p[:, 4:-2] - p[:, 2:-4]) - 9 * (p[:, 5:-1] - p[:, 1:-5]) + (p[:, 6:] - p[:, :-6])
    ) / (60 * step)
    assert np.abs(slope - states[:, 3:-3, 3:]).max() < 5e-9


def test_there_and_back_is_exact():
    rng = np.random.default_rng(0)
    origin = ECCENTRIC.states(rng.uniform(0, 6, 50))
    frame = lvlh_frame(origin, rng.normal(0, 1e-2, (50, 3)))
    states = rng.normal(0, 1e3, (7, 50, 6))
    back = frame.from_inertial(frame.to_inertial(states))
    np.testing.assert_allclose(back, states, atol=1e-9)
    still = Frame(frame.axes, np.zeros((50, 3)))
    assert np.abs(still.to_inertial(states) - frame.to_inertial(states)).max() > 0.5


def test_tighter_tolerances_change_less_than_a_micrometre():
    world = NonlinearWorld(ECCENTRIC, 0.4)
    tight = replace(world, tolerance=1e-9)
    assert np.abs(flown(world, RING, PUSHES) - flown(tight, RING, PUSHES)).max() < 1e-6


def test_a_craft_that_is_one_of_many_is_flown_as_well():
    """One craft of a thousand burns hard, and no mean may hide it."""
    world = NonlinearWorld(ECCENTRIC, 0.4)
    many, push = np.tile(RING[:1], (1000, 1)), np.zeros((1000, 3))
    push[500] = (0.03, -0.02, 0.05)
    alone = world.arc(many[:1], push[500:501], 0.0, 600.0, 7)
    assert np.abs(world.arc(many, push, 0.0, 600.0, 7)[500] - alone[0])[:, :3].max() < 1e-6


def test_pieces_are_of_one_motion():
    world = NonlinearWorld(ECCENTRIC, 0.4)
    fine, coarse = (world.arc(RING, PUSHES[0], 60.0, 120.0, k) for k in (12, 3))
    np.testing.assert_allclose(fine[:, ::4], coarse, atol=1e-7)
    np.testing.assert_allclose(fine[:, 0], RING, atol=1e-9)
    halves = world.arc(fine[:, 6], PUSHES[0], 120.0, 60.0, 6)
    np.testing.assert_allclose(fine[:, 6:], halves, atol=1e-6)
    np.testing.assert_array_equal(world.arc(RING, PUSHES[0], 9.0, 0.0, 2)[:, 1], RING)


def test_ballistic_coefficients_are_those_of_the_craft_some_times_over():
    air = atmosphere_near(500e3)
    world = NonlinearWorld(ECCENTRIC, drag=Drag(air, (0.01, 0.1)))
    states = world.arc(RING[[0, 0, 0, 0]], IDLE, 0.0, 600.0, 1)[:, -1]
    np.testing.assert_allclose(states[[0, 1]], states[[2, 3]], atol=1e-9)
    assert np.abs(states[0] - states[1])[1] > 0.1
    with pytest.raises(InputError, match=r"3 states are flown; expected a multiple of 2 craft\."):
        world.arc(RING[:3], IDLE[:3], 0.0, 600.0, 1)


def test_the_air_is_that_of_the_layer():
    assert atmosphere_near(420e3) == Atmosphere(400e3, 3.725e-12, 58.515e3)
    assert atmosphere_near(500e3).density_at(np.array([500e3])) == 6.967e-13
    # Vallado's example 8-4: 747.2119 km
    assert atmosphere_near(747211.9).density_at(np.array([747211.9])) == pytest.approx(
        2.1219854e-14, rel=1e-6
    )
    with pytest.raises(InputError, match="leave drag out"):
        atmosphere_near(90e3)


def acceleration_by_brahe(state, j2, air, ballistic):
    """Of the forces of brahe, whose constants of gravity are a little different."""
    total = brahe.accel_point_mass_gravity(state[:3], np.zeros(3), MU_EARTH)
    if j2:
        zonal = brahe.accel_earth_zonal_gravity(state[:3], 2)
        zonal = zonal - brahe.accel_point_mass_gravity(state[:3], np.zeros(3), brahe.GM_EARTH)
        ours = J2 * MU_EARTH * R_EARTH**2
        total = total + zonal * ours / (brahe.J2_EARTH * brahe.GM_EARTH * brahe.R_EARTH**2)
    if air is not None:
        height = np.linalg.norm(state[:3]) - R_EARTH
        density = air.density * np.exp(-(height - air.base) / air.scale)
        total = total + brahe.accel_drag(state, density, 1.0, ballistic, 1.0, np.eye(3))
    return total


def by_brahe(start, pushes, forces, ballistics, step):
    """Chief and deputy after all arcs, integrated together by brahe's RKF78; inertial."""

    def motion(_, both, push):
        chief, deputy = both[:6], both[6:]
        thrust = brahe.rotation_rtn_to_eci(chief) @ push
        a, b = (
            acceleration_by_brahe(one, *forces, held)
            for one, held in zip((chief, deputy), ballistics, strict=True)
        )
        return np.concatenate([chief[3:], a, deputy[3:], b + thrust])

    config = brahe.IntegratorConfig.adaptive(abs_tol=1e-9, rel_tol=1e-14)
    both = start
    for push in pushes:
        integrator = brahe.RKF78Integrator(12, partial(motion, push=push), config=config)
        done = 0.0
        while done < step:
            result = integrator.step(done, both, min(10.0, step - done))
            both, done = result.state, done + result.dt_used
    return both


@pytest.mark.parametrize("dragged", [False, True], ids=["no drag", "drag"])
@pytest.mark.parametrize("j2", [False, True], ids=["two bodies", "J2"])
def test_brahe_agrees_over_a_transfer(j2, dragged):
    """To a micrometre, and absolutely to ten, where a centimetre would do."""
    air = atmosphere_near(500e3) if dragged else None
    coefficients = (0.02, 0.03, 0.3, 0.01)
    pull = None if air is None else Drag(air, coefficients, 0.02)
    world = NonlinearWorld(ECCENTRIC, 0.4, j2=j2, drag=pull)
    states = flown(world, RING, PUSHES)
    chief = ECCENTRIC.states(np.array(0.4))
    across = acceleration_by_brahe(chief, j2, air, 0.02)
    frame = lvlh_frame(chief, across)
    for craft in (0, 2):
        start = np.concatenate([chief, chief + frame.to_inertial(RING[craft])])
        held = (0.02, coefficients[craft])
        end = by_brahe(start, PUSHES[:, craft], (j2, air), held, 120.0)
        relative = brahe.state_eci_to_rtn(end[:6], end[6:])
        assert np.abs(world.reference(1200.0) - end[:6])[:3].max() < 1e-5
        assert np.abs(relative[:3] - states[craft, :3]).max() < 1e-6
