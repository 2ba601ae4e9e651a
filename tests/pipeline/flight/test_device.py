"""Monte Carlo trials computed by torch have the results of numpy; here on the CPU."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.errors import InputError
from pipeline.expert import solve
from pipeline.flight.errors import COLD_GAS
from pipeline.flight.loops import Loop, TrialSettings, batch_size, fly_loops
from pipeline.flight.world import LinearWorld
from pipeline.orbit.corridors import Box, Corridor
from pipeline.orbit.participants import Obstacle
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.planners.classical import Expert
from pipeline.scenario import draw
from pipeline.scenario.spacecraft import Spacecraft

LOSING = replace(COLD_GAS, lost=0.5)  # some in mid-burn, which are flown in two parts
ECCENTRIC = ReferenceOrbit.of_mean(
    semi_major_axis=7e6,
    eccentricity=0.02,
    inclination_deg=60.0,
    raan_deg=0.0,
    argument_of_perigee_deg=90.0,
    argument_of_latitude_deg=0.0,
    j2=True,
)
NEAR = {"min_separation_time": 1e-4, "min_clearance_time": 1e-4}
"""Absolute tolerances of times, s: near its least a distance hardly changes."""


def check_same(scenario, errors, trials):
    plan, dynamics = solve(scenario), scenario.problem.dynamics
    loops = [Loop("open loop", plan.controls), Loop("feedback", plan.controls, plan.states)]
    flown = [
        fly_loops(TrialSettings(scenario, LinearWorld(dynamics, device), errors, 7), loops, trials)
        for device in (None, "cpu")
    ]
    for loop in loops:
        here, there = (found[loop.name] for found in flown)
        assert here.keys() == there.keys()
        for name, values in here.items():
            off = NEAR.get(name, 1e-9)
            np.testing.assert_allclose(there[name], values, rtol=1e-9, atol=off, err_msg=name)


@pytest.mark.parametrize("family", ["rings", "dense", "rotation"])
@pytest.mark.parametrize(("n", "trials"), [(10, 60), (30, 20)])
def test_on_a_device_trials_are_those_of_numpy(n, trials, family):
    check_same(draw(family, 0, n, 0, Problem(), "test"), LOSING, trials)


def test_also_about_an_orbit_that_is_no_circle():
    check_same(draw("rings", 0, 6, 0, Problem().about(ECCENTRIC), "test"), LOSING, 20)


def test_also_of_craft_with_radii_beside_obstacles_and_in_corridors():
    alike = draw("rings", 0, 6, 0, Problem())
    debris = Obstacle("debris", (30.0, -80.0, 20.0, 0.0, 60 * -Problem.mean_motion, 0.01), 10.0)
    room = Corridor(Box((-320.0, -640.0, -320.0), (320.0, 640.0, 320.0)), 130.0, 1110.0)
    craft = tuple(Spacecraft(radius=r) for r in (3.0, 5.0, 7.5, 12.0, 3.0, 20.0))
    unlike = replace(alike, craft=craft, obstacles=(debris,), corridors=(room,))
    check_same(unlike, COLD_GAS, 20)


def test_arcs_are_in_float64_on_the_device_and_a_device_that_is_not_there_is_refused():
    problem = Problem()
    arc = LinearWorld(problem.dynamics, "cpu").arc(np.ones((2, 6)), np.zeros((2, 3)), 0)
    assert (str(arc.dtype), arc.device.type) == ("torch.float64", "cpu")
    with pytest.raises(InputError, match="expected cpu, or cuda"):
        LinearWorld(problem.dynamics, "cuda:99").arc(np.ones((2, 6)), np.zeros((2, 3)), 0)


def test_on_a_gpu_more_trials_are_flown_side_by_side_where_none_is_planned_anew():
    dynamics, flown = Problem().dynamics, Loop("open loop", np.zeros((10, 24, 3)))
    anew = replace(flown, planner=Expert())
    here, there = LinearWorld(dynamics), LinearWorld(dynamics, "cuda")
    for n, usual, more in [(10, 50, 500), (300, 6, 66), (1000, 1, 6), (2000, 1, 1)]:
        assert batch_size(n, here, flown) == batch_size(n, there, anew) == usual
        assert batch_size(n, replace(here, device="cpu"), flown) == usual
        assert batch_size(n, there, flown) == more
