"""Radii of craft, and obstacles that drift or are held: every planner keeps them, proven."""

import re
from dataclasses import replace

import numpy as np
import pytest
from judge import Case, after, judge_plan, least_adrift, least_clearance, obstacle_at, outside

import prolearn
from pipeline.errors import InputError
from pipeline.flight.world import Conditions, in_world
from pipeline.orbit.nonlinear import NonlinearFlight
from pipeline.orbit.participants import Obstacle, Participants
from pipeline.orbit.problem import Problem
from pipeline.plan.document import plan_document, read_plan, write_plan
from pipeline.plan.plan import Plan
from pipeline.plan.recheck import recheck
from pipeline.plan.requirements import AT_ALL_TIMES, Requirements, RiskLimit
from pipeline.planners.as_flown import AsFlown
from pipeline.planners.goal_assignment import GoalAssignment
from pipeline.planners.named import named_planner
from pipeline.scenario import Scenario, check, diagnostics, draw
from pipeline.scenario.document import document_of
from pipeline.scenario.spacecraft import Spacecraft
from pipeline.show import page
from pipeline.show.data import page_data

E = Problem.mean_motion
CHIEF = Obstacle("chief", (0.0,) * 6, radius=30.0)
DEBRIS = Obstacle("debris", (30.0, -80.0, 20.0, 0.0, -60 * E, 0.01), radius=10.0)
STATION = Obstacle(
    "station", (5.0, 20.0, -10.0, 0.0, 0.0, 0.0), semi_axes=(20.0, 60.0, 20.0), hold=True
)
RADII = tuple(Spacecraft(radius=r) for r in (3.0, 5.0, 7.5, 12.0, 3.0, 20.0))

KINDS = {
    "radii": {"craft": RADII},
    "a chief": {"obstacles": (CHIEF,)},
    "debris and a station": {"obstacles": (STATION, DEBRIS)},
    "all": {"craft": RADII, "obstacles": (STATION, DEBRIS)},
}


def swarm(index: int, **own) -> Scenario:
    return replace(draw("rings", index, 6, 0, Problem()), **own)


def planned(scenario: Scenario, requirements=AT_ALL_TIMES, name: str = "expert") -> Plan:
    planner = named_planner(name, requirements)
    assert planner is not None
    return planner.plan([scenario])[0]


def flown(plan: Plan):
    document = document_of(plan.scenario)
    return document, Case.of(document), plan.states, plan.controls


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("index", range(4))
def test_plans_keep_radii_and_obstacles_at_all_times_as_an_independent_judge_finds(kind, index):
    plan = planned(swarm(index, **KINDS[kind]))

    assert plan.status == "solved", plan.message
    assert judge_plan(document_of(plan.scenario), plan_document(plan)).wrong == ()
    found, truth = plan.certificate.clearance, least_clearance(*flown(plan))
    assert found is not None
    assert found.min_clearance_bound <= found.min_clearance
    # Spheres are exact; the ellipsoid that holds a craft of some radius off another is not.
    if (found.craft, found.other) == (truth.craft, truth.other) and found.other != "station":
        assert found.min_clearance == pytest.approx(truth.clearance, abs=2e-4)
        assert found.time == pytest.approx(truth.time, abs=0.5)
    assert found.min_clearance <= truth.clearance + 2e-4


def test_the_judge_finds_plans_without_obstacles_in_their_way():
    bare = planned(swarm(1))
    document = document_of(swarm(1, **KINDS["all"]))
    assert judge_plan(document, {"states": bare.states, "controls": bare.controls}).faults


@pytest.mark.parametrize("name", ["refiner", "minimum-energy", "straight-line"])
def test_other_planners_are_judged_by_them_and_the_expert_follows_the_refiner(name):
    plans = [planned(swarm(k, **KINDS["debris and a station"]), name=name) for k in (1, 2)]
    for plan in plans:
        truth = least_clearance(*flown(plan)).clearance
        clear = plan.certificate.clearance
        assert clear is not None
        assert (plan.status == "solved") == (clear.min_clearance_bound > 0)
        assert plan.status != "solved" or truth > 0
    if name == "refiner":
        assert {plan.status for plan in plans} == {"solved"}
        assert any("expert" in plan.planner or "one solve" in plan.planner for plan in plans)
    else:
        wrong = [plan for plan in plans if plan.status == "unsafe"]
        assert wrong
        assert all("too close to" in plan.message for plan in wrong)


def test_one_craft_alone_plans_around_a_chief_that_holds_its_place():
    ends = np.array([[[0.0, -200, 0, 0, 0, 0]], [[0.0, 200, 0, 0, 0, 0]]])
    about = Scenario(Problem(), *ends, obstacles=(replace(CHIEF, radius=90.0, hold=True),))
    plan = planned(about)
    assert plan.status == "solved", plan.message
    assert judge_plan(document_of(about), plan_document(plan)).wrong == ()
    assert plan.certificate.min_separation is None
    assert planned(replace(about, obstacles=())).certificate.fuel < plan.certificate.fuel
    assert plan.certificate.fuel_lower_bound <= plan.certificate.fuel


def test_a_held_obstacle_is_where_it_was_at_all_times_and_one_that_drifts_drifts_as_craft_do():
    held, free = replace(STATION, state=(40.0, 20.0, -30.0, 0.0, 0.0, 0.0)), DEBRIS
    problem = Problem()
    swarms = Participants(problem, [np.array([7.5])], [(held, free)])
    assert np.allclose(swarms.states[0, :, :3], held.state[:3], atol=1e-9)
    alone = fly_states(free, problem)
    assert np.allclose(swarms.states[1], alone, atol=1e-9)


def fly_states(obstacle: Obstacle, problem: Problem):
    from judge import fly

    document = {"mean_motion": E, "time_step": 120.0, "nodes": 11, "collision_radius": 15.0}
    return fly(Case.of(document), np.array([obstacle.state]), np.zeros((1, 10, 3)))[0]


def test_the_ellipsoid_asked_for_holds_all_points_within_the_radius_of_a_craft():
    # A larger semi-axis each would not: of (1, 10, 10) m and a craft of 3 m it lacks 0.7 m.
    rng = np.random.default_rng(0)
    for _ in range(20):
        axes, radius = rng.uniform(1, 60, 3), rng.uniform(0.5, 30)
        obstacle = Obstacle("it", (0.0,) * 6, semi_axes=tuple(axes.tolist()))
        swarms = Participants(Problem(), [np.array([radius])], [(obstacle,)])
        scale, beyond = swarms.separation_scaling(np.array([0]), np.array([1]))
        least = float(np.asarray(beyond)[0]) + 15.0
        assert scale is not None and scale.max() == 1
        for way in rng.normal(size=(40, 3)):
            point = way * least / np.linalg.norm(way * scale[0])
            assert outside(point, axes) >= radius - 1e-6


def test_equal_radii_of_half_the_collision_radius_are_the_default():
    a = swarm(0)
    same = replace(a, craft=tuple(Spacecraft(radius=7.5) for _ in range(6)))
    one, other = planned(a), planned(same)
    assert np.allclose(one.controls, other.controls, atol=1e-9)
    found = other.certificate
    assert found.clearance is not None and found.min_separation is not None
    assert found.clearance.min_clearance == pytest.approx(found.min_separation - 15, abs=1e-6)


PASSING = Scenario(
    Problem(),
    np.array([[0.0, -20, 0, 0, 0, 0], [0.0, -12, 0, 0, 0, 0]]),
    np.array([[0.0, 20, 0, 0, 0, 0], [0.0, 12, 0, 0, 0, 0]]),
)


@pytest.mark.parametrize("name", ["expert", "refiner"])
def test_small_radii_cost_what_a_small_collision_radius_does(name):
    """Radii of 2 m override a collision radius of 15 m: fuel is as with one of 4 m."""
    own = replace(PASSING, craft=(Spacecraft(radius=2.0),) * 2)
    same = replace(PASSING, problem=replace(PASSING.problem, collision_radius=4.0))
    by_radii, by_default = planned(own, name=name), planned(same, name=name)
    assert by_default.certificate.optimality_gap < 0.1
    assert by_radii.certificate.fuel == pytest.approx(by_default.certificate.fuel, rel=1e-3)
    assert by_radii.certificate.clearance.min_clearance_bound > 0


def test_a_small_craft_passes_a_small_obstacle_by_no_more_than_both_need():
    start, goal = PASSING.initial[:1] * 0.3, PASSING.goal[:1] * 0.3
    own = Scenario(Problem(), start, goal, obstacles=(Obstacle("t", (0.0,) * 6, radius=4.0),))
    own = replace(own, craft=(Spacecraft(radius=1.0),))
    same = replace(own, problem=replace(own.problem, collision_radius=2.0), craft=())
    fuel = planned(own).certificate.fuel
    assert fuel == pytest.approx(planned(same).certificate.fuel, rel=1e-3)


@pytest.mark.parametrize("kind", KINDS)
def test_after_a_loss_of_thrust_craft_keep_clear_of_obstacles_too(kind):
    asked = Requirements(passive_safety=0.5)
    plans = [planned(swarm(index, **KINDS[kind]), asked) for index in (0, 2)]
    for plan in plans[1:]:
        adrift = plan.certificate.passive_safety
        assert adrift is not None and adrift.clearance is not None
        truth = least_adrift(*flown(plan), 0.5)
        assert adrift.clearance.min_clearance <= truth + 1e-6
        if kind != "debris and a station":  # of which the ellipsoid is not exact
            assert truth - adrift.clearance.min_clearance < 0.5
        assert plan.status != "solved" or truth > 0
    assert any(plan.status == "solved" for plan in plans)


@pytest.mark.parametrize(("end", "begin"), [("start", 0.0), ("goal", Problem().duration)])
def test_what_meets_an_obstacle_adrift_from_an_end_is_infeasible_whatever_is_planned(end, begin):
    scenario = swarm(0)
    craft = getattr(scenario, "initial" if end == "start" else "goal")[2]
    met = after(E, 1000.0, craft, np.zeros(3)) + np.array([6.0, 0, 0, 0.3, 0.2, 0.4])
    state = after(E, -begin - 1000.0, met, np.zeros(3))
    scenario = replace(scenario, obstacles=(Obstacle("debris", tuple(state), radius=4.0),))

    plan = planned(scenario, Requirements(passive_safety=0.5))

    assert plan.status == "infeasible"
    said = rf"craft 2, adrift from its {end}, comes (\S+) m too close to debris at (\S+) s"
    found = re.match(said, plan.message)
    assert found, plan.message
    lack, time = map(float, found.groups())
    debris = obstacle_at({"state": state}, Case.of(document_of(scenario)), time)
    apart = after(E, time - begin, craft, np.zeros(3))[:3] - debris
    assert lack == pytest.approx(7.5 + 4.0 - np.linalg.norm(apart), abs=1e-3)
    assert planned(scenario).status == "solved"  # without a loss of thrust


def test_a_start_or_goal_inside_an_obstacle_is_infeasible():
    a = swarm(0)
    at_goal = Obstacle("debris", (*a.goal[2, :3].tolist(), 0.0, 0.0, 0.0), radius=5.0, hold=True)
    plan = planned(replace(a, obstacles=(at_goal,)))
    assert plan.status == "infeasible"
    assert re.search(r"craft 2 and debris are \S+ m apart at the goal", plan.message)
    assert "debris has a radius of 5 m" in plan.message


def test_plan_files_keep_them_and_are_rechecked_and_false_clearances_found(tmp_path):
    plan = planned(swarm(1, **KINDS["all"]))
    write_plan(tmp_path / "p.json", plan)
    again = read_plan(tmp_path / "p.json")
    assert again.scenario.obstacles == plan.scenario.obstacles
    assert again.scenario.craft == RADII
    assert recheck(again).faults == ()
    clear = again.certificate.clearance
    assert clear is not None and clear == plan.certificate.clearance
    more = replace(clear, min_clearance_bound=clear.min_clearance_bound + 1)
    forged = replace(again, certificate=replace(again.certificate, clearance=more))
    assert any("clearance.min_clearance_bound" in fault for fault in recheck(forged).faults)


def test_files_without_them_stay_as_they_were():
    document = plan_document(planned(swarm(0), Requirements(passive_safety=0.5)))
    assert "clearance" not in document["certificate"]
    assert "clearance" not in document["certificate"]["passive_safety"]
    assert "obstacles" not in document["scenario"]


def test_craft_that_may_take_each_others_goals_keep_clear_as_well():
    planner = named_planner("expert")
    assert planner is not None
    (plan,) = GoalAssignment(planner).plan([swarm(1, **KINDS["all"])])
    assert plan.status == "solved", plan.message
    assert least_clearance(*flown(plan)).clearance > 0


def test_scenarios_with_and_without_are_planned_side_by_side_as_alone():
    planner = named_planner("expert")
    assert planner is not None
    asked = [swarm(1, **KINDS["all"]), swarm(0), swarm(2, **KINDS["a chief"])]
    for plan, one in zip(planner.plan(asked), asked, strict=True):
        assert plan.certificate.fuel == pytest.approx(planned(one).certificate.fuel, rel=1e-6)
        assert (plan.certificate.clearance is None) == (not one.unlike)
        assert plan.status == "solved"


def test_as_flown_about_an_oblate_earth_they_are_kept_in_the_nonlinear_flight():
    conditions = Conditions(eccentricity=0.002)
    asked = in_world(swarm(1, craft=RADII, obstacles=(CHIEF, DEBRIS)), conditions)
    planner = named_planner("expert")
    assert planner is not None
    (plan,) = AsFlown(planner).plan([asked])
    assert plan.status == "solved", plan.message
    problem, clear = plan.scenario.problem, plan.certificate.clearance
    assert clear is not None
    # The obstacles, flown as craft that do not burn, and the craft, at Chebyshev nodes and between.
    time = np.tile(np.linspace(0, problem.time_step, 200), (problem.intervals, 1))
    flight = NonlinearFlight(asked.initial, plan.controls, problem)
    craft = flight.between(time)[..., :3]
    idle = np.zeros((1, problem.intervals, 3))
    least = np.inf
    for one in asked.obstacles:
        path = NonlinearFlight(np.array([one.state]), idle, problem).between(time)[..., :3]
        apart = np.linalg.norm(craft - path, axis=-1).min(axis=(1, 2))
        least = min(least, float((apart - one.axes[0] - asked.radii).min()))
    i, j = np.triu_indices(6, 1)
    apart = np.linalg.norm(craft[i] - craft[j], axis=-1).min(axis=(1, 2))
    least = min(least, float((apart - asked.radii[i] - asked.radii[j]).min()))
    assert clear.min_clearance_bound <= least
    assert clear.min_clearance == pytest.approx(least, abs=0.05)
    assert flight.states.shape == plan.states.shape


def test_as_flown_refuses_what_it_does_not_prove():
    planner = named_planner("expert", Requirements("nodes"))
    assert planner is not None
    with pytest.raises(InputError, match="as flown"):
        AsFlown(planner).plan([in_world(swarm(0, obstacles=(CHIEF,)), Conditions())])


def test_a_risk_is_refused_with_them():
    limit = RiskLimit(1e-2, navigation_sigma=0.1)
    for name in ("expert", "minimum-energy"):
        with pytest.raises(InputError, match="a risk is asked for"):
            planned(swarm(0, obstacles=(CHIEF,)), Requirements(risk=limit), name)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"radius": 5.0, "semi_axes": (1.0, 1.0, 1.0)}, "one of radius and semi_axes"),
        ({}, "one of radius and semi_axes"),
        ({"radius": -1.0}, "size of obstacle 'it'"),
        (
            {"radius": 1.0, "state": (0.0,) * 5},
            r"state of obstacle 'it' is .*; expected 6 finite numbers",
        ),
        (
            {"radius": 1.0, "hold": True, "state": (0.0, 0.0, 0.0, 0.0, 1.0, 0.0)},
            "held and has a velocity",
        ),
    ],
)
def test_what_is_no_obstacle_is_refused_in_a_sentence(given, said):
    with pytest.raises(InputError, match=said):
        Obstacle(**{"name": "it", "state": (0.0,) * 6, **given})


@pytest.mark.parametrize("state", [(1e300, *(0.0,) * 5), (*(0.0,) * 3, 1e300, 0.0, 0.0)])
def test_an_obstacle_that_the_linear_model_knows_nothing_of_is_refused(state):
    with pytest.raises(InputError, match=r"obstacle 'far' reaches .*e\+300 m.*expected positions"):
        swarm(0, obstacles=(Obstacle("far", state, 1.0),))


def test_obstacles_need_names_of_their_own_and_a_circle_to_be_held_about():
    with pytest.raises(InputError, match="no name or one that another has"):
        swarm(0, obstacles=(CHIEF, CHIEF))
    held = in_world(swarm(0, obstacles=(replace(CHIEF, hold=True),)), Conditions())
    assert held.obstacles[0].hold  # at the origin it may be
    with pytest.raises(InputError, match="held away from the origin"):
        in_world(swarm(0, obstacles=(STATION,)), Conditions())
    with pytest.raises(InputError, match="at most 500"):
        many = np.zeros((501, 6)) + np.arange(501)[:, None] * [0, 40, 0, 0, 0, 0]
        Scenario(Problem(), many, many, obstacles=(CHIEF,))


def test_a_check_names_craft_inside_an_obstacle_and_those_that_drift_into_one():
    a = swarm(0)
    at_goal = Obstacle("debris", (*a.goal[2, :3].tolist(), 0.0, 0.0, 0.0), radius=5.0, hold=True)
    asked = replace(a, obstacles=(at_goal,), craft=RADII)
    found = {(one.end, one.rule): one for one in diagnostics(asked)}
    apart = found["goal", "craft apart"]
    assert [case.craft for case in apart.cases] == [(2, 6)]
    assert "goal[2] and debris are" in apart.cases[0].text
    assert found["initial", "craft apart"].fine
    with pytest.raises(InputError, match=r"their sizes: craft 2 has a radius of 7.5 m, debris has"):
        check(asked)
    # It is drifted into from elsewhere as well: where by the matrix exponential it is.
    drift = found["goal", "passively safe"]
    times = np.linspace(0, 2 * np.pi / E, 4001)
    case = Case.of(document_of(a))
    met = set()
    for t in times:
        there = after(case.rate, float(t), a.goal, np.zeros(3))[:, :3]
        near = np.linalg.norm(there - at_goal.state[:3], axis=1) <= asked.radii + 5.0
        met |= set(np.flatnonzero(near).tolist())
    assert {one.craft[0] for one in drift.cases if one.craft[1] == 6} == met


def test_a_trade_off_keeps_them():
    points = prolearn.tradeoff(swarm(1, **KINDS["all"]), 960.0, 1440.0, steps=2)
    assert [point.safe for point in points] == [True, True]
    for point in points:
        assert least_clearance(*flown(point.plan)).clearance > 0


def test_the_page_shows_them_and_says_what_is_proven():
    plan = planned(swarm(1, **KINDS["all"]))
    text, shown = page(plan, "swarm")
    assert shown.faults == ()
    clear = plan.certificate.clearance
    assert clear is not None
    assert f"{clear.min_clearance:.4f} m further apart than their sizes ask for" in text
    assert "debris has a radius of 10 m, drifts" in text
    data, _ = page_data(plan)
    document = document_of(plan.scenario)
    for one, given in zip(data["obstacles"], document["obstacles"], strict=True):
        for k in (0, 40, len(data["times"]) - 1):
            truth = obstacle_at(given, Case.of(document), data["times"][k])
            assert np.allclose(np.array(one["track"][k]) / 100, truth, atol=0.006)
    assert data["radii"] == [one.radius for one in RADII]


def test_a_page_of_one_craft_and_a_chief_says_how_close_they_come():
    ends = np.array([[[0.0, -200, 0, 0, 0, 0]], [[0.0, 200, 0, 0, 0, 0]]])
    text, _ = page(planned(Scenario(Problem(), *ends, obstacles=(CHIEF,))), "one")
    assert "Craft 0 and chief come closest" in text


def test_scenarios_made_in_python_have_them():
    rings = [prolearn.Ring(craft=3, size=200, tilt_deg=20)]
    made = prolearn.scenario(rings, rings, craft=RADII[:3], obstacles=[CHIEF])
    assert (made.craft, made.obstacles) == (RADII[:3], (CHIEF,))
