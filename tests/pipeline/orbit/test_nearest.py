"""The least separation of flown arcs against samples so dense that they cannot miss it."""

import numpy as np
import pytest
from one_swarm import least_separation

from pipeline.expert import decoupled_optima
from pipeline.flight.effects import fly_controls
from pipeline.flight.world import LinearWorld, NonlinearWorld
from pipeline.orbit.approaches import TOLERANCE
from pipeline.orbit.chebyshev import NODES
from pipeline.orbit.nearest import nearest, smaller_separation
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import radius_at
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.orbit.transfer import fly
from pipeline.scenario import Scenario, draw

PROBLEM = Problem()

ORBIT = ReferenceOrbit(radius_at(PROBLEM.mean_motion), 0.01, 97.4, 11.0, 115.0, 57.0)
ECCENTRIC = ReferenceOrbit(4e7, 0.8, 97.4, 11.0, 115.0, 115.0)
WORLD = NonlinearWorld(ORBIT, PROBLEM.time_step, PROBLEM.intervals)


def swarm(index, n=10):
    """Initial states and controls that avoid nobody."""
    scenario = draw("rings", 0, n, index, PROBLEM)
    return scenario.initial, decoupled_optima(scenario.initial, scenario.goal, PROBLEM).controls


def sampled_arc(arc, many):
    """Positions at equally spaced times of an arc."""
    pieces = arc.shape[1]
    times = np.linspace(0.0, pieces, many + 1)
    piece = np.minimum(times.astype(int), pieces - 1)
    positions = np.empty((len(arc), many + 1, 3))
    for m in range(pieces):
        at = 2 * (times[piece == m] - m) - 1
        for craft, states in enumerate(arc[:, m]):
            curves = [np.polynomial.Polynomial.fit(NODES, states[:, k], 11) for k in range(3)]
            positions[craft, piece == m] = np.stack([curve(at) for curve in curves], axis=1)
    return positions


def sampled(states):
    """The least distance in samples, the pair and which sample."""
    i, j = np.triu_indices(len(states), 1)
    apart = np.linalg.norm(states[i, :, :3] - states[j, :, :3], axis=-1)
    pair, sample = np.unravel_index(apart.argmin(), apart.shape)
    return apart[pair, sample], (i[pair], j[pair]), sample


@pytest.mark.parametrize("orbit", [ORBIT, ECCENTRIC], ids=["e 0.01", "e 0.8"])
def test_no_sample_is_nearer_and_the_nearest_is_attained(orbit):
    """Of many trials in one call, each on its own; samples by polynomials of numpy."""
    duration, many = 600.0, 6000
    world = NonlinearWorld(orbit, duration, 1)
    begin = [swarm(index) for index in range(6)]
    arcs = [world.arc(initial, controls[:, 0], 0) for initial, controls in begin]
    found = nearest(np.stack(arcs), 100.0, duration)
    dense = [sampled_arc(arc, many) for arc in arcs]
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
    when = 30 * np.array([NODES, NODES + 2])[..., None] - 30  # s since the middle, of two pieces
    one = np.concatenate([when, 0 * when, 0 * when, 0 * when + 1, 0 * when, 0 * when], axis=-1)
    other = one * [-1, 1, 1, -1, 1, 1] + [0, 3, 4, 0, 0, 0]
    states = np.array([[one, other]])
    shifted = states + np.array([[30.0], [0.0]])[:, None, None] * np.array([1, 0, 0, 0, 0, 0])
    for given, middle in ((states, 60.0), (shifted, 45.0)):
        found = nearest(given, 0.0, 120.0)
        assert found.distance[0] == pytest.approx(5.0, abs=TOLERANCE)
        assert found.bound[0] == pytest.approx(5.0, abs=TOLERANCE)
        assert found.time[0] == pytest.approx(middle, abs=0.01)
        assert found.separation().pair == (0, 1)


@pytest.mark.parametrize("n", [2, 10, 30])
def test_in_the_linear_world_a_flight_is_the_plan_and_as_close_as_its_certificate_says(n):
    initial, controls = swarm(3, n)
    states = fly(initial, controls, PROBLEM)
    claimed = least_separation(states, controls, PROBLEM)
    world = LinearWorld(PROBLEM.dynamics)
    flown, _, met = fly_controls(world, Scenario(PROBLEM, initial, initial), controls)
    least = met.craft.separation()
    np.testing.assert_allclose(flown, states, atol=1e-9)
    assert least.pair == claimed.pair
    assert least.distance == pytest.approx(claimed.distance, abs=2 * TOLERANCE)
    assert least.time == pytest.approx(claimed.time, abs=1)


def test_the_nearer_of_two_arcs_is_chosen_by_trial():
    initial, controls = swarm(0)
    arcs = [WORLD.arc(initial, controls[:, k], k) for k in (0, 4)]
    early, late = (nearest(np.stack(order), 0.0, 120.0) for order in (arcs, arcs[::-1]))
    both = smaller_separation(early, late)
    np.testing.assert_array_equal(both.distance, np.full(2, both.distance.min()))
    np.testing.assert_array_equal(both.first, np.full(2, both.first[0]))
    assert both.distance.min() == min(early.distance)


def test_a_craft_alone_is_near_nobody():
    initial, controls = swarm(0, 1)
    _, _, met = fly_controls(WORLD, Scenario(PROBLEM, initial, initial), controls)
    least = met.craft.separation()
    assert least.pair is None and least.bound == np.inf
