"""The closed loop: what an undisturbed swarm pays, what replanning mends, what it does in need."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
import trials
from judge import Case, closest_adrift

from pipeline.errors import InputError
from pipeline.expert import solve
from pipeline.flight.closed_loop import ClosedLoop
from pipeline.flight.errors import COLD_GAS, Errors, Loss, draws
from pipeline.flight.loops import MARGIN, TrialSettings, flight_loops
from pipeline.flight.trials import fly_trials, open_loop
from pipeline.flight.world import LinearWorld, conditions_of, world_of
from pipeline.networks.architecture import find
from pipeline.networks.encoding import Encoding
from pipeline.networks.model import Model
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import fly
from pipeline.plan.requirements import Requirements
from pipeline.planners.classical import Expert
from pipeline.planners.named import named_planner
from pipeline.planners.network import NetworkPlanner
from pipeline.scenario import Scenario, draw

TRIALS = 20


@pytest.fixture(scope="module")
def tight():
    """A transfer whose plan has a pair at the collision radius."""
    scenario = draw("rings", 0, 12, 2, Problem(), "test")
    plan = solve(scenario)
    assert plan.certificate.min_separation < 15.2
    return scenario, plan


def flown(scenario, guide, errors=COLD_GAS, trials=TRIALS):
    drawn = draws(0, range(trials), scenario.n, scenario.problem.intervals)
    return fly_trials(scenario, LinearWorld(scenario.problem.dynamics), guide, drawn, errors)


def closed(scenario, flies, planner=None, trials=TRIALS, errors=None, back_off=None):
    """Closed-loop guidance with a navigation filter, and without a loss of thrust."""
    nobody = Loss(np.full(trials, -1), np.full(trials, np.nan), np.full(trials, np.inf), 0)
    by = planner or Expert()
    return ClosedLoop(scenario, flies.controls, by, nobody, errors or Errors(), back_off)


@pytest.mark.parametrize("name", ["expert", "refiner", "minimum-energy"])
def test_an_undisturbed_swarm_pays_no_more_than_its_plan_and_meets_the_goal(tight, name):
    scenario, plan = tight
    guide = closed(scenario, plan, named_planner(name), trials=2)
    found = flown(scenario, guide, Errors(), trials=2)
    assert (found["delta_v"] <= plan.certificate.delta_v * (1 + 1e-9)).all()
    assert found["goal_error"].max() < 1e-6
    assert found["goal_velocity_error"].max() < 1e-9
    assert (found["min_separation"] > 15.0).all()
    assert not guide.unsafe.any()


def test_replanning_takes_most_of_the_error_at_the_goal_away(tight):
    scenario, plan = tight
    errors = replace(COLD_GAS, missed=0.0)
    as_planned = flown(scenario, open_loop(plan.controls), errors)
    guide = closed(scenario, plan)
    replanned = flown(scenario, guide, errors)
    assert replanned["goal_error"].max() < np.median(as_planned["goal_error"]) / 5
    assert np.isfinite(guide.seconds[:, 1:-2]).all()
    assert np.isnan(guide.seconds[:, [0, -2, -1]]).all()


def test_a_missed_burn_is_made_up_for(tight):
    """The burn that sets craft off is missed by all; without replanning none gets anywhere."""
    scenario, plan = tight

    def first_is_missed(guide):
        return lambda node, estimate: guide(node, estimate) * (node > 0)

    missed = flown(scenario, first_is_missed(open_loop(plan.controls)), Errors(), trials=1)
    guide = closed(scenario, plan, trials=1)
    mended = flown(scenario, first_is_missed(guide), Errors(), trials=1)
    assert missed["goal_error"] > 50
    assert mended["goal_error"] < 1e-6


def margin_of(plan, errors=COLD_GAS, sigmas=3.0):
    """The loop with margin of a plan."""
    *_, loop = flight_loops(plan, errors, Expert(), sigmas)
    assert (loop.name, loop.back_off.sigmas) == (MARGIN, sigmas)
    return loop


@pytest.fixture(scope="module")
def wider(tight):
    """The loop with margin of the tight plan, and its flights by estimates as they are."""
    scenario, plan = tight
    loop = margin_of(plan)
    guide = closed(scenario, loop, back_off=loop.back_off)
    return loop, flown(scenario, guide)


def test_a_margin_keeps_craft_apart_that_come_too_close_without(tight, wider):
    scenario, plan = tight
    _, wider = wider
    without = flown(scenario, closed(scenario, plan))
    assert (without["min_separation"] <= 15).mean() > 0.15
    assert (wider["min_separation"] <= 15).mean() < 0.05
    assert np.median(wider["min_separation"]) > 15.25
    assert wider["delta_v"].mean() < 1.03 * without["delta_v"].mean()


def test_filtered_estimates_cost_less_than_chasing_their_noise(tight, wider):
    """The same draws and the same margin; craft end as near their goals."""
    scenario, plan = tight
    loop, raw = wider
    guide = closed(scenario, loop, errors=COLD_GAS, back_off=loop.back_off)
    filtered = flown(scenario, guide)
    saved = (raw["delta_v"] - filtered["delta_v"]) / plan.certificate.delta_v
    assert saved.mean() > 0.005
    assert np.median(filtered["goal_error"]) < 1.05 * np.median(raw["goal_error"])
    assert filtered["min_separation"].min() > 15


def test_a_margin_that_not_all_pairs_can_have_is_kept_by_those_that_can():
    """Goals are as near as 15.82 m: craft that arrive side by side have no three deviations.

    Where a margin was kept by all or by none, craft came within 15 m in this flight.
    """
    scenario = draw("rings", 0, 30, 41, Problem(), "valid")
    plan = solve(scenario)
    loop = margin_of(plan)
    world = world_of(scenario, conditions_of(scenario))
    found = TrialSettings(scenario, world, COLD_GAS, seed=41).fly(loop, range(1))
    assert (found["min_separation"] > 15.1).all()
    assert (found["delta_v"] < 1.08 * plan.certificate.delta_v).all()


def test_with_a_margin_a_missed_burn_takes_nobody_too_near_before_it_can_be_made_up_for():
    """1.25 intervals adrift from any node; without missed burns nobody asks for that."""
    scenario = draw("rings", 0, 20, 3, Problem(), "valid")
    plan, problem = solve(scenario), scenario.problem
    case = Case(problem.mean_motion, problem.time_step, problem.nodes, problem.collision_radius)
    orbits = 1.25 * problem.time_step * problem.mean_motion / (2 * np.pi)
    least = {}
    for missed in (0.0, 1e-3):
        loop = margin_of(plan, replace(COLD_GAS, missed=missed))
        states = fly(scenario.initial, loop.controls, problem)
        least[missed] = closest_adrift(case, states, loop.controls, orbits).distance
        assert np.abs(loop.controls).sum() < 1.01 * plan.certificate.fuel
    assert least[0.0] < 12
    assert least[1e-3] > 15


def test_a_margin_is_not_had_at_any_price():
    """In this flight a margin for all pairs would turn the swarm round, for 9 times the Δv."""
    scenario = draw("rings", 0, 10, 19, Problem(), "test")
    plan = solve(scenario)
    loop = margin_of(plan)
    guide = closed(scenario, loop, trials=1, back_off=loop.back_off)
    drawn = draws(0, range(97, 98), scenario.n, scenario.problem.intervals)
    world = LinearWorld(scenario.problem.dynamics)
    found = fly_trials(scenario, world, guide, drawn, COLD_GAS)
    assert found["delta_v"][0] < 1.2 * plan.certificate.delta_v
    assert found["min_separation"][0] > 15


def test_the_first_plan_with_a_margin_keeps_each_pair_so_many_deviations_apart(tight):
    """By the deviations of trials that are corrected, which share no code with the plan."""
    scenario, plan = tight
    problem = scenario.problem
    loop = margin_of(plan, Errors(0.05, 5e-4, 0.02, 0.02))
    states = fly(scenario.initial, loop.controls, problem)
    case = Case(problem.mean_motion, problem.time_step, problem.nodes, problem.collision_radius)
    errors = trials.Errors(0.05, 5e-4, 0.02)
    nodes, _, made = trials.corrected(case, states, loop.controls, errors, 1000, 0)
    planned = trials.positions(case, states, loop.controls)
    flown = trials.positions(case, nodes.reshape(-1, 11, 6), made.reshape(-1, 10, 3))
    flown, inside = flown.reshape(1000, scenario.n, -1, 3), slice(trials.PIECES, -trials.PIECES)
    nearest = np.inf
    for i, j in combinations(range(scenario.n), 2):
        gap = (planned[i] - planned[j])[inside]
        apart = np.linalg.norm(gap, axis=1)
        moved = (flown[:, i] - flown[:, j])[:, inside]
        sigma = np.einsum("ktc,tc->kt", moved - gap, gap / apart[:, None]).std(axis=0)
        nearest = min(nearest, ((apart - 15) / sigma).min())
    assert nearest == pytest.approx(3.0, abs=0.3)


def test_no_more_margin_is_kept_than_formations_allow(tight):
    """Where a pair is at r_col itself at an end, nothing is asked of it there."""
    scenario, _ = tight
    nearest = min(
        np.linalg.norm(end[i, :3] - end[j, :3])
        for end in (scenario.initial, scenario.goal)
        for i in range(12)
        for j in range(i)
    )
    problem = replace(scenario.problem, collision_radius=float(nearest) - 1e-3)
    plan = solve(replace(scenario, problem=problem))
    loop = margin_of(plan)
    assert not np.array_equal(loop.controls, plan.controls)
    assert np.abs(loop.controls).sum() < 1.5 * plan.certificate.fuel
    without = margin_of(plan, Errors())
    assert np.abs(without.controls).sum() == pytest.approx(plan.certificate.fuel, rel=1e-3)


def test_where_craft_are_too_close_already_the_least_unsafe_plan_flies_and_is_counted():
    """Two craft 10 m apart that must part: none can be safe, and none may come nearer."""
    problem = Problem()
    initial = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0, 10.0, 0.0, 0.0, 0.0, 0.0]])
    goal = np.array([[0.0, 150.0, 0.0, 0.0, 0.0, 0.0], [0.0, -150.0, 0.0, 0.0, 0.0, 0.0]])
    scenario = Scenario(problem, initial, goal)
    own = named_planner("decoupled-optimum").plan([scenario])[0]
    guide = closed(scenario, own, trials=3)
    flown(scenario, guide, Errors(), trials=3)  # the first interval is as planned, to 2 m or so
    assert (guide.unsafe >= 1).all()
    assert (guide.unsafe < problem.intervals).all()  # they do part

    crossing = flown(scenario, open_loop(own.controls), Errors(), trials=1)["min_separation"]
    replanned = flown(scenario, closed(scenario, own, trials=1), Errors(), trials=1)
    assert replanned["goal_error"] < 1e-6
    assert replanned["min_separation"] >= crossing


def test_controls_keep_to_the_thrust_limit(tight):
    scenario, plan = tight
    limit = 1.05 * float(np.abs(plan.controls).max())
    bounded = replace(scenario, problem=replace(scenario.problem, max_acceleration=limit))
    guide = closed(bounded, plan)
    most = []

    def watched(node, estimate):
        controls = guide(node, estimate)
        most.append(np.abs(controls).max())
        return controls

    flown(bounded, watched, replace(COLD_GAS, magnitude=0.2, missed=0.05))
    assert max(most) <= limit * (1 + 1e-9)
    assert guide.unsafe.any()  # so much goes wrong that the goal is not always within reach


def flown_undisturbed(scenario, plan, requirements):
    """The controls that are flown, (n, intervals, 3), and the Δv."""
    guide, commanded = closed(scenario, plan, Expert(requirements=requirements), trials=1), []

    def noted(node, estimate):
        commanded.append(guide(node, estimate))
        return commanded[-1]

    found = flown(scenario, noted, Errors(), trials=1)
    assert not guide.unsafe.any()
    return np.stack([one[0] for one in commanded], axis=1), found["delta_v"][0]


def test_craft_that_are_planned_anew_stay_passively_safe_where_the_planner_must():
    """Planned anew for r_col alone a cheaper plan is found, in which they are not."""
    problem, asked = Problem(), Requirements(passive_safety=0.5)
    case = Case(problem.mean_motion, problem.time_step, problem.nodes, problem.collision_radius)
    scenario = draw("coplanar-split", 0, 5, 3, problem, "valid")
    plan = solve(scenario, requirements=asked)
    least = {}
    for requirements in (asked, Requirements()):
        controls, used = flown_undisturbed(scenario, plan, requirements)
        states = fly(scenario.initial, controls, problem)
        least[requirements] = closest_adrift(case, states, controls, 0.5).distance, used
    assert least[asked][0] > 15 > least[Requirements()][0]
    assert plan.certificate.delta_v >= least[asked][1] > least[Requirements()][1]


def test_craft_that_need_be_apart_at_the_nodes_only_are_planned_anew_for_these(tight):
    scenario, _ = tight
    asked = Requirements("nodes")
    plan = solve(scenario, requirements=asked)
    assert plan.certificate.min_separation < 15
    controls, used = flown_undisturbed(scenario, plan, asked)
    states = fly(scenario.initial, controls, scenario.problem)[:, 1:, :3]
    i, j = np.triu_indices(12, 1)
    assert np.linalg.norm(states[i] - states[j], axis=-1).min() > 15
    assert used <= plan.certificate.delta_v * (1 + 1e-9)


def test_a_network_for_one_time_grid_alone_says_so():
    scenario, found = draw("rings", 0, 3, 0, Problem(), "test"), find("ff1")
    plan = solve(scenario)
    scale = (100.0, 200.0, 50.0, 0.1, 0.2, 0.05)
    encoding = Encoding(scenario.problem, 3, "line", "states", scale, scale)
    network = found.network(found.config, encoding, 0.0)
    model = Model("ff1", found.config, "t", encoding, network)
    with pytest.raises(InputError, match="nodes"):
        flown(scenario, closed(scenario, plan, NetworkPlanner(model, "ff1"), trials=1), trials=1)


def test_where_passive_safety_cannot_be_kept_separation_in_flight_is():
    """In one plane, what linear motion leaves out is enough for no plan to be passively safe."""
    scenario = draw("coplanar-split", 0, 10, 1, Problem(), "valid")
    asked = Requirements(passive_safety=0.5)
    plan = solve(scenario, requirements=asked)
    _, loop, _ = flight_loops(plan, Errors(), Expert(requirements=asked))
    world = world_of(scenario, conditions_of(scenario))
    found = TrialSettings(scenario, world, Errors()).fly(loop, range(1))
    assert found["unsafe_replans"][0] > 0
    assert found["min_separation"][0] > 15
