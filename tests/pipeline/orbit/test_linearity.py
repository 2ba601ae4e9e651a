"""The estimate of what the linear model leaves out, against an integrator of the full equations."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pipeline.orbit.dynamics import model_error
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import mean_motion_at
from pipeline.orbit.rings import pro_states
from pipeline.orbit.transfer import minimum_energy

MU, R, J2 = 3.986004418e14, 6378137.0, 1.08263e-3


def attraction(p, j2):
    """Of the Earth, on an equatorial orbit for which J2 is strongest in the plane; (k, 3)."""
    r = np.linalg.norm(p, axis=1, keepdims=True)
    z = p[:, 2:] ** 2 / r**2
    return -MU * p / r**3 - j2 * 1.5 * MU * R**2 / r**5 * p * (1 - 5 * z + np.array([0, 0, 2]))


def miss(initial, goal, problem, j2):
    """How far controls of the linear model lead k craft from goals about the real Earth, m."""
    e = problem.mean_motion
    radius = (MU / e**2) ** (1 / 3)
    controls = minimum_energy(initial, goal, problem)

    def axes(s):
        up, across = s[:3] / np.linalg.norm(s[:3]), np.array([0.0, 0, 1])
        return np.stack([up, np.cross(across, up), across], axis=1)

    # The reference starts on what is a circle with J2 too.
    speed = np.sqrt(radius * np.linalg.norm(attraction(np.array([[radius, 0, 0]]), j2)))
    origin = np.array([radius, 0, 0, 0, speed, 0])
    turn = np.cross([0, 0, speed / radius], initial[:, :3])
    craft = origin + np.hstack([initial[:, :3], initial[:, 3:] + turn])
    every = np.vstack([origin, craft])
    for u in controls.swapaxes(0, 1):

        def rate(_, flat, u=u):
            s = flat.reshape(-1, 6)
            pulls = attraction(s[:, :3], j2)
            pulls[1:] += u @ axes(s[0]).T
            return np.hstack([s[:, 3:], pulls]).ravel()

        start = every.ravel()
        end = solve_ivp(rate, (0, problem.time_step), start, "DOP853", rtol=1e-12, atol=1e-6)
        every = end.y[:, -1].reshape(-1, 6)
    found = (every[1:] - every[0])[:, :3] @ axes(every[0])
    return np.linalg.norm(found - goal[:, :3], axis=1)


@pytest.mark.parametrize(
    ("size", "altitude", "nodes", "step"),
    [
        (200.0, 500e3, 11, 120.0),
        (5e3, 500e3, 11, 120.0),
        (3e4, 500e3, 5, 300.0),
        (200.0, 500e3, 41, 500.0),
        (1e4, 35_786e3, 11, 1200.0),
    ],
)
def test_the_estimate_is_of_the_size_of_what_the_integrator_finds(size, altitude, nodes, step):
    problem = Problem(mean_motion=mean_motion_at(altitude), nodes=nodes, time_step=step)
    phase = 2 * np.pi * np.arange(4) / 4
    e = problem.mean_motion
    initial = pro_states(size, 0.0, phase, 0.0, e, 0.0)
    goal = pro_states(0.8 * size, 0.3, phase, 0.0, e, 0.0)
    estimate = model_error(np.stack([initial, goal]), problem.dynamics, problem.duration)
    for j2, said in ((0.0, estimate.curvature), (J2, estimate.total)):
        found = miss(initial, goal, problem, j2).max()
        assert said / 5 < found < 5 * said
