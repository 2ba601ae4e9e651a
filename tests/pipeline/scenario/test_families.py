"""Families of scenarios: what each looks like, that it is safe, and that it is repeatable."""

from functools import cache, partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from relative import linear_maps, pull

from pipeline.errors import InputError
from pipeline.orbit.dynamics import cw_matrices
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.orbit.rings import energy_mismatch, secular_drift
from pipeline.scenario import FAMILIES, SPLITS, check, draw, draw_many

PROBLEM = Problem()
E = PROBLEM.mean_motion


def least_distance_over_an_orbit(states, samples=4000):
    """Free drift of a formation by the closed form, on a fine grid of times."""
    A, _ = cw_matrices(E, np.linspace(0, 2 * np.pi / E, samples))
    i, j = np.triu_indices(len(states), 1)
    drift = A[:, :3] @ (states[i] - states[j]).T
    return np.sqrt(np.einsum("qip,qip->qp", drift, drift).min())


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("n", [1, 2, 5, 10])
def test_both_formations_are_energy_matched_and_stay_apart_for_a_whole_orbit(family, n):
    scenario = draw(family, 3, n, 7, PROBLEM)
    check(scenario)
    for end in (scenario.initial, scenario.goal):
        assert end.shape == (n, 6)
        assert energy_mismatch(end, E) == pytest.approx(0, abs=1e-12)
        if n > 1:
            assert least_distance_over_an_orbit(end) > PROBLEM.collision_radius


@cache
def maps_over_an_orbit(problem):
    """State transition matrices to positions every 5 s of an orbit, (times, 3, 6)."""
    begin = problem.orbit.states(np.zeros(1))[0]
    times = np.arange(5.0, 2 * np.pi / problem.mean_motion, 5.0)
    maps, _, _ = linear_maps(begin, times, partial(pull, j2=True))
    return maps[:, :3]


@pytest.mark.parametrize("family", FAMILIES)
def test_about_an_eccentric_orbit_under_j2_both_formations_are_bounded_and_stay_apart(family):
    """Looked at every 5 s of an orbit, by linear motion from complex-step derivatives."""
    orbit = ReferenceOrbit.of_mean(
        semi_major_axis=7.3e6, eccentricity=0.05, inclination_deg=51.6, argument_of_perigee_deg=40.0
    )
    scenario = draw(family, 3, 8, 7, PROBLEM.about(orbit))
    check(scenario)
    problem = scenario.problem
    ends = (scenario.initial, problem), (scenario.goal, problem.starting_at(problem.intervals))
    for end, about in ends:
        assert np.abs(secular_drift(end, about)).max() < 0.05
        i, j = np.triu_indices(len(end), 1)
        drift = np.einsum("qij,pj->qpi", maps_over_an_orbit(about), end[i] - end[j])
        assert np.linalg.norm(drift, axis=-1).min() > problem.collision_radius


@given(seed=st.integers(0, 10**9), n=st.integers(2, 12), index=st.integers(0, 10**6))
@settings(max_examples=20)
def test_a_scenario_is_a_function_of_seed_n_and_index_alone(seed, n, index):
    first = draw("rings", seed, n, index, PROBLEM)
    draw("rings", seed, n, index + 1, PROBLEM)
    again = draw("rings", seed, n, index, PROBLEM)
    assert (first.initial == again.initial).all()
    assert (first.goal == again.goal).all()


def test_other_seeds_sizes_and_indices_give_other_scenarios():
    states = {
        draw("rings", seed, n, index, PROBLEM).initial.tobytes()
        for seed in (0, 1)
        for n in (4, 5)
        for index in range(3)
    }
    assert len(states) == 12


def ring_sizes(states):
    """Semi-major axis of each craft's orbit: its along-track extent, from x² + (y/2)²."""
    centre = states[:, 1] - 2 * states[:, 3] / E
    return np.hypot(2 * states[:, 0], states[:, 1] - centre)


def test_rings_have_one_or_two_sizes_in_range_with_evenly_divided_craft():
    counts = set()
    for index in range(40):
        sizes = np.round(ring_sizes(draw("rings", 0, 10, index, PROBLEM).initial), 6)
        assert ((sizes >= 100) & (sizes <= 300)).all()
        _, each = np.unique(sizes, return_counts=True)
        counts.add(tuple(each))
    assert counts == {(10,), (5, 5)}


def test_the_coplanar_split_goes_from_200_m_to_100_m_and_300_m_in_the_orbital_plane():
    scenario = draw("coplanar-split", 0, 10, 0, PROBLEM)
    assert ring_sizes(scenario.initial) == pytest.approx(np.full(10, 200.0))
    assert np.sort(ring_sizes(scenario.goal)) == pytest.approx([100.0] * 5 + [300.0] * 5)
    assert scenario.goal[:, [2, 5]] == pytest.approx(0)


def test_the_tilt_split_goes_to_two_rings_slanted_by_45_degrees():
    scenario = draw("tilt-split", 0, 10, 0, PROBLEM)
    height = np.hypot(scenario.goal[:, 2], scenario.goal[:, 5] / E)
    assert height == pytest.approx(np.full(10, 100.0))
    assert ring_sizes(scenario.goal) == pytest.approx(np.full(10, 200.0))


def test_a_rotation_stays_on_one_ring():
    scenario = draw("rotation", 0, 8, 0, PROBLEM)
    sizes = ring_sizes(np.concatenate([scenario.initial, scenario.goal]))
    assert sizes == pytest.approx(np.full(16, sizes[0]))


def test_rings_grow_with_the_swarm_beyond_30_craft():
    assert ring_sizes(draw("coplanar-split", 0, 60, 0, PROBLEM).initial) == pytest.approx(
        np.full(60, 400.0)
    )


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("n", [1, 7])
def test_scenarios_drawn_side_by_side_are_those_drawn_alone(family, n):
    which = [(split, index) for index in (0, 3, 4) for split in SPLITS]
    crowded = Problem(collision_radius=40.0)  # so that some formations are drawn again
    for scenario, (split, index) in zip(
        draw_many(family, 2, n, which, crowded), which, strict=True
    ):
        alone = draw(family, 2, n, index, crowded, split)
        assert scenario.name == alone.name
        assert scenario.initial.tobytes() == alone.initial.tobytes()
        assert scenario.goal.tobytes() == alone.goal.tobytes()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"family": "spiral"}, "rings or coplanar-split"),
        ({"n": 0}, "n is 0; expected a number from 1 to 10000"),
        ({"seed": -1}, "seed is -1; expected a number from 0 to 4294967295"),
    ],
)
def test_what_cannot_be_drawn_is_refused_in_a_sentence(change, words):
    asked = {"family": "rings", "seed": 0, "n": 3, "index": 0, "problem": PROBLEM} | change
    with pytest.raises(InputError, match=words):
        draw(**asked)


def test_craft_that_do_not_fit_are_refused():
    with pytest.raises(InputError, match="smaller collision_radius"):
        draw("rings", 0, 30, 0, Problem(collision_radius=300.0))


@pytest.mark.parametrize("n", [2, 10, 30])
def test_dense_rings_are_as_small_as_passive_safety_lets_them_be(n):
    for index in range(3):
        scenario = draw("dense", 0, n, index, PROBLEM)
        for end in (scenario.initial, scenario.goal):
            least = least_distance_over_an_orbit(end)
            assert least == pytest.approx(1.02 * PROBLEM.collision_radius, rel=1e-4)
            assert np.abs(end[:, :3]).max() <= 1.75 * PROBLEM.collision_radius * np.sqrt(n)
