"""The closed form of the CW equations against an integrator and a matrix exponential."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from judge import exact_step
from scipy.integrate import solve_ivp

from pipeline.orbit.dynamics import cw_matrices
from pipeline.orbit.reference import mean_motion_at


@given(
    e=st.one_of(st.just(0.0), st.floats(1e-9, 5e-2)),
    step=st.floats(1e-3, 2e3),
)
def test_a_and_b_are_the_matrix_exponential_for_any_mean_motion_and_step(e, step):
    for found, true in zip(cw_matrices(e, step), exact_step(e, step), strict=True):
        assert found == pytest.approx(true, rel=1e-9, abs=1e-9 * np.abs(true).max())


def test_a_step_is_what_an_integrator_of_the_equations_of_motion_gives():
    e, step = 1.1e-3, 120.0
    state = np.array([100.0, -200.0, 50.0, 0.1, -0.2, 0.05])
    u = np.array([1e-4, -2e-4, 3e-4])

    def motion(_, s):
        x, _, z, vx, vy, vz = s
        ax, ay = 3 * e**2 * x + 2 * e * vy + u[0], -2 * e * vx + u[1]
        return [vx, vy, vz, ax, ay, -(e**2) * z + u[2]]

    flown = solve_ivp(motion, (0, step), state, method="DOP853", rtol=1e-12, atol=1e-12)
    A, B = cw_matrices(e, step)
    assert A @ state + B @ u == pytest.approx(flown.y[:, -1], rel=1e-9)


def test_an_array_of_steps_gives_a_matrix_each():
    steps = np.array([[1.0, 60.0], [120.0, 600.0]])
    A, B = cw_matrices(1.1e-3, steps)
    assert A.shape == (2, 2, 6, 6)
    assert B.shape == (2, 2, 6, 3)
    assert A[1, 0] == pytest.approx(cw_matrices(1.1e-3, 120.0)[0])


def test_two_steps_are_one_step_of_twice_the_length():
    half, _ = cw_matrices(1.1e-3, 60.0)
    whole, _ = cw_matrices(1.1e-3, 120.0)
    assert half @ half == pytest.approx(whole)


def test_the_mean_motion_at_500_km_is_that_of_a_94_6_minute_orbit():
    assert 2 * np.pi / mean_motion_at(500e3) / 60 == pytest.approx(94.6, abs=0.05)
