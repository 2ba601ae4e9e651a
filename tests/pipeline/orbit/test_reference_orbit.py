"""Reference orbits: what they refuse, and where they are."""

import brahe
import numpy as np
import pytest

from pipeline.errors import InputError
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import MU_EARTH, R_EARTH
from pipeline.orbit.reference_orbit import ReferenceOrbit

LEO = R_EARTH + 500e3


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"eccentricity": -0.1}, "eccentricity is -0.1; expected a number from 0 to 0.85."),
        ({"eccentricity": 0.9}, "eccentricity is 0.9; expected a number from 0 to 0.85."),
        ({"eccentricity": np.nan}, "eccentricity is nan; expected a number from 0 to 0.85."),
        ({"inclination_deg": 181.0}, "inclination_deg is 181; expected a number from 0 to 180."),
        ({"raan_deg": 400.0}, "raan_deg is 400; expected a number from -360 to 360."),
        ({"argument_of_perigee_deg": -400.0}, "argument_of_perigee_deg is -400; expected a number"),
        ({"argument_of_latitude_deg": np.inf}, "argument_of_latitude_deg is inf; expected"),
        ({"spread": 1.5}, "spread is 1.5; expected a number from 0 to 1."),
        ({"spread": 0.5}, "spread is 0.5 without ballistic, of which it is a share; expected both"),
        ({"start": -1.0}, "start is -1; expected a number from 0 to "),
        ({"start": np.inf}, "start is inf; expected a number from 0 to "),
        ({"semi_major_axis": np.nan}, "semi_major_axis is nan; expected a finite number of metres"),
        ({"eccentricity": 0.07}, "semi_major_axis is 6.87814e\\+06 m and eccentricity 0.07, a"),
        ({"semi_major_axis": 1e11}, "expected one from 100000 to 1.5e\\+09 m."),
        ({"ballistic": 0.0}, "ballistic is 0; expected a positive C_D A/m in m²/kg, such as 0.01"),
        ({"ballistic": 1e3}, "ballistic is 1000; expected a positive C_D A/m in m²/kg.* most 100."),
        ({"ballistic": 0.01, "semi_major_axis": R_EARTH + 120e3}, "is 120 km high; .*drag out."),
    ],
    ids=str,
)
def test_orbits_that_are_none_are_refused_in_a_sentence(given, said):
    with pytest.raises(InputError, match=said) as error:
        ReferenceOrbit(**{"semi_major_axis": LEO, **given})
    assert str(error.value).count("\n") == 0


def test_a_problem_has_the_mean_motion_of_its_orbit():
    orbit = ReferenceOrbit(8e6, 0.1)
    assert Problem().about(orbit).mean_motion == pytest.approx((MU_EARTH / 8e6**3) ** 0.5)
    with pytest.raises(InputError, match=r"expected that of its orbit, .*: use about\."):
        Problem(orbit=orbit)


@pytest.mark.parametrize("e", [0.0, 0.3, 0.85])
def test_without_perturbations_it_obeys_kepler(e):
    """Over three orbits, to a millimetre in ten thousand kilometres."""
    a = LEO / (1 - e)
    orbit = ReferenceOrbit(a, e, 51.6, 40.0, 30.0, 30.0, j2=False)
    times = np.linspace(0, 3 * 2 * np.pi / orbit.mean_motion, 30)
    shape = a, e, *np.radians([51.6, 40.0, 30.0])
    truth = [
        brahe.state_koe_to_eci(np.array([*shape, orbit.mean_motion * t]), brahe.AngleFormat.RADIANS)
        for t in times
    ]
    # Its gravitational parameter is a little different.
    truth = truth * np.repeat([1.0, (MU_EARTH / brahe.GM_EARTH) ** 0.5], 3)
    found, size = orbit.states(times), np.repeat([a, a * orbit.mean_motion], 3)
    assert np.abs((found - truth) / size).max() < 1e-10
    later = orbit.later(times[7])
    np.testing.assert_allclose(
        later.states(times[:5]), orbit.states(times[7] + times[:5]), rtol=1e-9
    )
    np.testing.assert_array_equal(orbit.states(np.zeros(2)), found[[0, 0]])


def test_the_fastest_is_the_rate_at_perigee():
    orbit = ReferenceOrbit(LEO / 0.3, 0.7, j2=False)
    (state,) = orbit.states(np.zeros(1))
    r, v = state[:3], state[3:]
    assert np.linalg.norm(np.cross(r, v)) / (r @ r) == pytest.approx(orbit.fastest, rel=1e-12)


def test_ballistic_coefficients_are_equally_spaced_about_the_middle():
    orbit = ReferenceOrbit(LEO, ballistic=0.02, spread=0.5)
    np.testing.assert_allclose(orbit.ballistics(3), [0.01, 0.02, 0.03])
    np.testing.assert_allclose(orbit.ballistics(1), [0.02])
    np.testing.assert_array_equal(ReferenceOrbit(LEO).ballistics(2), [0.0, 0.0])


def test_an_orbit_that_falls_is_refused_in_a_sentence():
    """The orbit decays within a revolution: altitude 155 km, C_D A/m = 100 m²/kg."""
    orbit = ReferenceOrbit(R_EARTH + 155e3, ballistic=100.0)
    assert 100e3 < np.linalg.norm(orbit.states(np.array([100.0]))[0, :3]) - R_EARTH < 155e3
    with pytest.raises(InputError, match=r"^the reference orbit could not be flown .* km high"):
        orbit.states(np.array([6000.0]))
