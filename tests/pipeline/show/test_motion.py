"""What a page shows of the motion is exact at every time, and has the closest approaches."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from clohessy import position
from scipy.optimize import minimize_scalar

from pipeline.errors import InputError
from pipeline.expert import decoupled_optima, solve
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import HIGHEST, mean_motion_at
from pipeline.orbit.transfer import fly, free_drift, track
from pipeline.scenario import draw
from pipeline.scenario.document import read_scenario
from pipeline.show.data import (
    closest_pairs,
    distinct,
    nearest_pair,
    orbits,
    page_data,
    positions_at,
    sample_times,
    steps_of,
)

PROBLEM = Problem()
NONE = np.zeros(0)
EXAMPLES = Path(__file__).parents[3] / "examples"


def own(n, index=0, problem=PROBLEM):
    """States and controls of each craft's own optimum, which heed no other craft."""
    scenario = draw("rings", 0, n, index, problem)
    controls = decoupled_optima(scenario.initial, scenario.goal, problem).controls
    return scenario, fly(scenario.initial, controls, problem), controls


def truth(scenario, controls, craft, time):
    problem = scenario.problem
    told = scenario.initial[craft], controls[craft], problem.mean_motion, problem.time_step
    return position(*told, time)


def test_positions_are_those_of_the_matrix_exponential_at_nodes_and_between():
    scenario, states, controls = own(3)
    times = np.array([0.0, 3.7, 119.9, 120.0, 640.1, 1199.99, 1200.0])
    found = positions_at(times, states, controls, PROBLEM)
    wanted = [[truth(scenario, controls, k, t) for t in times] for k in range(3)]
    np.testing.assert_allclose(found, wanted, atol=1e-8)


@pytest.mark.parametrize("altitude", [500e3, HIGHEST])
def test_an_orbit_of_free_drift_is_the_exponential_without_controls_and_closes(altitude):
    """Also where a sixteenth of the orbit takes longer than an interval may."""
    problem = Problem(mean_motion=mean_motion_at(altitude))
    scenario, _, _ = own(2, problem=problem)
    found = orbits(scenario.goal, problem)
    period = 2 * np.pi / problem.mean_motion
    times = np.linspace(0, period, found.shape[1])
    idle = (problem.mean_motion, period)
    for k in range(2):
        wanted = [position(scenario.goal[k], np.zeros((1, 3)), *idle, t) for t in times]
        np.testing.assert_allclose(found[k], wanted, atol=1e-7)
    np.testing.assert_allclose(found[:, 0], found[:, -1], atol=1e-6)


def test_an_orbit_longer_than_any_drift_is_refused_by_its_mean_motion():
    words = (
        r"^mean_motion is 1e-09 rad/s, by which a free drift of 1 orbits takes 6\.28e\+09 s; exp"
    )
    with pytest.raises(InputError, match=words):
        free_drift(np.zeros((1, 6)), Problem(mean_motion=1e-9))


@pytest.mark.parametrize(("n", "nodes"), [(1, 11), (30, 61), (100, 11), (300, 11), (5000, 11)])
def test_samples_hold_the_nodes_and_grow_sparse_only_beyond_100_craft(n, nodes):
    problem = Problem(nodes=nodes)
    times = sample_times(n, problem, np.array([77.7]))
    grid = np.arange(nodes) * problem.time_step
    assert np.abs(times[:, None] - grid).min(axis=0).max() < 1e-9
    assert 77.7 in times
    assert np.all(np.diff(times) > 0)
    assert steps_of(n, problem) * problem.intervals == (
        240 if n <= 100 else max(240 * 100 // n, 10)
    )


@pytest.mark.parametrize("sized", [0.0, 1.0, 20.0], ids=["alike", "sized", "too large"])
@pytest.mark.parametrize("n", [2, 3, 20])
def test_the_closest_pairs_are_those_of_a_search_by_the_exponential(n, sized):
    """By how much further apart they are than both radii, where they have some."""
    scenario, states, controls = own(n, index=1)
    radii = 7.5 + sized * np.random.default_rng(0).uniform(-5, 5, size=n)
    found = closest_pairs(states, controls, PROBLEM, radii=radii if sized else None)
    grid = np.linspace(0, 1200, 241)
    paths = [[truth(scenario, controls, k, t) for t in grid] for k in range(n)]
    paths = np.array(paths)

    def least(i, j):
        """The least distance of two craft: the best of a fine grid, then made exact."""

        def apart(t):
            return np.linalg.norm(truth(scenario, controls, i, t) - truth(scenario, controls, j, t))

        rough = grid[np.linalg.norm(paths[i] - paths[j], axis=1).argmin()]
        ends = (max(rough - 5, 0), min(rough + 5, 1200))
        best = minimize_scalar(apart, bounds=ends, method="bounded", options={"xatol": 1e-6})
        return min(best.fun, apart(ends[0]), apart(ends[1]))

    sampled = {
        (i, j): np.linalg.norm(paths[i] - paths[j], axis=1).min()
        for i in range(n)
        for j in range(i + 1, n)
    }

    def beyond(pair):
        return sampled[pair] - radii[list(pair)].sum()

    def exact(pair):
        return least(*pair) - radii[list(pair)].sum()

    near = sorted(sorted(sampled, key=beyond)[:10], key=exact)[:6]
    wanted = [(least(*pair), *pair) for pair in near]
    assert [(p.first, p.second) for p in found] == [(i, j) for _, i, j in wanted]
    for pair, (distance, i, j) in zip(found, wanted, strict=True):
        assert pair.distance == pytest.approx(distance, abs=2e-4)
        assert pair.wanted == pytest.approx(radii[i] + radii[j])
        at = [truth(scenario, controls, k, pair.time) for k in (i, j)]
        assert np.linalg.norm(at[0] - at[1]) == pytest.approx(distance, abs=2e-4)


def test_the_nearest_two_at_each_time_are_those_of_all_pairs():
    _, states, controls = own(12)
    at = positions_at(sample_times(12, PROBLEM, NONE), states, controls, PROBLEM)
    pairs, distance = nearest_pair(at)
    apart = np.linalg.norm(at[:, None] - at[None], axis=-1)
    apart[np.arange(12), np.arange(12)] = np.inf
    np.testing.assert_allclose(distance, apart.min(axis=(0, 1)), atol=1e-9)
    where = apart[pairs[:, 0], pairs[:, 1], np.arange(at.shape[1])]
    np.testing.assert_allclose(where, distance, atol=1e-9)


def test_craft_in_one_place_are_two_craft():
    pairs, distance = nearest_pair(np.zeros((2, 3, 3)))
    assert pairs.tolist() == [[0, 1]] * 3
    assert distance.tolist() == [0.0] * 3


def test_the_certificates_closest_approach_is_among_the_samples():
    scenario = draw("rings", 0, 10, 0, PROBLEM)
    plan = solve(scenario)
    data, _ = page_data(plan)
    k = data["times"].index(plan.certificate.min_separation_time)
    closest = [mm[k] for mm in data["separations"]]
    assert min(closest) / 1000 == pytest.approx(plan.certificate.min_separation, abs=1e-3)
    assert data["nearest"]["pairs"][k] == list(plan.certificate.min_separation_pair)


def test_all_that_is_drawn_is_in_the_box_whose_sides_are_never_too_unequal():
    scenario = draw("rings", 0, 3, 0, PROBLEM)
    data, _ = page_data(solve(scenario))
    drawn = [data["positions"], data["orbits"]["initial"], data["orbits"]["goal"]]
    points = np.concatenate([np.array(part).reshape(-1, 3) / 100 for part in drawn])
    assert data["radii"] == [7.5] * 3, "true to scale"
    low, high = np.array(data["box"]).T
    assert np.all(points - 7.5 >= low) and np.all(points + 7.5 <= high)
    assert (high - low).min() > 0.29 * (high - low).max()


def test_orbits_far_larger_than_the_paths_are_not_drawn_and_others_without_corners():
    """SIMBOL-X drifts over 1,900 km where it starts, and goes 30 km, on an orbit of e = 0.8."""
    scenario = read_scenario(EXAMPLES / "simbol-x.json")
    coarse = replace(scenario.problem, nodes=201, time_step=scenario.problem.duration / 200)
    scenario = replace(scenario, problem=coarse)
    plan = solve(scenario)
    data, _ = page_data(plan)
    drifts = [orbits(scenario.initial, scenario.problem)]
    goal = scenario.problem.starting_at(scenario.problem.intervals)
    drifts.append(track(*free_drift(scenario.goal, goal), 256))
    assert np.ptp(drifts[0], axis=1).max() > 1e6
    assert data["orbits"]["initial"] == []
    size = np.ptp(data["box"], axis=1).max()
    assert size < 1.3 * np.ptp(plan.states[..., :3], axis=1).max()
    line = np.array(data["orbits"]["goal"][0]) / 100
    start, step = line[:-1], np.diff(line, axis=0)
    for point in drifts[1][0]:
        along = np.vecdot(point - start, step) / np.vecdot(step, step)
        nearest = start + np.clip(along, 0, 1)[:, None] * step
        assert np.linalg.norm(point - nearest, axis=1).min() < 0.01 * size


def test_craft_that_share_an_orbit_share_its_line():
    """So that the dashes of one do not fill the gaps of another; each craft is on a line."""
    scenario = draw("rings", 0, 30, 0, PROBLEM)
    data, _ = page_data(solve(scenario))
    assert [len(data["orbits"][end]) for end in ("initial", "goal")] == [2, 1]
    lines = np.array(data["orbits"]["initial"]) / 100
    for state in scenario.initial[:, :3]:
        assert np.linalg.norm(lines - state, axis=-1).min() < 15, "half of a step along it"
    apart = distinct(lines + np.array([[[0.0]], [[1.0]]]), 0.1)
    assert len(apart) == 2
    assert len(distinct(np.zeros((3, 5, 3)), 0.1)) == 1, "craft that rest in one place"


def test_a_cone_is_drawn_as_far_as_its_craft_and_small_craft_so_that_they_are_seen():
    scenario = read_scenario(EXAMPLES / "station-docking.json")
    assert scenario.radii.max() < 0.01
    plan = solve(scenario)
    data, _ = page_data(plan)
    apex = np.array(scenario.corridors[0].inside.apex)
    ends = np.array(data["corridors"][0]) / 100
    furthest = np.linalg.norm(plan.states[0, :, :3] - apex, axis=1).max()
    length = np.unique(np.linalg.norm(ends - apex, axis=1).round(1))
    assert length == pytest.approx([0, furthest], abs=0.1)
    low, high = np.array(data["box"]).T
    assert np.all(ends > low) and np.all(ends < high)
    assert 0.003 < data["radii"][0] / (high - low).max() < 0.01


def test_a_cone_that_counts_between_two_times_of_the_page_is_drawn_as_far_as_its_craft_there():
    scenario = read_scenario(EXAMPLES / "station-docking.json")
    plan = solve(scenario)
    spacing = np.diff(page_data(plan)[0]["times"]).max()
    brief = replace(scenario.corridors[0], begin=0.4 * spacing, end=0.6 * spacing)
    data, _ = page_data(replace(plan, scenario=replace(scenario, corridors=(brief,))))
    apex = np.array(brief.inside.apex)
    length = np.linalg.norm(np.array(data["corridors"][0]) / 100 - apex, axis=1).max()
    assert length == pytest.approx(np.linalg.norm(plan.states[0, 0, :3] - apex), rel=0.05)
