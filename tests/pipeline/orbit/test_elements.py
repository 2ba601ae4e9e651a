"""Osculating elements of inertial states, held against brahe and against the states themselves."""

import brahe
import numpy as np
import pytest

from pipeline.errors import InputError
from pipeline.orbit.inertial import Elements
from pipeline.orbit.reference import MU_EARTH
from pipeline.orbit.reference_orbit import ReferenceOrbit

RADIANS = brahe.AngleFormat.RADIANS


@pytest.fixture(scope="module")
def orbits():
    """Elements a, e, i, Ω, ω and true anomaly, well away from where some are undefined."""
    rng = np.random.default_rng(0)
    n = 200
    return np.stack(
        [
            rng.uniform(6.8e6, 5e7, n),
            rng.uniform(0.01, 0.85, n),
            rng.uniform(0.05, np.pi - 0.05, n),
            *rng.uniform(0, 2 * np.pi, (3, n)),
        ],
        axis=1,
    )


def by_brahe(a, e, i, raan, perigee, anomaly):
    """The state, with the velocity of our μ in place of brahe's."""
    mean = brahe.anomaly_true_to_mean(anomaly, e, angle_format=RADIANS)
    state = brahe.state_koe_to_eci(np.array([a, e, i, raan, perigee, mean]), RADIANS)
    return state * np.repeat([1.0, np.sqrt(MU_EARTH / brahe.GM_EARTH)], 3)


def test_elements_and_states_are_those_of_brahe_both_ways(orbits):
    for a, e, i, raan, perigee, anomaly in orbits.tolist():
        state = by_brahe(a, e, i, raan, perigee, anomaly)
        ours = Elements(a, i, raan, e, perigee).states(np.array(perigee + anomaly))
        assert ours == pytest.approx(state, rel=1e-12, abs=1e-7)
        found, latitude = Elements.of(state)
        assert found.semi_major_axis == pytest.approx(a, rel=1e-12)
        assert (found.eccentricity, found.inclination) == pytest.approx((e, i), abs=1e-12)
        off = [found.raan - raan, found.argument_of_perigee - perigee]
        off += [latitude - perigee - anomaly]
        assert np.sin(np.array(off) / 2) == pytest.approx(0, abs=1e-11)


@pytest.mark.parametrize("e", [0.0, 1e-16, 1e-12, 1e-8, 0.3])
@pytest.mark.parametrize("i", [0.0, 1e-16, 1e-12, 1e-7, 1.0, np.pi - 1e-9, np.pi])
def test_near_circles_and_near_the_equator_the_elements_together_give_the_state_back(e, i):
    for latitude in np.linspace(0, 6.2, 9):
        state = Elements(7e6 / (1 - e), i, 0.7, e, 1.1).states(np.array(latitude))
        orbit = ReferenceOrbit.through(state)
        back = orbit.states(np.zeros(1))[0]
        assert back[:3] == pytest.approx(state[:3], abs=5e-8)
        assert back[3:] == pytest.approx(state[3:], abs=5e-11)


def test_what_is_undefined_is_zero():
    circle, _ = Elements.of(Elements(7e6, 0.5, 0.2).states(np.array(1.0)))
    assert circle.eccentricity == 0 and circle.argument_of_perigee == 0
    for i in (0.0, np.pi):
        equatorial, _ = Elements.of(Elements(7e6, i, 0.2, 0.1, 0.3).states(np.array(1.0)))
        assert equatorial.raan == 0
        assert equatorial.inclination == i


def test_a_state_faster_than_escape_is_refused():
    fast = np.array([7e6, 0, 0, 0, 1.01 * np.sqrt(2 * MU_EARTH / 7e6), 0])
    with pytest.raises(InputError, match=r"has eccentricity 1\.04; expected one on a closed orbit"):
        Elements.of(fast)
    with pytest.raises(InputError, match="closed orbit"):
        Elements.of(np.array([7e6, 0, 0, 1e3, 0, 0]))  # straight up
