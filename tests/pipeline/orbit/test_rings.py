"""Passive relative orbits: energy matching, the shape of the ring, and its return."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from pipeline.orbit.dynamics import cw_matrices
from pipeline.orbit.rings import energy_mismatch, pro_states

E = 1.1e-3
angles = st.floats(0, 2 * np.pi)
rings = st.builds(
    lambda a, tilt, phase, cross, y: pro_states(a, tilt, np.array([phase]), cross, E, y),
    st.floats(50, 1000),
    st.floats(-0.8, 0.8),
    angles,
    angles,
    st.floats(-300, 300),
)


@given(states=rings)
def test_every_ring_state_satisfies_energy_matching(states):
    assert energy_mismatch(states, E) == pytest.approx(0, abs=1e-12)


@given(states=rings)
def test_a_ring_closes_after_one_orbit(states):
    A, _ = cw_matrices(E, 2 * np.pi / E)
    assert states @ A.T == pytest.approx(states, abs=1e-6)


def test_a_ring_flown_by_an_integrator_is_a_2_to_1_ellipse_with_the_tilt_asked_for():
    a, tilt = 200.0, np.deg2rad(30)
    state = pro_states(a, tilt, np.array([0.7]), 0.0, E)[0]

    def motion(_, s):
        return [*s[3:], 3 * E**2 * s[0] + 2 * E * s[4], -2 * E * s[3], -(E**2) * s[2]]

    orbit = solve_ivp(motion, (0, 2 * np.pi / E), state, rtol=1e-10, max_step=20).y
    assert np.abs(orbit[0]).max() == pytest.approx(a / 2, rel=1e-3)
    assert np.abs(orbit[1]).max() == pytest.approx(a, rel=1e-3)
    assert orbit[2] == pytest.approx(np.tan(tilt) * orbit[0], abs=1e-4)


def test_a_state_that_drifts_has_the_mismatch_that_eq_3_gives_it():
    state = np.array([10.0, 0, 0, 0, 0, 0])
    assert energy_mismatch(state[None], E)[0] == pytest.approx(2 * E * 10)
