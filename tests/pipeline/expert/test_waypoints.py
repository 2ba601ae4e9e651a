"""Waypoints: passed exactly, at least fuel, at nodes given or the best; held to cvxpy."""

from dataclasses import replace
from itertools import combinations

import cvxpy as cp
import numpy as np
import pytest
from judge import judge_plan
from judge.motion import exact_step
from judged import document
from scipy.spatial.transform import Rotation

from pipeline.documents import write_document
from pipeline.errors import InputError
from pipeline.expert import solve
from pipeline.orbit.problem import Problem
from pipeline.orbit.thrust import Thrust
from pipeline.plan.document import plan_document, read_plan, write_plan
from pipeline.plan.plan import INFEASIBLE, SOLVED, UNSAFE
from pipeline.plan.recheck import recheck
from pipeline.plan.requirements import Requirements
from pipeline.planners.goal_assignment import GoalAssignment
from pipeline.planners.named import named_planner
from pipeline.scenario import Scenario, diagnostics, draw
from pipeline.scenario.document import document_of, read_scenario, scenario_from
from pipeline.scenario.spacecraft import Spacecraft
from pipeline.scenario.waypoint import MOST_CHOICES, Waypoint, node_choices

PROBLEM = Problem()
SWARM = draw("rings", 0, 6, 3, PROBLEM)
BETWEEN = tuple(
    Waypoint(k, tuple((1.5 * SWARM.initial[(k + 1) % 6, :3]).tolist()), None, 600.0)
    for k in range(6)
)
NORM = Thrust("norm")
TURN = Rotation.from_rotvec([0.3, 0.5, 0.7]).as_matrix()  # whose columns are axes of thrusters
TURNED = Thrust(tuple(map(tuple, np.concatenate([TURN.T, -TURN.T]).tolist())))


def with_waypoints(*waypoints, thrust=PROBLEM.thrust):
    """The swarm, some of whose craft pass waypoints."""
    return replace(SWARM, problem=replace(PROBLEM, thrust=thrust), waypoints=waypoints)


def least_fuel(craft, passed, thrust, largest=False):
    """Fuel of the craft's own program, m/s², that is at positions at nodes, by cvxpy.

    Or the largest component of its controls.
    """
    free, pushed = exact_step(PROBLEM.mean_motion, PROBLEM.time_step)
    control = cp.Variable((PROBLEM.intervals, 3))
    flat, constraints = cp.vec(control, order="C"), []
    state, reach = SWARM.initial[craft], np.zeros((6, 3 * PROBLEM.intervals))
    size = np.repeat([1.0, PROBLEM.duration], 3)
    for node in range(1, PROBLEM.nodes):
        state, reach = free @ state, free @ reach
        reach[:, 3 * node - 3 : 3 * node] = pushed * 1e-3
        if node in passed:
            constraints.append(reach[:3] @ flat == passed[node] - state[:3])
    constraints.append((size[:, None] * reach) @ flat == size * (SWARM.goal[craft] - state))
    fired = control @ TURN if thrust is TURNED else control
    cost = cp.sum(cp.norm(fired, 2 if thrust is NORM else 1, axis=1))
    cost = cp.norm(flat, "inf") if largest else cost
    return cp.Problem(cp.Minimize(cost), constraints).solve(solver="CLARABEL") * 1e-3


def off(plan, craft, position):
    """How far a craft is from a position at each node, m."""
    return np.linalg.norm(plan.states[craft, :, :3] - position, axis=1)


@pytest.mark.parametrize("thrust", [PROBLEM.thrust, NORM], ids=["components", "norm"])
def test_waypoints_are_passed_at_their_times_for_the_least_fuel(thrust):
    plan = solve(with_waypoints(*BETWEEN, thrust=thrust))
    assert plan.status == SOLVED
    for one in BETWEEN:
        assert off(plan, one.craft, one.position)[5] < 1e-6
    least = sum(least_fuel(k, {5: BETWEEN[k].position}, thrust) for k in range(6))
    found = plan.certificate
    assert found.fuel_lower_bound == pytest.approx(least, rel=1e-6)
    assert found.fuel >= least * (1 - 1e-6)
    if thrust is not NORM:
        report = judge_plan(document(plan.scenario), plan_document(plan))
        assert report.faults == ()
        assert report.fuel_lower_bound < least  # of its transfer without waypoints


@pytest.mark.parametrize("thrust", [PROBLEM.thrust, NORM], ids=["components", "norm"])
def test_waypoints_without_times_are_passed_where_that_costs_least(thrust):
    first, second = SWARM.initial[1, :3] * 1.2, (10.0, 300.0, 0.0)
    open_times = [Waypoint(0, tuple(first.tolist())), Waypoint(0, second)]
    plan = solve(with_waypoints(*open_times, thrust=thrust))
    assert plan.status == SOLVED
    nodes = [int(off(plan, 0, place).argmin()) for place in (first, second)]
    assert 0 < nodes[0] < nodes[1] < PROBLEM.intervals
    assert max(off(plan, 0, place).min() for place in (first, second)) < 1e-6
    least = min(
        least_fuel(0, {a: first, b: second}, thrust)
        for a, b in combinations(range(1, PROBLEM.intervals), 2)
    )
    others = sum(least_fuel(k, {}, thrust) for k in range(1, 6))
    assert plan.certificate.fuel_lower_bound == pytest.approx(least + others, rel=1e-6)


@pytest.mark.parametrize(("thrust", "part"), [(NORM, 0.5), (TURNED, 1.2)])
def test_a_time_left_open_is_the_one_that_costs_these_thrusters_least(thrust, part):
    craft, place = 5, part * SWARM.initial[1, :3]
    alone = with_waypoints(Waypoint(0, tuple(place.tolist())), thrust=thrust)
    ends = {end: getattr(SWARM, end)[[craft]] for end in ("initial", "goal")}
    least = min(least_fuel(craft, {k: place}, thrust) for k in range(1, PROBLEM.intervals))
    assert solve(replace(alone, **ends)).certificate.fuel == pytest.approx(least, rel=1e-5)


@pytest.mark.parametrize("thrust", [PROBLEM.thrust, NORM], ids=["components", "norm"])
def test_a_craft_that_drifts_by_waypoints_to_its_goal_burns_nothing(thrust):
    """Waypoints at open times, reached at one node by drift, up to rounding, and at no other."""
    problem = replace(PROBLEM, thrust=thrust, max_acceleration=5e-3)
    free, _ = exact_step(problem.mean_motion, problem.time_step)
    drift = [np.linalg.matrix_power(free, node) @ SWARM.initial[0] for node in range(problem.nodes)]
    first, second = (tuple(map(tuple, drift[node].reshape(2, 3).tolist())) for node in (1, 5))
    passed = Waypoint(0, *first, problem.time_step), Waypoint(0, second[0])
    ends = {"initial": SWARM.initial[:1], "goal": drift[-1][None]}
    plan = solve(replace(SWARM, problem=problem, waypoints=passed, **ends))
    assert (plan.status, plan.certificate.fuel_lower_bound) == (SOLVED, pytest.approx(0, abs=1e-12))
    assert np.abs(plan.controls).max() < 1e-12


def test_by_an_open_time_fuel_and_bound_of_a_slow_transfer_scale_with_its_size():
    found = []
    for size in (1.0, 0.01):
        state = size * np.array([[0.0, 100.0, 0, 0, 0, 0]])
        way = Waypoint(0, (20.0 * size, 0.0, 10.0 * size), (0.0, 1e-3 * size, 0.0))
        problem = Problem(mean_motion=7.3e-5, time_step=3600.0, nodes=13, collision_radius=size)
        one = solve(Scenario(problem, -state, state, waypoints=(way,))).certificate
        found.append([one.fuel / size, one.fuel_lower_bound / size])
    assert found[1] == pytest.approx(found[0], rel=1e-6)
    assert found[1][1] == pytest.approx(found[1][0], rel=1e-6)


def test_rounding_of_controls_moves_no_waypoint_of_a_slow_transfer(tmp_path):
    slow = Problem(time_step=2400.0, nodes=21)
    start, goal, by = (-173.0, -67.0, 45.0), (-143.0, -50.0, 125.0), (27.0, 0.0, 4.0)
    ends = (np.array([[*place, 0.0, 0.0, 0.0]]) for place in (start, goal))
    asked = Scenario(slow, *ends, waypoints=(Waypoint(0, by, None, 16 * slow.time_step),))
    write_plan(tmp_path / "plan.json", solve(asked))
    plan = read_plan(tmp_path / "plan.json")
    assert plan.status == SOLVED
    assert off(plan, 0, by)[16] < 1e-6
    assert recheck(plan).faults == ()


def test_a_velocity_is_met_as_well():
    still = Waypoint(1, BETWEEN[1].position, (0.0, 0.0, 0.0), 600.0)
    plan = solve(with_waypoints(still))
    assert plan.status == SOLVED
    assert np.abs(plan.states[1, 5] - [*still.position, 0, 0, 0]).max() < 1e-6


@pytest.mark.parametrize("requirements", [Requirements(), Requirements(passive_safety=0.3)])
def test_the_refiner_has_the_expert_pass_them(requirements):
    plan = named_planner("refiner", requirements).plan([with_waypoints(*BETWEEN[:2])])[0]
    assert plan.status == SOLVED
    assert max(off(plan, k, BETWEEN[k].position)[5] for k in range(2)) < 1e-6


def test_a_waypoint_that_no_assignment_can_pass_is_named():
    """One interval has three controls for the six numbers of a state."""
    still = Waypoint(1, BETWEEN[1].position, (0.0, 0.0, 0.0), PROBLEM.time_step)
    planner = GoalAssignment(named_planner("expert", Requirements()))
    (plan,) = planner.plan([with_waypoints(still)])
    assert plan.status == INFEASIBLE
    assert "cannot reach its own by its waypoints with any thrust, however large" in plan.message


def test_goals_may_be_assigned_after_waypoints():
    given = solve(with_waypoints(*BETWEEN))
    (plan,) = GoalAssignment(named_planner("expert")).plan([with_waypoints(*BETWEEN)])
    assert plan.status == SOLVED
    assert sorted(plan.assignment.slots) == [*range(6)]
    assert plan.certificate.fuel <= given.certificate.fuel * (1 + 1e-9)
    assert max(off(plan, k, BETWEEN[k].position)[5] for k in range(6)) < 1e-6


def test_a_baseline_that_flies_past_them_is_unsafe_and_says_so():
    (plan,) = named_planner("minimum-energy").plan([with_waypoints(BETWEEN[0])])
    assert plan.status == UNSAFE
    miss = np.abs(plan.states[0, 5, :3] - BETWEEN[0].position).max()
    assert f"misses a waypoint by {miss:.3g} m" in plan.message


def test_a_plan_file_that_moves_its_waypoint_is_found_out(tmp_path):
    plan = solve(with_waypoints(BETWEEN[0]))
    moved = replace(BETWEEN[0], position=(0.0, 500.0, 0.0))
    write_plan(tmp_path / "p.json", replace(plan, scenario=with_waypoints(moved)))
    faults = recheck(read_plan(tmp_path / "p.json")).faults
    assert any("misses a waypoint" in fault.lower() for fault in faults)


def test_craft_that_must_meet_have_no_plan():
    near = replace(BETWEEN[1], position=BETWEEN[0].position)
    swarm = with_waypoints(BETWEEN[0], near)
    plan = solve(swarm)
    assert plan.status == INFEASIBLE
    assert "craft 0 and 1 must be 0 m apart at 600 s" in plan.message
    (said,) = [one for one in diagnostics(swarm) if one.rule == "waypoints apart"]
    assert not said.fine
    assert said.cases[0].craft == (0, 1)


def test_one_that_no_thrust_within_the_limit_reaches_is_proven_so():
    far = replace(SWARM, problem=replace(PROBLEM, max_acceleration=0.01))
    far = replace(far, waypoints=(Waypoint(2, (0.0, 5000.0, 0.0), None, 240.0),))
    plan = solve(far)
    assert plan.status == INFEASIBLE
    assert "craft 2 cannot reach its goal by its waypoints" in plan.message


def test_a_check_counts_waypoints_that_have_times():
    places = {k: {5: one.position} for k, one in enumerate(BETWEEN)}
    least = [least_fuel(k, places[k], PROBLEM.thrust, largest=True) for k in range(6)]
    burned = [least_fuel(k, places[k], PROBLEM.thrust) * PROBLEM.time_step for k in range(6)]

    def said(craft=(), **limits):
        asked = replace(SWARM, problem=replace(PROBLEM, **limits), waypoints=BETWEEN, craft=craft)
        (found,) = [one for one in diagnostics(asked) if one.rule == "within reach"]
        return found

    assert said(max_acceleration=max(least) * 1.001).fine
    (case,) = said(max_acceleration=max(least) * 0.999).cases
    assert case.craft == (int(np.argmax(least)),)
    assert case.numbers["least_max_acceleration"] == pytest.approx(max(least), rel=1e-5)
    assert f"craft {np.argmax(least)} needs the most, {max(least):.4g} m/s²" in said().text
    has = tuple(Spacecraft(delta_v=0.999 * one) for one in burned)
    short = said(has, max_acceleration=1.0).cases
    assert [case.numbers["least_delta_v"] for case in short] == pytest.approx(burned, rel=1e-5)


def test_a_check_says_that_no_thrust_leads_by_waypoints_that_are_too_many():
    """One interval has three controls for the six numbers of a state."""
    still = Waypoint(1, BETWEEN[1].position, (0.0, 0.0, 0.0), PROBLEM.time_step)
    (found,) = [one for one in diagnostics(with_waypoints(still)) if one.rule == "within reach"]
    (case,) = found.cases
    assert case.text == "craft 1 cannot reach its goal by its waypoints, however large its thrust"
    why = "craft 1 cannot reach its goal by its waypoints with any thrust, however large"
    assert why in solve(with_waypoints(still)).message


def test_a_formation_between_is_one_waypoint_of_each_craft(tmp_path):
    fields = document_of(SWARM)
    ring = {"craft": 6, "size": 400, "tilt_deg": 30}
    fields["waypoints"] = [{"formation": {"rings": [ring]}, "time": 600}]
    fields["waypoints"] += [{"craft": 2, "position": [0, 100, 0], "time": 840}]
    write_document(tmp_path / "s.json", fields)
    swarm = read_scenario(tmp_path / "s.json")
    assert len(swarm.waypoints) == 7
    # The ring's own definition, a quarter of its phase on
    assert swarm.waypoints[0].position[0] == pytest.approx(200.0)
    again = scenario_from({k: v for k, v in document_of(swarm).items() if k != "schema"}, "")
    assert again.waypoints == swarm.waypoints
    plan = solve(swarm)
    assert plan.status == SOLVED


@pytest.mark.parametrize(
    ("waypoint", "said"),
    [
        ({"craft": 6, "position": [0, 0, 0]}, "expected a craft's number, 0 to 5"),
        ({"craft": 0, "position": [0, 0, 0], "time": 650}, "a multiple of 120 s"),
        ({"craft": 0, "position": [0, 0, 0], "time": 1200}, "between the first and the last"),
        ({"craft": 0, "position": [0, 0, 0], "time": 1e13}, r"waypoints\[0\].time is 1000"),
        ({"craft": 0}, "give craft and position, or a formation"),
        ({"formation": [[0, 0, 0, 0, 0, 0]], "time": 600}, "has 1 craft and initial has 6"),
        ({"formation": {"rings": [{"craft": 6, "size": 90}]}}, "give it a time"),
    ],
)
def test_waypoints_that_make_no_sense_are_refused(waypoint, said):
    fields = {k: v for k, v in document_of(SWARM).items() if k != "schema"}
    with pytest.raises(InputError, match=said):
        scenario_from(fields | {"waypoints": [waypoint]}, "")


def test_waypoints_out_of_order_or_with_too_many_choices_are_refused():
    late, early = replace(BETWEEN[0], time=840.0), replace(BETWEEN[0], time=360.0)
    with pytest.raises(InputError, match="not in the order of their times"):
        with_waypoints(late, early)
    many = replace(SWARM, problem=replace(PROBLEM, nodes=101))
    two = [replace(BETWEEN[0], time=None)] * 2
    with pytest.raises(InputError, match="give some a time"):
        replace(many, waypoints=tuple(two))


def test_no_choice_of_open_times_is_left_out_before_a_time_that_is_given():
    """Three nodes below the tenth of 1,249, by combinatorics; and too many where none is given."""
    long, place = Problem(nodes=1250, time_step=10.0), (0.0, 300.0, 0.0)
    open_times = [Waypoint(0, place)] * 3
    found = node_choices([*open_times, Waypoint(0, place, time=100.0)], long)
    assert sorted(found) == [(*some, 10) for some in combinations(range(1, 10), 3)]
    assert len(node_choices(open_times, long)) > MOST_CHOICES
    assert node_choices([*open_times, Waypoint(0, place, time=20.0)], long) == []
