"""Mean elements against averages of osculating ones along integrated orbits, and against brahe."""

from functools import cache, partial

import brahe
import numpy as np
import pytest
from koenig import RAD, mean_elements
from relative import pull
from scipy.integrate import solve_ivp

from pipeline.orbit.inertial import Elements
from pipeline.orbit.mean_elements import (
    PlanarElements,
    mean_states,
    osculating_states,
    secular_rates,
)
from pipeline.orbit.reference import J2, MU_EARTH, R_EARTH
from pipeline.orbit.reference_orbit import ReferenceOrbit

LEO = R_EARTH + 500e3

ORBITS = [(0.0, 0.0), (0.0, 97.4), (0.001, 51.6), (0.001, 97.4), (0.01, 63.4), (0.1, 97.4)]
"""Eccentricities and inclinations, deg; circles, equatorial and critical ones among them."""

SECOND = 8 * J2**2
"""Size of what a theory of first order leaves out, as a share."""


def osculating(e, i):
    """A state after perigee of the orbit, 500 km high there."""
    elements = Elements(LEO / (1 - e), np.radians(i), 0.7, e, 1.1)
    return elements.states(np.array(2.0))


@cache
def along(e, i, revolutions):
    """Osculating states along the integrated orbit, and its period, from that many before it."""
    begin = osculating(e, i)
    period = 2 * np.pi / np.sqrt(MU_EARTH / (LEO / (1 - e)) ** 3)
    force = partial(pull, j2=True)

    def motion(_, state):
        return np.concatenate([state[3:], force(state)])

    times = np.linspace(0, revolutions * period, 64 * revolutions + 1)
    integrate = partial(solve_ivp, motion, y0=begin, method="DOP853", rtol=1e-12, atol=1e-6)
    later = integrate((0, times[-1]), t_eval=times).y.T
    sooner = integrate((0, -times[-1]), t_eval=-times).y.T
    return np.concatenate([sooner[:0:-1], later])


def shapes(states):
    """Semi-major axis (a share of LEO), vector of eccentricity and normal, inertial."""
    r, v = states[:, :3], states[:, 3:]
    far, h = np.linalg.norm(r, axis=1), np.cross(r, v)
    a = 1 / (2 / far - np.vecdot(v, v) / MU_EARTH) / LEO
    pointed = np.cross(v, h) / MU_EARTH - r / far[:, None]
    return np.hstack([a[:, None], pointed, h / np.linalg.norm(h, axis=1)[:, None]])


@pytest.mark.parametrize(("e", "i"), ORBITS)
def test_they_are_the_average_of_osculating_elements_about_a_time(e, i):
    """By time over three revolutions either way, weighed by a window without side lobes."""
    states = along(e, i, 3)
    weight = np.blackman(len(states))
    average = weight @ shapes(states) / weight.sum()
    found = shapes(mean_states(osculating(e, i)[None]))[0]
    assert np.abs(found - average).max() < SECOND
    periodic = np.abs(shapes(osculating(e, i)[None])[0] - average).max()
    assert periodic > 20 * np.abs(found - average).max(), "which osculating elements are not"


@pytest.mark.parametrize(("e", "i"), ORBITS)
def test_along_an_orbit_they_change_at_their_secular_rates_alone(e, i):
    states = along(e, i, 3)
    mean = mean_states(states)
    a, pointed = shapes(mean)[:, 0], np.linalg.norm(shapes(mean)[:, 1:4], axis=1)
    assert np.ptp(a) < 1e-2 * J2**2, "since the energy is kept"
    assert np.ptp(pointed) < SECOND
    if i > 0:
        h = np.cross(mean[:, :3], mean[:, 3:])
        node = np.unwrap(np.arctan2(h[:, 0], -h[:, 1]))
        span = 6 * 2 * np.pi / np.sqrt(MU_EARTH / (LEO / (1 - e)) ** 3)
        *_, rate = secular_rates(PlanarElements.of(mean[:1]))
        assert node[-1] - node[0] == pytest.approx(rate * span, abs=20 * SECOND)


@pytest.mark.parametrize("e", [0.0, 1e-3, 0.1, 0.7, 0.85])
def test_there_and_back_is_the_same(e):
    state = osculating(e, 97.4)[None]
    for there, back in ((mean_states, osculating_states), (osculating_states, mean_states)):
        np.testing.assert_allclose(back(there(state)), state, rtol=1e-12)


@pytest.mark.parametrize(("e", "i"), [(0.01, 97.4), (0.1, 51.6), (0.5, 20.0)])
def test_they_are_those_of_brahe_but_for_terms_of_long_period(e, i):
    """Which Brouwer's theory has besides: of the size of J2 e."""
    state = osculating(e, i)
    a, e_mean, i_mean, node, *_ = mean_elements(state)
    ours = brahe.state_eci_to_koe(mean_states(state[None])[0], RAD)
    long = 0.2 * J2 * e
    assert ours[0] == pytest.approx(a, rel=SECOND)
    assert ours[[1, 2, 3]] == pytest.approx(np.array([e_mean, i_mean, node]), abs=long)


@pytest.mark.parametrize(("e", "i", "u"), [(0.001, 97.4, 0.0), (0.0, 97.4, 80.0), (0.2, 0.0, 9.0)])
def test_a_reference_orbit_is_made_from_its_mean_elements(e, i, u):
    given = {"semi_major_axis": 9e6, "eccentricity": e, "inclination_deg": i, "raan_deg": 10.0}
    angles = {"argument_of_perigee_deg": 90.0, "argument_of_latitude_deg": u}
    orbit = ReferenceOrbit.of_mean(**given, **angles)
    elements = Elements(9e6, np.radians(i), np.radians(10.0), e, np.radians(90.0))
    wanted = elements.states(np.array(np.radians(u)))
    np.testing.assert_allclose(mean_states(orbit.begin[None])[0], wanted, rtol=1e-9, atol=1e-3)
    assert orbit.mean_elements.eccentricity == pytest.approx(e, abs=1e-12)
    bare = ReferenceOrbit.of_mean(**given, **angles, j2=False)
    assert bare == ReferenceOrbit(**given, **angles, j2=False)


def test_the_mean_eccentricity_along_an_orbit_is_that_given():
    """Which it is not where the osculating one at the epoch has that value."""
    least = []
    for made in (ReferenceOrbit.of_mean, ReferenceOrbit):
        orbit = made(
            semi_major_axis=LEO,
            eccentricity=0.001,
            inclination_deg=97.4,
            argument_of_perigee_deg=90.0,
            argument_of_latitude_deg=90.0,
        )
        times = np.linspace(0, 2 * np.pi / orbit.mean_motion, 64)
        mean = shapes(mean_states(orbit.states(times)))
        least.append(np.linalg.norm(mean[:, 1:4], axis=1))
    assert np.abs(least[0] - 0.001).max() < SECOND
    assert np.abs(least[1] - 0.001).max() > 1e-3
