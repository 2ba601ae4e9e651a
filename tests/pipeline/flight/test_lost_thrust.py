"""Craft that lose their thrust in flight, held against motion by matrix exponentials."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from judge.motion import after, exact_steps

from pipeline.errors import InputError
from pipeline.expert import solve
from pipeline.flight.closed_loop import ClosedLoop
from pipeline.flight.errors import COLD_GAS, Errors, Loss, draws, lost_thrust
from pipeline.flight.loops import FEEDBACK, REPLANNED, TrialSettings, flight_loops
from pipeline.flight.trials import feedback, fly_trials, open_loop
from pipeline.flight.world import LinearWorld
from pipeline.orbit.participants import Obstacle
from pipeline.orbit.problem import Problem
from pipeline.plan.requirements import AT_ALL_TIMES, Requirements
from pipeline.planners.classical import Expert
from pipeline.planners.named import NAMES, named_planner
from pipeline.planners.planner import requiring
from pipeline.scenario import Scenario, draw

LOST = Errors(lost=1.0)
TRIALS = 30
LOOKS = 240
"""At each interval."""


@pytest.fixture(scope="module")
def tight():
    """A transfer whose plan has pairs at the collision radius, and drifts that lead closer."""
    scenario = draw("rings", 0, 10, 8, Problem(), "test")
    return scenario, solve(scenario)


def flown(scenario, guide, errors=LOST, trials=TRIALS):
    """Trials, and what was commanded in each of them, (K, n, intervals, 3)."""
    told = []

    def listening(node, estimate):
        told.append(np.array(guide(node, estimate)))
        return told[-1]

    drawn = draws(0, range(trials), scenario.n, scenario.problem.intervals)
    world = LinearWorld(scenario.problem.dynamics)
    found = fly_trials(scenario, world, listening, drawn, errors)
    return found, np.stack(told, axis=2)


def by_exponentials(scenario, controls, craft, time):
    """States (n, looks, 6) under controls that one craft's thrust stops following at a time."""
    problem = scenario.problem
    rate, step = problem.mean_motion, problem.time_step / LOOKS
    looks = step * np.arange(1, LOOKS + 1)
    free, forced = exact_steps(rate, looks)
    states = [scenario.initial[:, None]]
    for k, held in enumerate(controls.swapaxes(0, 1)):
        start = states[-1][:, -1]
        flown = np.einsum("lij,nj->nli", free, start) + np.einsum("lij,nj->nli", forced, held)
        left = time - k * problem.time_step
        if left < problem.time_step:
            flown[craft] = adrift(rate, looks, max(left, 0.0), start[craft], held[craft])
        states.append(flown)
    return np.concatenate(states, axis=1)


def adrift(rate, looks, burning, start, held):
    """States of a craft that burns for some of the time, at each of some times."""
    ended, found = after(rate, burning, start, held), []
    for time in looks:
        rest = time - burning
        found.append(
            after(rate, time, start, held) if rest < 0 else after(rate, rest, ended, 0 * held)
        )
    return found


def least(states):
    gaps = [(a - b)[:, :3] for a, b in combinations(states, 2)]
    return float(np.sqrt(min(np.vecdot(gap, gap).min() for gap in gaps)))


def burnt(scenario, controls, craft, time):
    """Σ‖u‖₁Δt of what was burnt."""
    h = scenario.problem.time_step
    lasted = np.full(controls.shape[:2], h)
    lasted[craft] = np.clip(time - h * np.arange(controls.shape[1]), 0.0, h)
    return float((np.abs(controls).sum(axis=2) * lasted).sum())


def test_a_craft_drifts_from_the_moment_of_its_loss_and_all_others_fly_on(tight):
    scenario, plan = tight
    found, _ = flown(scenario, open_loop(plan.controls))
    with_lost = 0
    for k in range(TRIALS):
        lost, time = int(found["lost_craft"][k]), float(found["lost_time"][k])
        states = by_exponentials(scenario, plan.controls, lost, time)
        apart = least(states)
        assert apart - 0.01 <= found["min_separation"][k] <= apart + 1e-6
        pair = found["first_craft"][k], found["second_craft"][k]
        with_lost += lost in pair
        assert found["delta_v"][k] == pytest.approx(burnt(scenario, plan.controls, lost, time))
        assert np.linalg.norm(states[lost, -1, :3] - scenario.goal[lost, :3]) > 1e-3
    assert with_lost > 3
    assert found["goal_error"].max() < 1e-6  # that of others
    assert not found["missed_burns"].any()
    h = scenario.problem.time_step
    assert (np.mod(found["lost_time"], h) > 1).mean() > 0.9  # in the middle of intervals


def test_feedback_keeps_the_others_on_their_plan(tight):
    scenario, plan = tight
    as_planned, _ = flown(scenario, open_loop(plan.controls))
    guide = feedback(plan.controls, plan.states, scenario.problem)
    corrected, _ = flown(scenario, guide)
    for name in ("min_separation", "delta_v"):
        assert corrected[name] == pytest.approx(as_planned[name], abs=1e-6)
    assert corrected["goal_error"].max() < 1e-6


def test_replanned_the_others_go_round_the_one_adrift_and_to_their_goals(tight):
    scenario, plan = tight
    trials, h, kept = 300, scenario.problem.time_step, scenario.problem.collision_radius - 1e-3
    drawn = draws(0, range(trials), scenario.n, scenario.problem.intervals)
    loss = lost_thrust(drawn, LOST, scenario.problem)
    guide = ClosedLoop(scenario, plan.controls, Expert(), loss, Errors())
    found, controls = flown(scenario, guide, trials=trials)
    as_planned, _ = flown(scenario, open_loop(plan.controls), trials=trials)
    close = np.flatnonzero(as_planned["min_separation"] < kept)
    assert len(close) > 10
    for k in close.tolist():
        lost, time, known = int(loss.craft[k]), float(loss.time[k]), int(np.ceil(loss.time[k] / h))
        apart = least(by_exponentials(scenario, controls[k], lost, time))
        assert apart - 0.01 <= found["min_separation"][k] <= apart + 1e-6
        # Or too close before the others could know of it
        assert found["min_separation"][k] > kept or found["min_separation_time"][k] <= known * h
        assert not controls[k, lost, known:].any()
    assert (found["min_separation"] > kept).mean() > 0.99
    assert found["goal_error"].max() < 1e-6


def in_the_way(**asked):
    """Two craft, one of which must get past the other, adrift below its way and then its goal."""
    problem = Problem()
    drift = [10.0, 0.0, 0.0, 0.0, -1.5 * problem.mean_motion * 10.0, 0.0]
    initial = np.array([drift, [0.0, 60.0, 0.0, 0.0, 0.0, 0.0]])
    goal = np.array([[0.0, 300.0, 0.0, 0.0, 0.0, 0.0], [0.0, -60.0, 0.0, 0.0, 0.0, 0.0]])
    scenario = Scenario(problem, initial, goal)
    h, idle = problem.time_step, np.zeros((2, problem.intervals, 3))
    planner = Expert(requirements=Requirements(**asked))

    def guide(latency=0):
        loss = Loss(np.array([0]), np.array([0.5 * h]), np.array([1.0]), latency)
        return ClosedLoop(scenario, idle, planner, loss, Errors())

    return scenario, guide


@pytest.mark.parametrize("asked", [{}, {"passive_safety": 1.0}])
def test_the_drift_that_leads_to_a_goal_later_is_passed_as_well(asked):
    """Where passive safety stays asked for, it cannot be had, and none finds a way past."""
    scenario, guidance = in_the_way(**asked)
    guide, problem = guidance(), scenario.problem
    states, controls = scenario.initial, []
    for node in range(problem.intervals):
        held = guide(node, states[None])[0]
        controls.append(held)
        states = after(problem.mean_motion, problem.time_step, states, held)
    path = by_exponentials(scenario, np.stack(controls, axis=1), 0, 0.0)
    assert least(path) > problem.collision_radius
    assert np.abs(path[1, -1] - scenario.goal[1]).max() < 1e-6
    assert guide.unsafe.tolist() == [0]


@pytest.mark.parametrize("latency", [0, 1])
def test_guidance_learns_of_a_loss_as_late_as_of_states(latency):
    scenario, guidance = in_the_way()
    guide = guidance(latency)
    told = [guide(node, scenario.initial[None])[0, 0] for node in range(4)]
    assert [one.any() for one in told] == [False, bool(latency), False, False]


def test_a_loss_changes_no_other_draw_and_none_is_none(tight):
    scenario, plan = tight
    guide = open_loop(plan.controls)
    some, _ = flown(scenario, guide, replace(COLD_GAS, lost=0.3))
    none, _ = flown(scenario, guide, COLD_GAS)
    intact = some["lost_craft"] < 0
    assert 5 < intact.sum() < TRIALS - 2
    assert (none["lost_craft"] == -1).all()
    assert np.isnan(none["lost_time"]).all()
    for name in ("min_separation", "goal_error", "delta_v"):
        np.testing.assert_array_equal(some[name][intact], none[name][intact])
    assert (some["delta_v"][~intact] < none["delta_v"][~intact]).all()


def test_every_loop_of_a_plan_is_flown_with_losses(tight):
    scenario, plan = tight
    loops = [
        *flight_loops(plan, LOST, with_feedback=True),
        *flight_loops(plan, LOST, Expert()),
    ]
    assert {FEEDBACK, REPLANNED} < {loop.name for loop in loops}
    of = TrialSettings(scenario, LinearWorld(scenario.problem.dynamics), LOST)
    found = [of.fly(loop, range(4)) for loop in loops]
    for one in found[1:]:
        np.testing.assert_array_equal(one["lost_time"], found[0]["lost_time"])


def test_a_craft_alone_is_not_lost():
    scenario = draw("rings", 0, 1, 0, Problem(), "test")
    with pytest.raises(InputError, match="lost is 1 and there is one craft; expected 0"):
        list(flight_loops(solve(scenario), LOST))


@pytest.mark.parametrize("name", NAMES)
def test_a_planner_is_asked_for_something_else(name):
    strict = named_planner(name, Requirements(passive_safety=1.0))
    found = requiring(strict, AT_ALL_TIMES)
    assert type(found) is type(strict)
    assert (found.name, found.requirements) == (strict.name, AT_ALL_TIMES)


def test_a_loss_among_obstacles_is_refused():
    there = Obstacle("debris", (500.0, 0.0, 0.0, 0.0, 0.0, 0.0), radius=5.0)
    scenario = replace(draw("rings", 0, 3, 0, Problem(), "test"), obstacles=(there,))
    with pytest.raises(InputError, match="past which no drift of a lost craft is flown"):
        list(flight_loops(solve(scenario), Errors(lost=1.0)))
