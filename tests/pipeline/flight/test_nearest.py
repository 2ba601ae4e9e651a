"""The least separation of flown arcs against samples so dense that they cannot miss it."""

import numpy as np
import pytest

from pipeline.errors import InputError
from pipeline.expert import decoupled_optima
from pipeline.flight.effects import fly_controls
from pipeline.flight.nearest import nearer, nearest, pieces_for
from pipeline.flight.world import LinearWorld, NonlinearWorld
from pipeline.orbit.approaches import TOLERANCE
from pipeline.orbit.inertial import Elements
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import radius_at
from pipeline.orbit.separation import least_separation
from pipeline.orbit.transfer import fly
from pipeline.scenario import draw

PROBLEM = Problem()

WORLD = NonlinearWorld(Elements(radius_at(PROBLEM.mean_motion), 1.7, 0.2, 0.01, 2.0), 1.0)


def swarm(index, n=10):
    """Initial states and controls that avoid nobody."""
    scenario = draw("rings", 0, n, index, PROBLEM)
    return scenario.initial, decoupled_optima(scenario.initial, scenario.goal, PROBLEM).controls


def sampled(states):
    """The least distance in samples, the pair and which sample."""
    i, j = np.triu_indices(len(states), 1)
    apart = np.linalg.norm(states[i, :, :3] - states[j, :, :3], axis=-1)
    pair, sample = np.unravel_index(apart.argmin(), apart.shape)
    return apart[pair, sample], (i[pair], j[pair]), sample


def test_no_sample_is_nearer_and_the_nearest_is_attained():
    """Of many trials in one call, each on its own."""
    duration, many = 600.0, 6000
    begin = [swarm(index) for index in range(6)]
    arcs, dense = [], []
    for initial, controls in begin:
        coarse = pieces_for(duration, PROBLEM.mean_motion)
        arcs.append(WORLD.arc(initial, controls[:, 0], 0.0, duration, coarse))
        dense.append(WORLD.arc(initial, controls[:, 0], 0.0, duration, many))
    found = nearest(np.stack(arcs), 100.0, duration, PROBLEM.mean_motion)
    for trial, states in enumerate(dense):
        least, pair, sample = sampled(states)
        assert found.bound[trial] <= least
        # Between samples 0.1 s apart, at 2 m/s at most, less than 0.02 m lie under the least.
        assert least - 0.02 < found.bound[trial]
        assert found.distance[trial] - found.bound[trial] <= 1.1 * TOLERANCE
        assert (found.first[trial], found.second[trial]) == pair
        assert found.time[trial] == pytest.approx(100.0 + sample * duration / many, abs=2)


def test_a_minimum_between_two_states_is_that_of_straight_lines_in_closed_form():
    """In a world without gravity: 3 m beside each other, passing midway."""
    one = [[-60, 0, 0, 1, 0, 0], [0, 0, 0, 1, 0, 0], [60, 0, 0, 1, 0, 0]]
    other = [[60, 3, 4, -1, 0, 0], [0, 3, 4, -1, 0, 0], [-60, 3, 4, -1, 0, 0]]
    states = np.array([[one, other]], dtype=float)
    shifted = states + np.array([[30.0], [0.0]])[None, :, None] * np.array([1, 0, 0, 0, 0, 0])
    for given, when in ((states, 60.0), (shifted, 45.0)):
        found = nearest(given, 0.0, 120.0, 1e-9)
        assert found.distance[0] == pytest.approx(5.0, abs=TOLERANCE)
        assert found.bound[0] == pytest.approx(5.0, abs=TOLERANCE)
        assert found.time[0] == pytest.approx(when, abs=0.01)
        assert found.separation().pair == (0, 1)


@pytest.mark.parametrize("n", [2, 10, 30])
def test_in_the_linear_world_a_flight_is_the_plan_and_as_close_as_its_certificate_says(n):
    initial, controls = swarm(3, n)
    states = fly(initial, controls, PROBLEM)
    claimed = least_separation(states, controls, PROBLEM)
    world = LinearWorld(PROBLEM.dynamics)
    flown, least = fly_controls(world, initial, controls, PROBLEM)
    np.testing.assert_allclose(flown, states, atol=1e-9)
    assert least.pair == claimed.pair
    assert least.distance == pytest.approx(claimed.distance, abs=2 * TOLERANCE)
    assert least.time == pytest.approx(claimed.time, abs=1)


def test_the_nearer_of_two_arcs_is_chosen_by_trial():
    initial, controls = swarm(0)
    arcs = [WORLD.arc(initial, controls[:, k], k * 120.0, 120.0, 9) for k in (0, 4)]
    early, late = (
        nearest(np.stack(order), 0.0, 120.0, PROBLEM.mean_motion) for order in (arcs, arcs[::-1])
    )
    both = nearer(early, late)
    np.testing.assert_array_equal(both.distance, np.full(2, both.distance.min()))
    np.testing.assert_array_equal(both.first, np.full(2, both.first[0]))
    assert both.distance.min() == min(early.distance)


def test_a_craft_alone_is_near_nobody():
    initial, controls = swarm(0, 1)
    _, least = fly_controls(WORLD, initial, controls, PROBLEM)
    assert least.pair is None and least.bound == np.inf


def test_pieces_that_are_too_long_for_the_bound_are_refused():
    states = np.repeat(swarm(0)[0][None, :, None], 2, axis=2)
    with pytest.raises(InputError, match="cut into 1 pieces; expected at least 9"):
        nearest(states, 0.0, 120.0, PROBLEM.mean_motion)
