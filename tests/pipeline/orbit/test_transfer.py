"""Linear maps of a transfer, held against step-by-step flight and numerical optima."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from judge import exact_step
from scipy.optimize import minimize

from pipeline.orbit.problem import Problem
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.orbit.rings import pro_states
from pipeline.orbit.transfer import (
    fly,
    meet_goal,
    minimum_energy,
    project_to_flyable,
    step_maps,
    straight_line,
    track,
    with_coasts,
)

REFERENCE = Problem()


def step_by_step(start, controls, problem):
    """Flight by matrix exponentials of Eq. 1, one interval after the other."""
    A, B = exact_step(problem.mean_motion, problem.time_step)
    states = [start]
    for t in range(problem.intervals):
        states.append(states[-1] @ A.T + controls[:, t] @ B.T)
    return np.stack(states, axis=1)


def ends(n=3, seed=0, problem=REFERENCE):
    rng = np.random.default_rng(seed)

    def formation():
        a, phases = rng.uniform(100, 300, n), rng.uniform(0, 6, (2, n))
        return pro_states(a, rng.uniform(-0.7, 0.7, n), *phases, problem.mean_motion)

    return formation(), formation()


problems = st.builds(
    lambda step, nodes: Problem(time_step=step, nodes=nodes), st.floats(20, 600), st.integers(4, 30)
)


@given(problem=problems, seed=st.integers(0, 99))
@settings(max_examples=30)
def test_flying_by_maps_is_flying_step_by_step(problem, seed):
    start, _ = ends(seed=seed, problem=problem)
    controls = np.random.default_rng(seed).normal(size=(3, problem.intervals, 3)) * 1e-4
    assert fly(start, controls, problem) == pytest.approx(
        step_by_step(start, controls, problem), abs=1e-6
    )


@pytest.mark.parametrize("nodes", [65, 66, 200])
@pytest.mark.parametrize("eccentricity", [None, 0.5])
def test_flying_many_intervals_is_flying_step_by_step(nodes, eccentricity):
    problem = Problem(time_step=60.0, nodes=nodes)
    if eccentricity is not None:
        problem = problem.about(ReferenceOrbit(14e6, eccentricity, inclination_deg=50.0))
    start, _ = ends(problem=problem)
    controls = np.random.default_rng(5).normal(size=(3, problem.intervals, 3)) * 1e-4
    states, (A, B) = [start], step_maps(problem)
    for t in range(problem.intervals):
        states.append(states[-1] @ A[t].T + controls[:, t] @ B[t].T)
    found, stepped = fly(start, controls, problem), np.stack(states, axis=1)
    assert found == pytest.approx(stepped, rel=1e-11, abs=1e-11 * np.abs(stepped).max())


@given(problem=problems, seed=st.integers(0, 99))
@settings(max_examples=30)
def test_minimum_energy_meets_the_goal(problem, seed):
    start, goal = ends(seed=seed, problem=problem)
    final = step_by_step(start, minimum_energy(start, goal, problem), problem)[:, -1]
    assert final == pytest.approx(goal, abs=1e-6)


def test_no_other_controls_to_the_goal_have_less_energy():
    start, goal = ends(n=1)
    best = minimum_energy(start, goal, REFERENCE)
    rng = np.random.default_rng(1)
    for _ in range(20):
        other = meet_goal(start, best + rng.normal(size=best.shape) * 1e-4, goal, REFERENCE)
        assert np.square(other).sum() > np.square(best).sum()


def test_meeting_the_goal_leaves_controls_that_meet_it_alone():
    start, goal = ends()
    controls = minimum_energy(start, goal, REFERENCE)
    assert meet_goal(start, controls, goal, REFERENCE) == pytest.approx(controls, abs=1e-15)


def test_what_can_be_flown_is_its_own_projection():
    start, goal = ends()
    rng = np.random.default_rng(2)
    controls = meet_goal(start, rng.normal(size=(3, 10, 3)) * 1e-3, goal, REFERENCE)
    states = fly(start, controls, REFERENCE)
    assert project_to_flyable(states, start, goal, REFERENCE) == pytest.approx(controls, abs=1e-12)


def test_the_projection_is_exact_at_both_ends_whatever_is_projected():
    start, goal = ends()
    wild = np.random.default_rng(3).normal(size=(3, 11, 6)) * 1e3
    flown = step_by_step(start, project_to_flyable(wild, start, goal, REFERENCE), REFERENCE)
    assert flown[:, 0] == pytest.approx(start)
    assert flown[:, -1] == pytest.approx(goal, abs=1e-6)


def test_no_other_flyable_trajectory_is_nearer_than_the_projection():
    start, goal = ends(n=1)
    wanted = straight_line(start, goal, REFERENCE.nodes)
    weight = np.repeat([1.0, 1 / REFERENCE.mean_motion], 3)
    scale = 1e-3

    def distance(flat):
        controls = meet_goal(start, scale * flat.reshape(1, 10, 3), goal, REFERENCE)
        return float(np.square((fly(start, controls, REFERENCE) - wanted) * weight).sum())

    projected = project_to_flyable(wanted, start, goal, REFERENCE)
    found = minimize(distance, np.zeros(30), method="BFGS", options={"maxiter": 2000})
    assert distance(projected / scale) == pytest.approx(found.fun, rel=1e-4)
    assert distance(projected / scale) <= found.fun * (1 + 1e-9)


@pytest.mark.parametrize("step", [0.05, 2.0, 120.0])
@pytest.mark.parametrize("nodes", [4, 11, 41])
def test_what_a_projection_leaves_is_normal_to_all_that_can_be_flown(step, nodes):
    problem = Problem(time_step=step, nodes=nodes)
    rng, ends = np.random.default_rng(4), np.zeros((20, 6))
    weight = np.repeat([1.0, 1 / problem.mean_motion], 3)
    wanted = rng.normal(size=(20, nodes, 6)) / weight
    projected = project_to_flyable(wanted, ends, ends, problem)
    left = (wanted - step_by_step(ends, projected, problem)) * weight
    other = meet_goal(ends, rng.normal(size=projected.shape), ends, problem)
    way = step_by_step(ends, other, problem) * weight
    size = np.linalg.norm(way, axis=(1, 2)) * np.linalg.norm(left, axis=(1, 2))
    assert (way * left).sum(axis=(1, 2)) == pytest.approx(0, abs=1e-9 * size.max())


def test_a_straight_line_is_straight_and_joins_both_states():
    start, goal = ends()
    line = straight_line(start, goal, 11)
    assert line[:, 0] == pytest.approx(start)
    assert line[:, -1] == pytest.approx(goal)
    assert np.diff(line, n=2, axis=1) == pytest.approx(0, abs=1e-9)


def test_a_track_passes_through_the_nodes_and_through_half_steps():
    start, goal = ends()
    controls = minimum_energy(start, goal, REFERENCE)
    states = fly(start, controls, REFERENCE)
    fine = Problem(time_step=REFERENCE.time_step / 2, nodes=21)
    halves = step_by_step(start, np.repeat(controls, 2, axis=1), fine)
    assert track(states, controls, REFERENCE, 2) == pytest.approx(halves[..., :3], abs=1e-8)


def test_coasts_are_exact_zeros_and_every_goal_is_met_as_before():
    start, _ = ends(n=4, seed=2)
    rng = np.random.default_rng(0)
    burns = rng.uniform(size=(4, REFERENCE.intervals, 3)) < 0.4
    burns[:, [0, -1]] = True
    clean = np.where(burns, rng.normal(0, 1e-3, burns.shape), 0.0)
    noise = np.where(burns, 0.0, rng.choice([-1, 1], burns.shape) * 1.0)
    for size in (1e-19, 1e-11):  # of rounding, and of what an interior-point method leaves
        found = with_coasts(clean + size * noise, REFERENCE)
        np.testing.assert_array_equal(found != 0, burns)
        np.testing.assert_allclose(found, clean, atol=1e-9)
        wanted = step_by_step(start, clean + size * noise, REFERENCE)[:, -1]
        np.testing.assert_allclose(step_by_step(start, found, REFERENCE)[:, -1], wanted, atol=1e-8)
    np.testing.assert_array_equal(with_coasts(clean, REFERENCE), clean)


@pytest.mark.parametrize("off", [1e-9, 1e-8, 1e-3])
def test_of_coasts_nothing_is_left_to_set_to_zero(off):
    """Near half an orbit controls are so large that what is dropped moves craft by metres."""
    problem = Problem(time_step=(1 + off) * np.pi / REFERENCE.mean_motion)
    start, goal = ends(n=10)
    lines = straight_line(start, goal, problem.nodes)
    once = with_coasts(project_to_flyable(lines, start, goal, problem), problem)
    np.testing.assert_array_equal(with_coasts(once, problem), once)
