"""Plans of an asked risk: the claim holds in trials that share no code with it."""

import re
from dataclasses import replace

import numpy as np
import pytest
from judge import Case
from one_swarm import least_separation
from scipy.stats import ncx2
from trials import Errors, corrected, frequency, frequency_corrected, wilson

from pipeline.errors import InputError
from pipeline.expert import EFFORTS, solve, within_risk
from pipeline.orbit.problem import Problem
from pipeline.orbit.thrust import Thrust
from pipeline.plan.plan import INFEASIBLE, SOLVED, UNSOLVED
from pipeline.plan.requirements import Requirements, RiskLimit
from pipeline.scenario import Scenario, draw

PROBLEM = Problem()
CASE = Case(PROBLEM.mean_motion, PROBLEM.time_step, PROBLEM.nodes, PROBLEM.collision_radius)
USUAL = 0.2, 0.01
"""Errors of navigation, m, and of thrust, as a share."""

TRIALS = 4000


def limit(asked, errors=USUAL):
    return Requirements(risk=RiskLimit(asked, *errors))


def hits(plan, scenario, errors=USUAL, trials=TRIALS):
    position, thrust = errors
    told = Errors(position, position * PROBLEM.mean_motion, thrust)
    return frequency(CASE, scenario.initial, plan.controls, told, trials)


@pytest.mark.parametrize(
    ("family", "index", "asked", "errors"),
    [
        ("rings", 1, 0.05, USUAL),
        ("rings", 4, 0.05, USUAL),
        ("rings", 6, 0.01, USUAL),
        ("rings", 2, 0.01, USUAL),
        ("dense", 5, 0.05, (0.05, 0.001)),
    ],
)
def test_craft_come_too_close_no_more_often_than_asked_for(family, index, asked, errors):
    """The plan for the collision radius alone is seen to fail by the same trials."""
    scenario = draw(family, 0, 10, index, PROBLEM, "valid")
    bare = solve(scenario)
    plan = within_risk(bare, limit(asked, errors))
    claim = plan.certificate.risk
    assert plan.status == SOLVED
    assert asked / 2 <= claim.bound <= asked, "and not needlessly safe"
    lower, upper = wilson(hits(plan, scenario, errors), TRIALS)
    assert lower <= claim.bound
    assert upper >= claim.bound / 3
    lower, _ = wilson(hits(bare, scenario, errors, 1000), 1000)
    assert lower > asked
    assert claim.fuel_without == bare.certificate.fuel
    assert claim.fuel_without < plan.certificate.fuel < 1.05 * claim.fuel_without


def test_a_plan_that_is_safe_enough_is_left_as_it_is():
    scenario = draw("rings", 0, 10, 0, PROBLEM, "valid")
    bare = solve(scenario)
    plan = within_risk(bare, limit(1e-3))
    assert (plan.controls == bare.controls).all()
    assert plan.certificate.risk.sigmas == 0
    assert 0 < plan.certificate.risk.bound <= 1e-3
    assert replace(plan.certificate, risk=None) == bare.certificate


def test_with_errors_of_a_nanometre_nothing_changes():
    scenario = draw("rings", 0, 10, 4, PROBLEM, "valid")
    bare = solve(scenario)
    plan = within_risk(bare, Requirements(risk=RiskLimit(1e-3, 1e-9)))
    assert plan.status == SOLVED
    assert (plan.controls == bare.controls).all()


@pytest.mark.parametrize("effort", EFFORTS)
def test_every_effort_keeps_the_risk(effort):
    scenario = draw("rings", 0, 10, 4, PROBLEM, "valid")
    settings = EFFORTS[effort]
    plan = within_risk(solve(scenario, settings=settings), limit(1e-3), settings)
    assert plan.status == SOLVED
    assert plan.certificate.risk.bound <= 1e-3
    assert plan.certificate.risk.sigmas > 2


def test_craft_that_are_too_close_where_they_must_be_are_named():
    scenario = draw("rings", 0, 10, 90, PROBLEM, "valid")
    plan = within_risk(solve(scenario), limit(1e-3))
    i, j = np.triu_indices(10, 1)
    apart = np.linalg.norm(scenario.goal[i, :3] - scenario.goal[j, :3], axis=1)
    assert plan.status == UNSOLVED
    assert plan.certificate.risk.bound > 1e-3
    assert "asked for was 0.001" in plan.message
    first, second = i[apart.argmin()], j[apart.argmin()]
    assert f"craft {first} and {second} are {apart.min():.4g} m apart at the goal" in plan.message
    assert least_separation(plan.states, plan.controls, PROBLEM).bound > 15, "flown exactly"
    assert wilson(hits(plan, scenario), TRIALS)[0] > 1e-3, "it is no mere weakness of the bound"


def test_a_proof_that_there_is_no_plan_stands():
    scenario = draw("rings", 0, 2, 0, Problem(max_acceleration=1e-6))
    plan = within_risk(solve(scenario), limit(0.1))
    assert plan.status == INFEASIBLE
    assert plan.certificate.risk is None


def test_a_craft_alone_has_no_risk():
    scenario = draw("rings", 0, 1, 0, PROBLEM)
    plan = within_risk(solve(scenario), limit(1e-9))
    assert plan.status == SOLVED
    assert plan.certificate.risk.bound == 0


def test_a_thrust_limit_that_leaves_no_room_for_safety_is_said():
    """Two craft drift through one point; thrust keeps them 15 m apart, and not much more."""
    problem = Problem(time_step=60.0, nodes=11, max_acceleration=1.2e-2)
    start = np.zeros((2, 6))
    start[1, 1], start[1, 4] = 40.0, -1.0
    goal = start.copy()
    goal[1, 1] = -40.0
    scenario = Scenario(problem, start, goal)
    bare = solve(scenario)
    plan = within_risk(bare, Requirements(risk=RiskLimit(1e-3, navigation_sigma=12.0)))
    assert bare.status == SOLVED
    assert plan.status == UNSOLVED
    assert "is bounded by" in plan.message


def closed(asked, errors=USUAL):
    return Requirements(risk=RiskLimit(asked, *errors, closed_loop=True))


@pytest.mark.parametrize(("index", "asked"), [(1, 0.05), (2, 0.05), (6, 0.01)])
def test_with_feedback_craft_come_too_close_no_more_often_than_asked_for(index, asked):
    """By trials that are corrected at each node; without feedback the same plan fails."""
    scenario = draw("rings", 0, 10, index, PROBLEM, "valid")
    plan = solve(scenario, requirements=closed(asked))
    claim, errors = plan.certificate.risk, Errors(0.2, 0.2 * PROBLEM.mean_motion, 0.01)
    assert plan.status == SOLVED
    assert claim.bound <= asked
    hit = frequency_corrected(CASE, plan.states, plan.controls, errors, TRIALS)
    lower, upper = wilson(hit, TRIALS)
    assert lower <= claim.bound
    assert upper >= claim.bound / 3
    in_loop = solve(scenario, requirements=limit(asked))
    assert plan.certificate.fuel <= in_loop.certificate.fuel
    assert claim.feedback.saturation == 0


def test_thirty_craft_are_safe_with_feedback_whose_errors_outgrow_their_goals_without():
    scenario = draw("rings", 0, 30, 3, PROBLEM, "valid")
    assert solve(scenario, requirements=limit(1e-3)).status == UNSOLVED
    plan = solve(scenario, requirements=closed(1e-3))
    claim = plan.certificate.risk
    assert (plan.status, claim.bound <= 1e-3) == (SOLVED, True)
    assert plan.certificate.fuel < 1.01 * claim.fuel_without
    assert 0 < claim.feedback.delta_v < 0.06 * plan.certificate.delta_v


def test_corrections_have_room_within_the_thrust_limit():
    """The plan alone would burn at the limit; what is asked for in trials stays within it."""
    scenario = draw("rings", 0, 10, 2, PROBLEM, "valid")
    largest = float(np.abs(solve(scenario).controls).max())
    tight = replace(scenario, problem=replace(PROBLEM, max_acceleration=0.9 * largest))
    bare = solve(tight)
    assert np.abs(bare.controls).max() == pytest.approx(0.9 * largest, rel=1e-6)
    plan = within_risk(bare, closed(0.01))
    claim = plan.certificate.risk
    assert plan.status == SOLVED
    assert claim.feedback.saturation < 1e-3
    errors = Errors(0.2, 0.2 * PROBLEM.mean_motion, 0.01)
    _, asked, _ = corrected(CASE, plan.states, plan.controls, errors, 4000, 0)
    beyond = (np.abs(asked) > 0.9 * largest).any(axis=(1, 2, 3)).mean()
    assert beyond <= claim.feedback.saturation + 3.3 * (1e-3 / 4000) ** 0.5
    assert plan.certificate.fuel_lower_bound == bare.certificate.fuel_lower_bound


def test_a_limit_that_leaves_corrections_no_room_is_named():
    scenario = draw("rings", 0, 2, 1, PROBLEM, "valid")
    largest = float(np.abs(solve(scenario).controls).max())
    tight = replace(scenario, problem=replace(PROBLEM, max_acceleration=0.6 * largest))
    assert solve(tight).status == SOLVED
    plan = solve(tight, requirements=closed(1e-3, (20.0, 0.01)))
    assert plan.status == UNSOLVED
    assert "corrections at each node ask for more than max_acceleration" in plan.message


def test_what_corrections_do_not_know_is_refused():
    scenario = draw("rings", 0, 3, 0, PROBLEM, "valid")
    pointed = replace(scenario, problem=replace(PROBLEM, thrust=Thrust("norm")))
    with pytest.raises(InputError, match="leave closed_loop out"):
        solve(pointed, requirements=closed(1e-3))


def test_and_so_where_no_plan_is_possible():
    """As of craft that may not burn at all; not called infeasible, or unsolved as flown."""
    idle = replace(PROBLEM, thrust=Thrust(no_burn=((0.0, PROBLEM.duration),)))
    scenario = draw("rings", 0, 3, 0, idle)
    assert solve(scenario).status == INFEASIBLE
    with pytest.raises(InputError, match="leave closed_loop out"):
        solve(scenario, requirements=closed(1e-3))


@pytest.mark.parametrize(("index", "end"), [(15, "start"), (74, "goal")])
def test_ends_whose_errors_of_navigation_alone_are_too_risky_are_said_to_be(index, end):
    """Whatever is planned: at the start by the distribution itself, at the goal in trials.

    Of craft that are at a point with independent normal errors the squared distance is noncentral
    chi-square.
    """
    scenario = draw("rings", 0, 30, index, PROBLEM, "valid")
    required = Requirements(risk=RiskLimit(1e-3, *USUAL, closed_loop=True))
    plan = solve(scenario, requirements=required)
    at = scenario.initial if end == "start" else scenario.goal
    i, j = np.triu_indices(30, 1)
    apart = np.linalg.norm(at[i, :3] - at[j, :3], axis=1)
    pair = [int(i[apart.argmin()]), int(j[apart.argmin()])]
    if end == "start":
        scale = 2 * USUAL[0] ** 2
        lower = float(ncx2.cdf(15**2 / scale, 3, apart.min() ** 2 / scale))
    else:
        told = Errors(USUAL[0], USUAL[0] * PROBLEM.mean_motion, 0.0)
        nodes, _, _ = corrected(CASE, plan.states[pair], plan.controls[pair], told, TRIALS, 0)
        near = np.linalg.norm(nodes[:, 0, -1, :3] - nodes[:, 1, -1, :3], axis=1) < 15
        lower, _ = wilson(int(near.sum()), TRIALS)
    assert lower > 1e-3
    assert plan.status == UNSOLVED
    said = re.search(
        r"the ends alone have ([\d.e-]+): craft (\d+) and (\d+) are (\S+) m", plan.message
    )
    assert float(said[1]) >= lower
    named = [int(said[2]), int(said[3])]
    assert np.linalg.norm(at[named[0], :3] - at[named[1], :3]) == pytest.approx(
        apart.min(), rel=0.01
    )
    assert plan.message.endswith(f"m apart at the {end}")


def test_no_other_plan_is_sought_where_the_ends_alone_have_many_times_the_risk():
    scenario = draw("rings", 0, 30, 0, PROBLEM)
    plain = solve(scenario)
    limit = RiskLimit(1e-5, 5.0, 0.05)
    plan = solve(scenario, requirements=Requirements(risk=limit))
    assert plan.status == UNSOLVED
    said = float(re.search(r"the ends alone have ([\d.e-]+):", plan.message)[1])
    assert said > 10 * limit.asked
    assert plan.convex_solves == plain.convex_solves
    assert (plan.controls == plain.controls).all()
