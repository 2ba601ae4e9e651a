"""Separation at nodes as in Eq. 5, and at all times, where nothing may slip through."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from judge import Case
from judge.separation import closest_approaches
from one_swarm import least_separation
from scipy.optimize import minimize_scalar

from pipeline.orbit.approaches import TOLERANCE, close_approaches
from pipeline.orbit.dynamics import cw_matrices
from pipeline.orbit.partition import swarm_partition
from pipeline.orbit.problem import Problem
from pipeline.orbit.separation import (
    least_separations,
    node_collisions,
    pair_conflicts,
    swarm_node_collisions,
)
from pipeline.orbit.transfer import fly, minimum_energy
from pipeline.scenario import draw


def dense_minimum(states, controls, problem, i, j, samples=400):
    """Least distance of one pair: fine samples, each dip refined by Brent's method."""
    e, h = problem.mean_motion, problem.time_step
    times, best = np.linspace(0, h, samples + 1), np.inf
    drift, push = cw_matrices(e, times)
    for k in range(problem.intervals):
        ds, du = states[i, k] - states[j, k], controls[i, k] - controls[j, k]

        def gap(t, ds=ds, du=du):
            A, B = cw_matrices(e, t)
            return float(np.linalg.norm((A @ ds + B @ du)[:3]))

        q = int(np.linalg.norm((drift @ ds + push @ du)[:, :3], axis=1).argmin())
        bounds = times[max(q - 1, 0)], times[min(q + 1, samples)]
        found = minimize_scalar(gap, bounds=bounds, method="bounded", options={"xatol": 1e-9})
        best = min(best, found.fun, gap(times[q]))
    return best


def test_collisions_are_pairs_and_nodes_within_the_radius_the_radius_included():
    states = np.zeros((3, 2, 6))
    states[1, :, 0] = [15.0, 15.001]
    states[2, :, 0] = [-100.0, 5.0]
    # node 1: 0-1 at 15 m; node 2: 0-2 at 5 m, 1-2 at 10.001 m
    assert node_collisions(states, 15.0) == 3


def test_a_batch_of_swarms_has_its_collisions_each():
    states = np.zeros((2, 2, 4, 6))
    states[1, 1, :, 1] = 1000.0
    assert node_collisions(states, 15.0).tolist() == [4, 0]


@given(
    speed=st.floats(0.05, 1.0),
    miss=st.floats(0.01, 14.0),
    moment=st.floats(0.02, 0.98),
    direction=st.integers(0, 2),
)
def test_a_pass_between_two_nodes_is_found_however_fast(speed, miss, moment, direction):
    """Two craft in free space: far at both nodes, ``miss`` apart in between."""
    problem = Problem(mean_motion=1e-12, time_step=120.0, nodes=3)
    when = moment * problem.duration
    axes = np.roll(np.eye(3), direction, axis=0)
    start = np.zeros((2, 6))
    start[1, :3] = miss * axes[0] - speed * when * axes[1]
    start[1, 3:] = speed * axes[1]
    controls = np.zeros((2, 2, 3))
    found = least_separation(fly(start, controls, problem), controls, problem)
    assert found.distance == pytest.approx(miss, abs=2 * TOLERANCE)
    assert found.bound <= miss + 1e-6
    assert speed * abs(found.time - when) < 0.1
    assert found.pair == (0, 1)


@given(seed=st.integers(0, 10_000), step=st.floats(30, 900), push=st.floats(0, 2e-3))
@settings(max_examples=25)
def test_the_least_separation_is_that_of_a_dense_search_and_its_bound_is_below(seed, step, push):
    problem = Problem(time_step=step, nodes=4)
    rng = np.random.default_rng(seed)
    start = rng.normal(size=(3, 6)) * [100, 100, 100, 0.2, 0.2, 0.2]
    controls = rng.normal(size=(3, 3, 3)) * push
    states = fly(start, controls, problem)
    true = min(dense_minimum(states, controls, problem, i, j) for i, j in [(0, 1), (0, 2), (1, 2)])
    found = least_separation(states, controls, problem)
    assert found.bound <= true + 1e-9
    assert found.distance == pytest.approx(true, abs=2 * TOLERANCE)


def test_only_intervals_that_may_come_within_the_distance_are_returned():
    problem = Problem(mean_motion=1e-12, time_step=100.0, nodes=4)
    start = np.array([[0, 0, 0, 0, 0, 0], [-150.0, 10, 0, 1.0, 0, 0]])
    controls = np.zeros((2, 3, 3))
    states = fly(start, controls, problem)
    found = close_approaches(states, controls, problem, within=20.0)
    assert found.interval.tolist() == [1]
    assert found.offset == pytest.approx([50.0], abs=0.1)


def test_pairs_in_conflict_are_counted_once_however_often_they_meet():
    problem = Problem(time_step=60.0, nodes=5)
    start = np.zeros((3, 6))
    start[1, 2], start[2, 1] = 5.0, 500.0
    controls = np.zeros((3, 4, 3))
    assert pair_conflicts(fly(start, controls, problem), controls, problem) == 1


def test_a_single_craft_has_no_separation():
    problem = Problem()
    found = least_separation(np.zeros((1, 11, 6)), np.zeros((1, 10, 3)), problem)
    assert found.distance == np.inf
    assert found.pair is None


@pytest.mark.parametrize("share", [1.0, 0.7, 0.1])
@pytest.mark.parametrize(
    ("n", "spread", "speed", "step"),
    [(60, 120.0, 0.3, 120.0), (140, 200.0, 3.0, 120.0), (60, 120.0, 0.05, 1500.0)],
)
def test_no_close_pair_of_a_large_swarm_is_overlooked(n, spread, speed, step, share):
    """Of so few craft that all are compared, and of so many that trees find them.

    All of them have moved, or most, or so few that these alone are looked for in the trees.
    """
    problem, rng = Problem(nodes=4, time_step=step), np.random.default_rng(0)
    start = rng.normal(size=(n, 6)) * np.repeat([spread, speed], 3)
    controls = rng.normal(size=(n, 3, 3)) * 1e-3 * (120.0 / step) ** 2
    states, moved = fly(start, controls, problem), np.arange(n) % 10 < 10 * share
    found = close_approaches(states, controls, problem, within=40.0, moved=moved)
    A, B = cw_matrices(problem.mean_motion, np.linspace(0, problem.time_step, 120))
    i, j = np.triu_indices(n, 1)
    ds, du = states[i, :-1] - states[j, :-1], controls[i] - controls[j]
    gap = np.tensordot(ds, A[:, :3], (2, 2)) + np.tensordot(du, B[:, :3], (2, 2))
    close = np.vecdot(gap, gap).min(axis=-1) <= 40.0**2
    row, interval = np.nonzero(close & (moved[i] | moved[j])[:, None])
    known = list(zip(found.first, found.second, found.interval, strict=True))
    assert len(row) > 5
    assert set(known) >= set(zip(i[row], j[row], interval, strict=True))
    assert (moved[found.first] | moved[found.second]).all()
    assert known == sorted(set(known), key=lambda one: (one[2], one[0], one[1]))


@pytest.mark.parametrize(("n", "few"), [(2, False), (140, False), (140, True)])
@pytest.mark.parametrize("chord", range(4))
@pytest.mark.parametrize("axis", range(3))
def test_two_craft_that_meet_head_on_where_their_chords_end_are_found(axis, chord, n, few):
    """They are the fastest by far, so that midpoints of their chords are as far apart as can be."""
    problem = Problem(nodes=4)
    start = np.zeros((n, 6))
    start[:, 1] = 5e3 + 300.0 * np.arange(n)
    there, time = np.zeros(6), problem.time_step * (1 + chord / 4)
    there[3 + axis] = 20.0
    back = np.linalg.inv(cw_matrices(problem.mean_motion, time)[0])
    start[:2] = back @ there, back @ -there
    controls = np.zeros((n, 3, 3))
    moved = np.arange(n) < 2 if few else None
    states = fly(start, controls, problem)
    found = close_approaches(states, controls, problem, within=1e-3, moved=moved)
    assert set(zip(found.first, found.second, strict=True)) == {(0, 1)}
    assert found.distance.min() < 1e-3
    assert found.times(problem)[found.distance.argmin()] == pytest.approx(time, abs=1e-3)


@pytest.mark.parametrize("n", [2, 140])
@pytest.mark.parametrize("axis", range(3))
def test_a_craft_that_turns_back_where_another_waits_is_found(axis, n):
    """Midway between the ends of its chord, from which it is as far as its thrust can take it."""
    problem = Problem(nodes=4)
    e, h = problem.mean_motion, problem.time_step
    tau, thrust = h / 4 if n > 128 else h, 0.1 * np.eye(3)[axis]
    start = np.zeros((n, 6))
    start[:, 1] = 5e3 + 300.0 * np.arange(n)
    controls = np.zeros((n, 3, 3))
    controls[0, 1] = thrust
    turn = np.concatenate([np.zeros(3), -thrust * tau / 2])  # at the first inner node
    A, B = cw_matrices(e, tau / 2)
    there = np.concatenate([(A @ turn + B @ thrust)[:3], np.zeros(3)])
    start[0] = np.linalg.inv(cw_matrices(e, h)[0]) @ turn
    start[1] = np.linalg.inv(cw_matrices(e, h + tau / 2)[0]) @ there
    found = close_approaches(fly(start, controls, problem), controls, problem, within=1e-3)
    assert list(zip(found.first, found.second, found.interval, strict=True)) == [(0, 1, 1)]
    assert found.distance[0] < 1e-3
    assert found.times(problem)[0] == pytest.approx(h + tau / 2, abs=0.1)


def test_pairs_of_which_neither_moved_are_left_out():
    problem = Problem(nodes=3)
    start = np.zeros((3, 6))
    start[:, 2] = [0.0, 5.0, 10.0]
    controls = np.zeros((3, 2, 3))
    moved = np.array([True, False, False])
    found = close_approaches(fly(start, controls, problem), controls, problem, 20.0, moved=moved)
    assert set(zip(found.first, found.second, strict=True)) == {(0, 1), (0, 2)}


def on_rings(n):
    """States, controls and problem of minimum-energy transfers of craft on rings."""
    scenario = draw("rings", 2022, n, 0, Problem())
    problem = scenario.problem
    controls = minimum_energy(scenario.initial, scenario.goal, problem)
    return fly(scenario.initial, controls, problem), controls, problem


def test_searched_in_portions_or_at_once_a_large_swarm_has_the_same_approaches(monkeypatch):
    """In a thousand craft on rings, of which some meet."""
    states, controls, problem = on_rings(1000)
    at_once = close_approaches(states, controls, problem, within=20.0)
    monkeypatch.setattr("pipeline.orbit.approaches.TOGETHER", 100)
    monkeypatch.setattr("pipeline.orbit.approaches.PAIRS_AT_ONCE", 1000)
    parts = close_approaches(states, controls, problem, within=20.0)
    assert len(at_once) > 100
    for name in ("first", "second", "interval", "offset", "distance", "bound"):
        assert np.array_equal(getattr(parts, name), getattr(at_once, name))


def test_searched_interval_by_interval_or_at_once_all_pairs_have_the_same_approaches(monkeypatch):
    flown = on_rings(30)
    at_once = close_approaches(*flown, within=60.0)
    monkeypatch.setattr("pipeline.orbit.closest.ROOM", 1)
    parts = close_approaches(*flown, within=60.0)
    assert len(np.unique(at_once.interval)) > 3
    for name in ("first", "second", "interval", "offset", "distance", "bound"):
        assert np.array_equal(getattr(parts, name), getattr(at_once, name))


@pytest.mark.parametrize("count", [1, 40])
def test_few_moved_craft_of_a_large_swarm_have_the_approaches_that_are_found_among_all(
    count, monkeypatch
):
    states, controls, problem = on_rings(1000)
    found = close_approaches(states, controls, problem, within=60.0)
    often = np.bincount(np.concatenate([found.first, found.second]), minlength=1000)
    moved = np.isin(np.arange(1000), (-often).argsort(kind="stable")[:count])
    monkeypatch.setattr("pipeline.orbit.partition.DISTANCES_AT_ONCE", 1000)
    some = close_approaches(states, controls, problem, within=60.0, moved=moved)
    kept = moved[found.first] | moved[found.second]
    assert kept.sum() >= 5
    if count > 1:
        assert (moved[found.first] & moved[found.second]).any()
    for name in ("first", "second", "interval", "offset", "distance", "bound"):
        assert np.array_equal(getattr(some, name), getattr(found, name)[kept])


def test_no_bracket_is_wider_than_its_tolerance():
    """Found by trying: the interval's length is such that its quartic error takes all there is."""
    problem = Problem(mean_motion=1.1e-3, time_step=99.7044606908545, nodes=3)
    start = np.zeros((2, 6))
    start[1] = [
        *(0.6795859862413618, 1.9844401894746042, -0.7769599555099166),
        *(-0.0058505481636823755, 0.0024888567707814437, 0.007877911110303648),
    ]
    controls = np.zeros((2, 2, 3))
    controls[1] = -0.004663853020415581, -0.0016934529507015488, 0.0005122584149789817
    states = fly(start, controls, problem)
    found = close_approaches(states[:, :2], controls[:, :1], problem, within=1e3)
    assert (found.distance - found.bound <= TOLERANCE).all()


@pytest.mark.parametrize("sizes", [(3, 1, 5), (2, 140, 4)])
def test_swarms_side_by_side_are_as_each_alone(sizes):
    """They fly through the same space and know nothing of each other."""
    problem, rng = Problem(nodes=5), np.random.default_rng(7)
    parts = []
    for n in sizes:
        start = rng.normal(scale=[25, 25, 25, 0.05, 0.05, 0.05], size=(n, 6))
        controls = rng.normal(scale=2e-4, size=(n, 4, 3))
        parts.append((fly(start, controls, problem), controls))
    states, controls = (np.concatenate(both) for both in zip(*parts, strict=True))
    swarms = swarm_partition(sizes)
    together = least_separations(states, controls, problem, swarms)
    assert together == [least_separation(*part, problem) for part in parts]
    assert list(swarm_node_collisions(states, 15.0, swarms)) == [
        node_collisions(part, 15.0) for part, _ in parts
    ]
    found = close_approaches(states, controls, problem, 25.0, swarms=swarms)
    alone = [close_approaches(*part, problem, 25.0) for part in parts]
    assert len(found.first) == sum(len(one.first) for one in alone) > 0
    assert (swarms.label[found.first] == swarms.label[found.second]).all()


def test_collisions_of_a_large_swarm_are_counted_pair_by_pair():
    rng = np.random.default_rng(3)
    states = rng.normal(scale=80.0, size=(140, 4, 6))
    gap = np.linalg.norm(states[:, None, :, :3] - states[None, :, :, :3], axis=-1)
    i, j = np.triu_indices(140, 1)
    assert node_collisions(states, 15.0) == (gap[i, j] <= 15.0).sum() > 0
    both = node_collisions(np.stack([states, 2 * states]), 15.0)
    assert both.tolist() == [(gap[i, j] <= least).sum() for least in (15.0, 7.5)]


def translated(along, shift, problem):
    """Craft at rest on the reference orbit, moved along it by as much, each as the others."""
    initial = np.zeros((len(along), 6))
    initial[:, 1] = along
    goal = initial + np.eye(6)[1] * shift
    controls = minimum_energy(initial, goal, problem)
    return fly(initial, controls, problem), controls


@given(
    gap=st.floats(1.0, 200.0),
    other=st.floats(1.0, 200.0),
    begin=st.floats(-500.0, 500.0),
    shift=st.floats(-300.0, 300.0),
)
@settings(max_examples=200, deadline=None)
def test_a_formation_that_is_only_translated_keeps_its_closest_pair(gap, other, begin, shift):
    """By symmetry its distances never change, so that rounding alone decides what is closest."""
    problem, along = Problem(), begin + np.array([0.0, gap, gap + other])
    found = least_separation(*translated(along, shift, problem), problem)
    least = min(gap, other)
    assert found.pair in ((0, 1), (1, 2))
    assert found.distance == pytest.approx(least, abs=1e-9)
    assert least - TOLERANCE <= found.bound <= least + 1e-9


def test_the_closest_pair_of_a_large_swarm_that_is_translated_is_named_even_in_one_place():
    problem, many = Problem(nodes=3), 30.0 * np.arange(140)
    for least, along in ((30.0, many), (0.0, np.append(many, many[[7, 7]]))):
        found = least_separation(*translated(along, 100.0 / 3, problem), problem)
        i, j = found.pair
        assert i < j
        assert abs(along[i] - along[j]) == least == pytest.approx(found.distance, abs=1e-9)


def test_no_number_is_no_distance_to_be_safe_by():
    problem = Problem()
    states, controls = translated(np.array([0.0, 10.0, 500.0]), 50.0, problem)
    states[2] = np.nan
    assert not least_separation(states, controls, problem).bound > 0


@pytest.mark.parametrize("orbits", [0.999, 3.3, 15.0])
def test_intervals_of_many_orbits_are_searched_in_little_memory(orbits):
    """Against the judge, who halves stretches until each is a twentieth of a radian."""
    motion = Problem().mean_motion
    problem = Problem(time_step=orbits * 2 * np.pi / motion, nodes=4)
    ends = draw("rings", 0, 4, 0, Problem())
    controls = minimum_energy(ends.initial, ends.goal, problem)
    states = fly(ends.initial, controls, problem)
    tracemalloc.start()
    found = least_separation(states, controls, problem)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 50e6
    case = Case(motion, problem.time_step, problem.nodes, problem.collision_radius)
    truth = closest_approaches(case, states, controls)
    assert found.bound <= truth.high.min() + 1e-6
    assert found.distance == pytest.approx(truth.high.min(), abs=1e-3)
    pair = int(truth.high.argmin())
    assert found.pair == (truth.first[pair], truth.second[pair])
