"""What a plan is said to be worth, for plans whose worth is known by hand."""

import json
from dataclasses import replace

import numpy as np
import pytest

from pipeline.orbit.participants import Obstacle
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import fly, minimum_energy
from pipeline.plan.certificate import certify, gap_of
from pipeline.plan.document import plan_document
from pipeline.plan.judge import Draft, certified_plan
from pipeline.plan.plan import SOLVED, UNSAFE, UNSOLVED
from pipeline.plan.requirements import Requirements, RiskLimit
from pipeline.scenario import Scenario

FREE = Problem(mean_motion=1e-12, time_step=10.0, nodes=4)
"""As good as free space, where motion is easy to work out by hand."""


def scenario_of(*starts, controls, problem=FREE):
    """Craft that fly the given controls, with the goals where they end."""
    start = np.array(starts, dtype=float)
    states = fly(start, controls, problem)
    return Scenario(problem, start, states[:, -1].copy()), states


def passing(miss):
    """A craft at rest, and one that passes it at 10 m/s at 15 s, between two nodes."""
    controls = np.zeros((2, 3, 3))
    return (
        *scenario_of([0] * 6, [-150.0, miss, 0, 10.0, 0, 0], controls=controls),
        controls,
    )


def test_a_pass_between_nodes_is_certified_with_its_pair_time_and_distance():
    scenario, states, controls = passing(miss=3.0)
    certificate = certify([scenario], states, controls, [(0.0, "")])[0]
    assert certificate.node_collisions == 0
    assert certificate.min_separation == pytest.approx(3.0, abs=1e-3)
    assert certificate.min_separation_bound <= 3.0
    assert certificate.min_separation_pair == (0, 1)
    assert certificate.min_separation_time == pytest.approx(15.0, abs=0.01)


def test_fuel_delta_v_and_gap_are_those_of_the_controls():
    controls = np.zeros((1, 3, 3))
    controls[0, 0, 0], controls[0, 2, 1] = 1e-3, -2e-3
    scenario, states = scenario_of([0] * 6, controls=controls)
    certificate = certify([scenario], states, controls, [(2e-3, "")])[0]
    assert certificate.fuel == pytest.approx(3e-3)
    assert certificate.delta_v == pytest.approx(3e-2)
    assert certificate.optimality_gap == pytest.approx(0.5)
    assert certificate.min_separation is None


def test_states_that_miss_the_goal_or_break_the_dynamics_are_told_by_how_much():
    scenario, states, controls = passing(miss=100.0)
    states[1, -1, 0] += 2.0
    certificate = certify([scenario], states, controls, [(0.0, "")])[0]
    assert certificate.goal_error == pytest.approx(2.0)
    assert certificate.dynamics_error == pytest.approx(2.0)


@pytest.mark.parametrize(("component", "missed"), [(0, "1e-05 m"), (5, "1e-05 m/s")])
def test_a_plan_that_misses_any_component_of_its_goal_is_not_solved(component, missed):
    scenario, _, controls = passing(miss=100.0)
    goal = scenario.goal.copy()
    goal[1, component] += 1e-5
    plan = certified_plan("one", replace(scenario, goal=goal), Draft(controls, 0.0))
    assert plan.status == UNSOLVED
    assert "misses its goal by " in plan.message
    assert missed in plan.message
    errors = plan.certificate.goal_error, plan.certificate.goal_velocity_error
    assert errors[component // 3] == pytest.approx(1e-5)
    assert errors[1 - component // 3] < 1e-12


def test_a_gap_without_fuel_is_none_and_with_fuel_from_nothing_is_infinite():
    assert gap_of(0.0, 0.0, FREE) == 0
    assert gap_of(1.0, 0.0, FREE) == np.inf
    assert gap_of(1.1, 1.0, FREE) == pytest.approx(0.1)


@pytest.mark.parametrize("least", [1e-3, 1e-9, 1e-12])
def test_the_gap_of_little_fuel_is_a_gap(least):
    """Of a week's drift: 31 % is 31 %, however weak the thrusters."""
    slow = Problem(time_step=60480.0)
    assert gap_of(1.31 * least, least, slow) == pytest.approx(0.31)


@pytest.mark.parametrize("limit", [1e-12, 1e-9, 1e-6, 1e-3, 1.0])
def test_a_thrust_limit_is_kept_whatever_its_size(limit):
    problem = replace(FREE, max_acceleration=limit)
    for share, status in ((1.0, SOLVED), (1.01, UNSAFE)):
        controls = np.full((1, 3, 3), share * limit)
        scenario, _ = scenario_of([0] * 6, controls=controls, problem=problem)
        assert certified_plan("one", scenario, Draft(controls, 0.0)).status == status


def test_a_pass_between_nodes_is_unsafe_at_all_times_and_fine_at_the_nodes():
    scenario, _, controls = passing(miss=3.0)
    plan = certified_plan("one", scenario, Draft(controls, 0.0))
    assert plan.status == UNSAFE
    assert "craft 0 and 1 come within 3" in plan.message
    assert (
        certified_plan("one", scenario, Draft(controls, 0.0), Requirements("nodes")).status
        == SOLVED
    )


def test_craft_that_keep_too_close_all_the_way_are_never_solved():
    """Ten metres apart from start to goal; what is proven of them is a matter of rounding."""
    rng = np.random.default_rng(0)
    for begin, shift in rng.uniform(-300, 300, size=(150, 2)):
        initial = np.zeros((2, 6))
        initial[:, 1] = begin, begin + 10
        goal = initial + np.eye(6)[1] * shift
        controls = minimum_energy(initial, goal, Problem())
        scenario = Scenario(Problem(), initial, goal)
        for requirements in (Requirements(), Requirements("nodes")):
            plan = certified_plan("one", scenario, Draft(controls, 0.0), requirements)
            assert (plan.status, plan.certificate.min_separation_pair) == (UNSAFE, (0, 1))
            assert "craft 0 and 1 come within 10 m" in plan.message


def test_a_bound_that_rounding_puts_above_the_fuel_is_the_fuel():
    """Sums in another order differ by an ulp or two, on some machines more than on others."""
    controls = np.full((1, 3, 3), 0.1)
    scenario, _ = scenario_of([0] * 6, controls=controls, problem=Problem(nodes=4))
    fuel = certified_plan("one", scenario, Draft(controls, 0.0)).certificate.fuel
    above = np.nextafter(fuel, 1.0)
    found = certified_plan("one", scenario, Draft(controls, above)).certificate
    assert (found.fuel_lower_bound, found.optimality_gap) == (fuel, 0.0)
    wrong = certified_plan("one", scenario, Draft(controls, 1.001 * fuel)).certificate
    assert wrong.optimality_gap < -0.9e-3  # a bound that is wrong is not hidden


def test_an_obstacle_met_at_a_node_is_counted_beside_a_scenario_without():
    controls = np.zeros((1, 3, 3))
    alone, states = scenario_of([-50.0, 0, 0, 5, 0, 0], controls=controls)
    debris = Obstacle("debris", (0.0,) * 6, radius=2.0)  # passed at the node after 10 s
    both = [alone, replace(alone, obstacles=(debris,))]
    flown = (np.concatenate([one, one]) for one in (states, controls))
    found = certify(both, *flown, [(0.0, "")] * 2)
    assert [one.node_collisions for one in found] == [0, 1]


def test_a_risk_is_of_all_that_craft_may_do_between_states_that_break_the_dynamics():
    """Two craft at rest 50 m apart; the states put one of them 20 m nearer at one node."""
    controls, asked = np.zeros((2, 3, 3)), Requirements(risk=RiskLimit(0.01, 0.1))
    scenario, states = scenario_of([0] * 6, [50.0, 0, 0, 0, 0, 0], controls=controls)
    risks = []
    for nearer in (0.0, 20.0):
        states[1, 1, 0] -= nearer
        (found,) = certify([scenario], states, controls, [(0.0, "")], asked)
        risks.append(found.risk.bound)
    assert risks[0] < 1e-9  # hundreds of standard deviations of 0.1 m
    assert risks[1] >= 1  # 30 m apart and 20 m off: within 15 m for all that is known


def test_a_plan_beyond_the_thrust_limit_is_not_solved():
    limited = Problem(mean_motion=1e-12, time_step=10.0, nodes=4, max_acceleration=1e-3)
    controls = np.full((1, 3, 3), 1.1e-3)
    scenario, _ = scenario_of([0] * 6, controls=controls, problem=limited)
    plan = certified_plan("one", scenario, Draft(controls, 0.0))
    assert plan.status == UNSAFE
    assert "max_acceleration" in plan.message


def test_the_document_of_a_plan_is_plain_json_with_null_for_what_is_not_there():
    controls = np.full((1, 3, 3), 1e-3)
    scenario, _ = scenario_of([0] * 6, controls=controls)
    plan = certified_plan("one", scenario, Draft(controls, 0.0))
    document = json.loads(json.dumps(plan_document(plan), allow_nan=False))
    assert document["schema"] == "prolearn.plan/2"
    assert document["times"] == [0, 10, 20, 30]
    assert np.shape(document["states"]) == (1, 4, 6)
    assert document["certificate"]["min_separation"] is None
    assert document["certificate"]["optimality_gap"] is None


def test_each_craft_has_its_delta_v_in_both_norms():
    controls = np.zeros((2, 3, 3))
    controls[0, 0], controls[1, 1], controls[1, 2] = (3e-3, 4e-3, 0), (0, 0, -1e-3), (2e-3, 0, 0)
    scenario, states = scenario_of([0] * 6, [0, 100.0, 0, 0, 0, 0], controls=controls)
    found = certify([scenario], states, controls, [(0.0, "")])[0]
    assert found.craft_delta_v == pytest.approx((0.07, 0.03))  # 10 s each
    assert found.craft_delta_v_2norm == pytest.approx((0.05, 0.03))
    assert sum(found.craft_delta_v) == pytest.approx(found.delta_v)
