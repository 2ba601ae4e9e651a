"""Closest approaches after a loss of thrust, held against matrix exponentials on a dense grid."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from judge import Case, closest_adrift
from judge.motion import exact_step

from pipeline.errors import InputError
from pipeline.orbit.drift_search import DriftingPaths
from pipeline.orbit.partition import swarm_partition
from pipeline.orbit.passive_safety import (
    Ends,
    least_after_loss,
    loss_encounters,
    unavoidable_encounter,
)
from pipeline.orbit.problem import Problem
from pipeline.orbit.rings import pro_states
from pipeline.orbit.transfer import fly, minimum_energy
from pipeline.plan.requirements import Requirements

PERIOD = 2 * np.pi / Problem().mean_motion


def case_of(problem):
    return Case(problem.mean_motion, problem.time_step, problem.nodes, problem.collision_radius)


def transfer(seed, n, problem):
    """The transfers of least energy between random ends, some of which come very close."""
    rng = np.random.default_rng(seed)
    initial, goal = rng.normal(size=(2, n, 6)) * np.repeat([80.0, 0.08], 3)
    controls = minimum_energy(initial, goal, problem)
    return fly(initial, controls, problem), controls


def least(states, controls, problem, orbits):
    (found,) = least_after_loss(states, controls, problem, orbits, swarm_partition((len(states),)))
    return found


@given(
    seed=st.integers(0, 10**6),
    orbits=st.sampled_from([0.004, 0.05, 0.3, 1.0]),
    step=st.sampled_from([10.0, 50.0, 120.0, 700.0]),
)
@settings(max_examples=12)
def test_the_least_separation_is_the_judge_s(seed, orbits, step):
    """Drifts shorter than a step, that end in flight, and that go on long after the plan."""
    problem = Problem(time_step=step, nodes=5)
    states, controls = transfer(seed, 3, problem)
    found = least(states, controls, problem, orbits)
    truth = closest_adrift(case_of(problem), states, controls, orbits)
    assert found.distance == pytest.approx(truth.distance, abs=2e-4)
    assert found.bound <= truth.distance + 1e-6
    assert found.bound >= found.distance - 1e-4
    assert 0 <= found.time - found.node * step <= orbits * PERIOD * (1 + 1e-9)


@pytest.mark.parametrize("seconds", [5e-4, 480.0 + 5e-4, 600.0 + 5e-4])
def test_a_drift_that_ends_shortly_after_a_node_is_looked_at_like_any_other(seconds):
    """By less than the shortest time step that a problem may have."""
    problem = Problem(time_step=120.0, nodes=5)
    states, controls = transfer(1, 3, problem)
    found = least(states, controls, problem, seconds / PERIOD)
    truth = closest_adrift(case_of(problem), states, controls, seconds / PERIOD)
    assert found.distance == pytest.approx(truth.distance, abs=2e-4)
    assert found.bound <= truth.distance + 1e-6
    assert (
        unavoidable_encounter(Ends(states[:, 0], states[:, -1], problem, seconds / PERIOD)) is None
    )


def test_a_meeting_after_seventy_orbits_is_found():
    """A craft that is slower by v gains 3 v in the mean and stays at its height but for 4 v/e."""
    problem, ahead, met = Problem(), 200.0, 74 * PERIOD
    v = (ahead - problem.collision_radius) / (3 * met)
    behind = [0.0, -ahead, 0.0, 0.0, -v, 0.0]
    goal = np.array([np.zeros(6), behind])
    found = unavoidable_encounter(Ends(goal, goal, problem, 100.0))
    assert found.pair in ((0, 1), (1, 0))
    assert found.distance < problem.collision_radius
    assert unavoidable_encounter(Ends(goal, goal, problem, 73.0)) is None
    assert (
        unavoidable_encounter(Ends(goal, goal, problem, 75.0)).distance < problem.collision_radius
    )


def test_everything_within_a_distance_is_found_and_nothing_else():
    """Beside a dense grid that is 2 s fine; relative speeds are below 1 m/s."""
    problem, orbits = Problem(nodes=4), 0.2
    states, controls = transfer(7, 5, problem)
    within = 120.0
    swarms = swarm_partition((len(states),))
    found = loss_encounters(DriftingPaths(states, controls, problem, orbits, swarms), within)
    assert len(found.first) > 20
    assert (found.bound <= within).all()
    assert (np.abs(found.distance - found.bound) < 1e-4).all()
    told = set(zip(found.first.tolist(), found.node.tolist(), found.second.tolist(), strict=True))
    for node in range(problem.nodes):
        since = np.append(np.arange(0.0, orbits * PERIOD, 2.0), orbits * PERIOD)
        A, _ = problem.dynamics.step(since)
        adrift = np.einsum("tij,nj->nti", A[:, :3], states[:, node])
        flown = np.stack([position(states, controls, problem, node, t) for t in since], axis=1)
        apart = np.linalg.norm(adrift[:, None] - flown[None], axis=-1).min(axis=-1)
        for i, j in np.argwhere(~np.eye(5, dtype=bool)).tolist():
            if (i, node, j) in told:
                assert apart[i, j] < within + 1.0
            else:
                assert apart[i, j] > within


def position(states, controls, problem, node, since):
    time = node * problem.time_step + since
    k = min(int(time // problem.time_step), problem.nodes - 1)
    A, B = problem.dynamics.step(time - k * problem.time_step)
    held = controls[:, k] if k < problem.nodes - 1 else np.zeros((len(states), 3))
    return states[:, k] @ A[:3].T + held @ B[:3].T


EDGES = [0.02, 0.5, 0.98]
"""Shares of an interval at which craft meet: near its start, in the middle, near its end."""


def meetings(flown, problem, orbits):
    """Of swarms of two that fly so: where the first, adrift, comes within 1 mm of the second."""
    starts, controls = (np.concatenate(each) for each in zip(*flown, strict=True))
    states, swarms = fly(starts, controls, problem), swarm_partition((2,) * len(flown))
    found = loss_encounters(DriftingPaths(states, controls, problem, orbits, swarms), 1e-3)
    where = np.stack([found.first, found.node, found.interval], axis=1)[found.first % 2 == 0]
    return {(lost // 2, node, interval) for lost, node, interval in where.tolist()}


@pytest.mark.parametrize("step", [20.0, 120.0])
def test_one_that_turns_back_where_a_craft_is_adrift_is_found(step):
    """As far from its chord as its thrust takes it; the one adrift stays at the origin."""
    problem = Problem(time_step=step, nodes=12)
    e, last, flown, met = problem.mean_motion, problem.intervals, [], set()
    for k in range(last):
        controls, ends = np.zeros((2, last, 3)), np.zeros((2, 6))
        controls[1, k] = 0.1 * np.eye(3)[k % 3]
        _, pushed = exact_step(e, -step / 2)
        drifted, _ = exact_step(e, -k * step)
        ends[1] = drifted @ pushed @ controls[1, k]
        met |= {(len(flown), node, k) for node in range(k + 1)}
        flown.append((ends, controls))
    assert meetings(flown, problem, 0.3) >= met


@pytest.mark.parametrize("moment", EDGES)
@pytest.mark.parametrize("step", [20.0, 120.0])
def test_one_adrift_that_turns_about_another_is_found(step, moment):
    """Past the origin at 50 m/s; Coriolis acceleration, 0.1 m/s², bends its path off the chord."""
    problem, orbits = Problem(time_step=step, nodes=6), 0.1
    e, last, flown, met = problem.mean_motion, problem.intervals, [], set()
    for k in range(last, last + int(orbits * PERIOD / step)):
        ends = np.zeros((2, 6))
        ends[0] = exact_step(e, -(k + moment) * step)[0] @ [0.0, 0.0, 0.0, 0.0, 50.0, 0.0]
        met |= {
            (len(flown), node, k)
            for node in range(problem.nodes)
            if (k + moment) * step < node * step + orbits * PERIOD
        }
        flown.append((ends, np.zeros((2, last, 3))))
    assert meetings(flown, problem, orbits) >= met


@pytest.mark.parametrize("step", [20.0, 120.0])
def test_one_adrift_that_turns_back_where_another_hovers_is_found(step):
    """At a height of 5 km gravity and rotation leave 0.02 m/s², against which the other thrusts."""
    problem = Problem(time_step=step, nodes=14)
    e, last, flown, met = problem.mean_motion, problem.intervals, [], set()
    there, held = np.array([5e3, 0.0, 0.0, 0.0, 0.0, 0.0]), [-3 * e**2 * 5e3, 0.0, 0.0]
    for k in range(last):
        ends = np.stack([exact_step(e, -(k + 0.5) * step)[0] @ there, there])
        met |= {(len(flown), node, k) for node in range(k + 1)}
        flown.append((ends, np.stack([np.zeros((last, 3)), np.tile(held, (last, 1))])))
    assert meetings(flown, problem, 0.3) >= met


def test_swarms_side_by_side_know_nothing_of_each_other():
    problem = Problem()
    parts = [transfer(seed, n, problem) for seed, n in ((1, 3), (2, 1), (3, 4))]
    states, controls = (np.concatenate(both) for both in zip(*parts, strict=True))
    together = least_after_loss(states, controls, problem, 0.5, swarm_partition((3, 1, 4)))
    assert together == [least(*part, problem, 0.5) for part in parts]
    assert together[1].pair is None


@pytest.mark.parametrize("problem", [Problem(), Problem(time_step=20.0, nodes=31)])
def test_what_moved_craft_have_no_say_in_is_left_out(problem):
    """A craft adrift has its say before the loss, another until it is at its goal."""
    states, controls = transfer(3, 4, problem)
    moved = np.array([True, False, False, False])
    paths = DriftingPaths(states, controls, problem, 1.0, swarm_partition((4,)))
    every = loss_encounters(paths, 150.0)
    found = loss_encounters(paths, 150.0, moved)
    last = problem.nodes - 1
    says = moved[every.first] & (every.node > 0) & (every.node < last)
    says |= moved[every.second] & (every.interval < last)
    assert 0 < says.sum() < len(says)
    for name in ("first", "node", "second", "interval", "bound"):
        kept = np.sort(getattr(every, name)[says])
        assert (kept == np.sort(getattr(found, name))).all()


def still(*offsets):
    """Craft at rest along the orbit."""
    where = np.array(offsets)
    e = Problem().mean_motion
    return pro_states(1e-9, 0.0, np.zeros(len(where)), 0.0, e, where)


def test_a_craft_that_stays_where_another_is_to_go_is_in_its_way_whatever_is_planned():
    problem = Problem()
    found = unavoidable_encounter(Ends(still(0.0, 100.0), still(200.0, 10.0), problem, 1.0))
    assert found.pair == (0, 1)
    assert found.node == 0
    assert found.distance == pytest.approx(10.0, abs=1e-6)
    assert problem.duration - 1e-6 <= found.time <= PERIOD
    # not before the plan ends, and not where the two are their own
    assert unavoidable_encounter(Ends(still(0.0, 100.0), still(200.0, 10.0), problem, 0.2)) is None
    assert unavoidable_encounter(Ends(still(0.0, 100.0), still(5.0, 90.0), problem, 1.0)) is None


def test_goals_that_drift_into_each_other_are_in_the_way_whatever_is_planned():
    """Two rings of one size with centres 10 m apart: they stay that far apart."""
    e = Problem().mean_motion
    goal = pro_states(100.0, 0.0, np.zeros(2), 0.0, e, np.array([0.0, 10.0]))
    found = unavoidable_encounter(Ends(still(-400.0, 400.0), goal, Problem(), 0.01))
    assert (found.pair, found.node) == ((0, 1), Problem().nodes - 1)
    assert found.distance == pytest.approx(10.0, abs=1e-4)


@pytest.mark.parametrize("orbits", [0.0, -1.0, float("nan"), float("inf"), 101.0])
def test_what_is_no_length_of_a_drift_is_refused(orbits):
    with pytest.raises(InputError, match="expected a number above 0 and at most 100"):
        Requirements(passive_safety=orbits)
    assert Requirements(passive_safety=100.0).passive_safety == 100.0


@given(gap=st.floats(1.0, 200.0), begin=st.floats(-500.0, 500.0))
@settings(max_examples=60, deadline=None)
def test_craft_at_rest_have_a_least_separation_adrift(gap, begin):
    """They stay where they are, so that rounding alone decides when they are closest."""
    problem = Problem(nodes=4)
    states = np.repeat(still(begin, begin + gap)[:, None], 4, axis=1)
    found = least(states, np.zeros((2, 3, 3)), problem, 0.3)
    assert set(found.pair) == {0, 1}
    assert found.distance == pytest.approx(gap, abs=1e-6)
    assert gap - 2e-4 <= found.bound <= gap + 1e-6
    assert 0 <= found.time - found.node * problem.time_step <= 0.3 * PERIOD
