"""Fuel as in Eq. 4, by hand, and the controls that states imply."""

import numpy as np
import pytest

from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import fly, fuel, implied_controls


def test_fuel_is_the_sum_of_absolute_components_over_craft_and_time():
    controls = np.zeros((2, 2, 3))
    controls[0, 0] = [1e-3, -2e-3, 0]
    controls[1, 1] = [0, 0, -4e-3]
    assert fuel(controls) == pytest.approx(7e-3)


def test_a_batch_of_swarms_has_a_fuel_each():
    controls = np.ones((5, 2, 10, 3))
    assert fuel(controls) == pytest.approx(np.full(5, 60.0))


def test_states_that_were_flown_imply_the_controls_that_flew_them():
    problem, rng = Problem(), np.random.default_rng(0)
    start = rng.normal(size=(4, 6)) * [200, 200, 200, 0.2, 0.2, 0.2]
    controls = rng.normal(size=(4, 10, 3)) * 1e-3
    states = fly(start, controls, problem)
    assert implied_controls(states, problem) == pytest.approx(controls, abs=1e-12)
