"""Plans that stand a loss of thrust, judged by matrix exponentials on a dense grid."""

from dataclasses import replace

import numpy as np
import pytest
from judge import Case, closest_adrift
from judge.adrift import distance_adrift

from pipeline.errors import InputError
from pipeline.expert import Settings, solve, solve_many
from pipeline.expert.cuts import gaps, half_spaces, passive_safety_cuts
from pipeline.expert.decoupled import decoupled_optima
from pipeline.orbit.drift_search import DriftingPaths
from pipeline.orbit.partition import swarm_partition
from pipeline.orbit.passive_safety import loss_encounters
from pipeline.orbit.problem import Problem
from pipeline.orbit.rings import pro_states
from pipeline.orbit.transfer import fly, meet_goal
from pipeline.plan.judge import Draft, certified_plan
from pipeline.plan.plan import INFEASIBLE, SOLVED, UNSAFE, UNSOLVED
from pipeline.plan.requirements import Requirements
from pipeline.planners.classical import BASELINES
from pipeline.planners.named import named_planner
from pipeline.scenario import FAMILIES, Scenario, draw

PROBLEM = Problem()
CASE = Case(PROBLEM.mean_motion, PROBLEM.time_step, PROBLEM.nodes, PROBLEM.collision_radius)


def still(*offsets):
    """Craft at rest along the orbit."""
    where = np.array(offsets)
    return pro_states(1e-9, 0.0, np.zeros(len(where)), 0.0, PROBLEM.mean_motion, where)


def adrift(plan, orbits=1.0):
    return closest_adrift(CASE, plan.states, plan.controls, orbits)


@pytest.mark.parametrize("family", FAMILIES)
def test_plans_stand_a_loss_of_thrust_where_it_is_asked(family):
    """The first scenarios of each family that the two ends alone do not forbid."""
    stood, n = 0, 3 if family == "dense" else 6
    for index in range(40):
        scenario = draw(family, 1, n, index, PROBLEM)
        plan = solve(scenario, requirements=Requirements(passive_safety=1.0))
        if plan.status == INFEASIBLE:
            continue
        assert plan.status == SOLVED
        found, said = adrift(plan), plan.certificate.passive_safety
        assert found.distance > PROBLEM.collision_radius
        assert said.min_separation == pytest.approx(found.distance, abs=2e-4)
        assert said.min_separation_bound <= found.distance + 1e-6
        stood += 1
        if stood == 2:
            break
    assert stood == 2


def test_plans_that_are_not_asked_for_it_are_told_as_the_judge_finds_them():
    """Certified alike, with what is asked left out of the search: some stand a loss, others not."""
    told = []
    for family, index in (("rings", 2), ("rings", 0), ("tilt-split", 1), ("coplanar-split", 0)):
        scenario = draw(family, 1, 6, index, PROBLEM)
        plan = solve(scenario)
        assert plan.status == SOLVED and plan.certificate.passive_safety is None
        made = Draft(plan.controls, plan.certificate.fuel_lower_bound)
        again = certified_plan("expert", scenario, made, Requirements(passive_safety=1.0))
        stands = adrift(plan).distance > PROBLEM.collision_radius
        assert again.status == (SOLVED if stands else UNSAFE)
        told.append(stands)
    assert set(told) == {True, False}


TWO_ORBITS = Requirements(passive_safety=2.0)


def test_a_search_that_is_stuck_ends_long_before_its_rounds_do():
    """It says which craft is the cause; of its 30 rounds most would leave the same slack."""
    scenarios = [draw("dense", 0, 7, k, PROBLEM, "valid") for k in (87, 37)]
    once = Settings(passive_safety_starts=0)
    stuck, other = solve_many(scenarios, settings=once, requirements=TWO_ORBITS)
    assert other.status == SOLVED and other.convex_solves > stuck.convex_solves
    assert stuck.status == UNSOLVED and stuck.convex_solves < 15
    assert "the last program could not keep craft" in stuck.message


def test_further_starts_find_a_way_past_craft_adrift():
    """The search from the decoupled optima finds no plan; one from shifted cuts does."""
    scenario = draw("dense", 0, 10, 4, PROBLEM, "train")
    plan = solve(scenario, settings=Settings(passive_safety_starts=1), requirements=TWO_ORBITS)
    assert plan.status == SOLVED
    assert adrift(plan, 2.0).distance > PROBLEM.collision_radius


QUICK = Problem(time_step=10.0, nodes=7)
"""A minute's transfer: over two minutes craft fly nearly straight on."""

BRAKES = Scenario(QUICK, still(-90.0, 0.0), still(-40.0, 0.0))
"""Craft 0 goes 50 m in a minute, at 1 m/s in between, and stops 40 m before craft 1."""


def test_a_craft_that_must_brake_before_another_does_not_aim_at_it():
    """At 1 m/s it would be with the other 40 s after it should have stopped."""
    case, orbits = replace(CASE, step=10.0, nodes=7), 0.02
    plain = solve(BRAKES)
    assert plain.status == SOLVED
    hit = closest_adrift(case, plain.states, plain.controls, orbits)
    assert (hit.lost, hit.other) == (0, 1)
    assert hit.distance < PROBLEM.collision_radius
    assert hit.time == pytest.approx(95.0, abs=5.0)
    plan = solve(BRAKES, requirements=Requirements(passive_safety=orbits))
    assert plan.status == SOLVED
    missed = closest_adrift(case, plan.states, plan.controls, orbits)
    assert missed.distance > PROBLEM.collision_radius
    assert plan.certificate.fuel > plain.certificate.fuel * 1.1


def test_a_loss_that_must_hit_is_infeasible_and_named():
    """Craft 1 is to go where craft 0 stays if it never gets any thrust."""
    scenario = Scenario(PROBLEM, still(0.0, 100.0), still(200.0, 10.0))
    assert solve(scenario).status == SOLVED
    plan = solve(scenario, requirements=Requirements(passive_safety=1.0))
    assert plan.status == INFEASIBLE
    assert "craft 0, adrift from its start, comes within 10 m of craft 1" in plan.message
    assert "whatever is planned" in plan.message
    short = solve(scenario, requirements=Requirements(passive_safety=0.2))
    assert short.status == SOLVED, "the drift ends before craft 1 arrives"
    assert adrift(short, 0.2).distance > PROBLEM.collision_radius


def test_other_planners_are_judged_by_it():
    own = next(one for one in BASELINES if one.name == "decoupled optimum")
    assert own.plan([BRAKES])[0].status == SOLVED
    (plan,) = replace(own, requirements=Requirements(passive_safety=0.02)).plan([BRAKES])
    assert plan.status == UNSAFE
    assert "craft 0, adrift from node" in plan.message
    said, case = plan.certificate.passive_safety, replace(CASE, step=10.0, nodes=7)
    assert said.pair == (0, 1)
    apart = distance_adrift(case, plan.states, plan.controls, said.pair, said.node, said.time)
    assert apart == pytest.approx(said.min_separation, abs=1e-6)


def test_scenarios_side_by_side_have_the_plans_they_have_alone():
    asked = Requirements(passive_safety=0.5)
    scenarios = [draw("rings", 2, 6, k, PROBLEM) for k in range(5)]
    together = solve_many(scenarios, requirements=asked)
    for scenario, plan in zip(scenarios, together, strict=True):
        alone = solve(scenario, requirements=asked)
        assert alone.status == plan.status
        assert (alone.controls == plan.controls).all()


def test_a_row_is_what_controls_do_to_the_gap_along_the_normal():
    """Any controls that meet both ends, against the positions that they lead to."""
    rng = np.random.default_rng(0)
    scenario = draw("dense", 1, 5, 0, PROBLEM)
    ends = scenario.initial, scenario.goal
    own = decoupled_optima(*ends, PROBLEM).controls
    states = fly(scenario.initial, own, PROBLEM)
    moved = np.ones(5, dtype=bool)
    swarms = swarm_partition((len(states),))
    found = loss_encounters(DriftingPaths(states, own, PROBLEM, 1.0, swarms), 30.0, moved)
    cuts = passive_safety_cuts(found, states, PROBLEM, swarms)
    normal = rng.normal(size=(len(cuts), 3))
    planes = half_spaces(cuts, normal, scenario.initial, PROBLEM, 0.0)
    kinds = {(k == 0, i >= 10) for k, i in zip(found.node, found.interval, strict=True)}
    assert kinds == {(False, False), (True, False), (False, True)}
    pushed = own + 1e-4 * rng.normal(size=own.shape)
    controls = meet_goal(scenario.initial, pushed, scenario.goal, PROBLEM)
    flown = fly(scenario.initial, controls, PROBLEM)
    flat = controls.reshape(5, -1)
    along = np.vecdot(planes.row, flat[cuts.first]) - np.vecdot(planes.other, flat[cuts.second])
    along -= planes.required
    assert along == pytest.approx(np.vecdot(normal, gaps(cuts, flown, controls)), abs=1e-6)
    for k in range(0, len(cuts), 7):
        who = int(found.first[k]), int(found.second[k])
        time = found.interval[k] * PROBLEM.time_step + found.offset[k]
        apart = distance_adrift(CASE, flown, controls, who, int(found.node[k]), float(time))
        assert np.linalg.norm(gaps(cuts, flown, controls)[k]) == pytest.approx(apart, abs=1e-5)


@pytest.mark.parametrize("name", ["expert", "decoupled-optimum"])
def test_a_drift_of_more_time_steps_than_fit_in_memory_is_refused_in_a_sentence(name):
    scenario = draw("rings", 0, 2, 1, Problem(time_step=1e-3, nodes=5))
    planner = named_planner(name, Requirements(passive_safety=100.0))
    with pytest.raises(InputError, match="fewer orbits"):
        planner.plan([scenario])


def test_separation_at_the_nodes_only_is_refused_with_it():
    with pytest.raises(InputError, match="leave one of the two out"):
        Requirements("nodes", passive_safety=1.0)
