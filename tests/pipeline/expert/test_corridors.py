"""Keep-in boxes and approach cones: craft are inside of them at all times that count, proven."""

from dataclasses import replace

import numpy as np
import pytest
from judge import Case, exact_step, judge_plan, least_inside
from judge.fuel import least_fuel_inside
from scipy.optimize import linprog

import prolearn
from cli.plan_table import MISSING, plan_cells
from pipeline.errors import InputError
from pipeline.expert.batch import Batch
from pipeline.orbit.corridors import Box, Cone, Corridor, Faces, margins
from pipeline.orbit.participants import Obstacle
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.orbit.thrust import Thrust
from pipeline.orbit.transfer import track
from pipeline.plan.document import plan_document, read_plan, write_plan
from pipeline.plan.plan import Plan, summary
from pipeline.plan.recheck import recheck
from pipeline.plan.requirements import AT_ALL_TIMES, Requirements, RiskLimit
from pipeline.planners.named import named_planner
from pipeline.scenario import Scenario, diagnostics
from pipeline.scenario.document import document_of
from pipeline.scenario.spacecraft import Spacecraft
from pipeline.scenario.waypoint import Waypoint
from pipeline.show import page
from pipeline.show.tables import certificate_rows

BOX = Corridor(Box((-30.0, -400.0, -20.0), (30.0, 0.0, 20.0)), 0.0, 1200.0)
CONE = Corridor(Cone((0.0, 0.0, 0.0), (0.0, -1.0, 0.0), 10.0), 600.0, 1200.0, (0,))
TARGET = Obstacle("target", (0.0,) * 6, radius=20.0, hold=True)
FAR = np.array([[0.0, -300, 0, 0, 0, 0], [0.0, -360, 0, 0, 0, 0]])
NEAR = np.array([[0.0, -40, 0, 0, 0, 0], [0.0, -300, 0, 0, 0, 0]])

KINDS = {
    "a box": {"corridors": (BOX,)},
    "a cone at the end": {"corridors": (CONE,)},
    "both and a target": {"corridors": (BOX, CONE), "obstacles": (TARGET,)},
    "a box between nodes": {"corridors": (replace(BOX, begin=250.0, end=590.0),)},
    "a box at one time": {"corridors": (replace(BOX, begin=500.0, end=500.0),)},
}


def approach(craft: int = 2, **own) -> Scenario:
    return Scenario(Problem(), FAR[:craft], NEAR[:craft], **own)


def planned(scenario: Scenario, requirements=AT_ALL_TIMES, name: str = "expert") -> Plan:
    planner = named_planner(name, requirements)
    assert planner is not None
    return planner.plan([scenario])[0]


def inside(plan: Plan) -> float:
    document = document_of(plan.scenario)
    return least_inside(document, Case.of(document), plan.states, plan.controls)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("craft", [1, 2])
def test_plans_stay_inside_as_an_independent_judge_finds(kind, craft):
    bare = planned(approach(craft))
    asked = approach(craft, **KINDS[kind])
    assert inside(replace(bare, scenario=asked)) < 0  # it matters

    plan = planned(asked)
    assert plan.status == "solved", plan.message
    assert judge_plan(document_of(asked), plan_document(plan)).wrong == ()
    found, truth = plan.certificate.corridor, inside(plan)
    assert found is not None
    assert 0 < found.min_margin_bound <= found.min_margin
    assert found.min_margin_bound <= truth + 1e-12  # rounding, which differs between processors
    if "cone" not in kind and "both" not in kind:  # for a pyramid is inside of its cone
        assert found.min_margin == pytest.approx(truth, abs=2e-4)
    found = plan.certificate
    assert ("left out" in found.fuel_lower_bound_proof) == ("obstacles" in KINDS[kind])
    assert found.optimality_gap < 0.02


def test_one_craft_in_a_box_burns_hardly_more_than_the_linear_program_of_it():
    asked = approach(1, corridors=(BOX,))
    case = Case.of(document_of(asked))
    rows, most = [], []
    intervals, parts = case.nodes - 1, 20
    # Positions at many times as maps of all controls, by the matrix exponential.
    free, pushed = np.eye(6), np.zeros((6, 3 * intervals))
    low, high = np.array(BOX.inside.min), np.array(BOX.inside.max)
    for k in range(intervals):
        for part in range(parts):
            A, B = exact_step(case.rate, case.step * (part + 1) / parts)
            one = A @ pushed
            one[:, 3 * k : 3 * k + 3] += B
            rest = (A @ free @ asked.initial[0])[:3]
            rows += [one[:3], -one[:3]]
            most += [high - rest, rest - low]
        free, pushed = A @ free, one
    both = np.concatenate(rows[:-2]), np.concatenate(most[:-2])  # the last are the goal's
    unit = 1e-3
    equal = np.hstack([pushed, -pushed]) * unit
    found = linprog(
        np.ones(6 * intervals),
        A_ub=np.hstack([both[0], -both[0]]) * unit,
        b_ub=both[1],
        A_eq=equal,
        b_eq=asked.goal[0] - free @ asked.initial[0],
    )
    assert found.status == 0
    made = planned(asked).certificate
    assert unit * found.fun <= made.fuel * (1 + 1e-6)
    assert made.fuel <= 1.01 * unit * found.fun  # with the margin, at all times
    assert made.fuel_lower_bound == pytest.approx(unit * found.fun, rel=1e-4)


def test_margins_are_proven_about_an_eccentric_orbit_and_in_long_intervals():
    orbit = ReferenceOrbit(8e6, eccentricity=0.15, inclination_deg=60.0)
    problem = replace(Problem(), time_step=900.0, nodes=5).about(orbit)
    asked = Scenario(problem, FAR, NEAR, ends="any", corridors=(replace(BOX, end=3600.0),))
    plan = planned(replace(asked, corridors=()))
    faces = Faces.of(asked.corridors, 2)
    found = margins(plan.states, plan.controls, problem, faces)
    places = track(plan.states, plan.controls, problem, 3000)
    for k in range(len(found)):
        normal, offset = faces.normal[found.face[k]], faces.offset[found.face[k]]
        flown = places[faces.craft[found.face[k]]][3000 * found.interval[k] :][:3001]
        truth = float((offset - flown @ normal).min())
        assert found.bound[k] <= truth + 1e-9
        assert found.margin[k] == pytest.approx(truth, abs=1e-2)
        assert found.margin[k] - found.bound[k] < 1e-4


def test_a_cone_is_a_pyramid_that_is_inside_of_it_and_nearly_as_wide():
    cone = Cone((1.0, 2.0, 3.0), (1.0, -2.0, 0.5), 25.0)
    normal, offset = cone.faces
    axis = np.array(cone.axis) / np.linalg.norm(cone.axis)
    points = np.random.default_rng(0).normal(size=(4000, 3)) + 2 * axis + cone.apex
    within = (points @ normal.T <= offset).all(axis=1)
    tilt = np.arccos((points - cone.apex) @ axis / np.linalg.norm(points - cone.apex, axis=1))
    assert (np.rad2deg(tilt[within]) <= 25.0).all()
    assert within[np.rad2deg(tilt) < 24.5].all()
    for length in (1e300, 1e-300):
        scaled = Cone(cone.apex, tuple(length * one for one in cone.axis), 25.0)
        assert np.allclose(scaled.faces[0], normal, rtol=0, atol=1e-14)


@pytest.mark.parametrize("name", ["refiner", "minimum-energy"])
def test_other_planners_are_judged_by_them_and_the_expert_follows_the_refiner(name):
    plan = planned(approach(corridors=(BOX,)), name=name)
    assert (plan.status == "solved") == (inside(plan) > 0)
    if name == "refiner":
        assert plan.status == "solved"
    else:
        assert plan.status == "unsafe"
        assert "outside corridors[0], the box from" in plan.message


def test_ends_outside_are_infeasible_and_the_check_names_them():
    asked = approach(corridors=(replace(CONE, craft=()),), obstacles=(TARGET,))
    asked = replace(asked, goal=asked.goal + np.array([0, 200, 0, 0, 0, 0]))
    (found,) = (one for one in diagnostics(asked) if one.rule == "inside corridors")
    assert {case.craft for case in found.cases} == {(0,)}
    assert "goal[0] is" in found.cases[0].text
    plan = planned(asked)
    assert plan.status == "infeasible"
    assert "outside corridors[0], the cone from" in plan.message
    assert next(
        one for one in diagnostics(approach(corridors=(BOX,))) if one.rule == "inside corridors"
    ).fine


def test_an_end_outside_several_faces_of_a_corridor_is_one_case_by_the_furthest():
    """Behind a cone's apex it is outside all faces, and beyond a box's corner outside three."""
    box = replace(BOX, begin=1200.0)
    asked = replace(approach(1, corridors=(box, replace(CONE, craft=()))), goal=FAR[:1] * -1)
    asked = replace(asked, goal=asked.goal + np.array([50.0, 0, 31, 0, 0, 0]))
    (found,) = (one for one in diagnostics(asked) if one.rule == "inside corridors")
    texts = [case.text for case in found.cases]
    assert len(texts) == 2
    assert "goal[0] is 300 m outside corridors[0]" in texts[0]
    assert "outside corridors[1]" in texts[1]
    assert found.text.endswith(": 2")
    assert "is 300 m outside corridors[0]" in planned(asked).message


@pytest.mark.parametrize("limit", [1e-3, 0.01, 0.02, 0.1])
def test_a_corridor_that_cannot_be_kept_within_the_limit_of_thrust_is_proven_infeasible(limit):
    """As a linear program by HiGHS says, which is inside at 20 times in an interval."""
    narrow = Corridor(Box((-1.0, -400.0, -1.0), (1.0, -290.0, 1.0)), 0.0, 1080.0)
    free = replace(approach(1), problem=Problem(max_acceleration=limit))
    asked = replace(free, corridors=(narrow,))
    document = document_of(asked)
    possible = np.isfinite(
        least_fuel_inside(document, Case.of(document, 1), asked.initial, asked.goal)
    )
    plan = planned(asked)
    assert planned(free).status == "solved"
    assert plan.status == ("solved" if possible.all() else "infeasible")
    if not possible.all():
        reason = "craft 0 cannot reach its goal inside its corridors within max_acceleration, which"
        assert plan.message.startswith(reason)


def test_a_corridor_that_no_thrust_keeps_is_proven_infeasible():
    """A burn in which the craft turns back within the box leads out of it before; by HiGHS."""
    begin, goal = np.array([[0.0, 0, 0, 0.2, 0, 0]]), np.array([[0.0, 40, 0, 0, 0, 0]])
    for edge, status in ((2.0, "infeasible"), (60.0, "solved")):
        box = Corridor(Box((-60.0, -60.0, -60.0), (edge, 60.0, 60.0)), 0.0, 1200.0)
        asked = Scenario(Problem(), begin, goal, ends="any", corridors=(box,))
        document = document_of(asked)
        least = least_fuel_inside(document, Case.of(document, 1), begin, goal)
        plan = planned(asked)
        assert np.isinf(least).all() == (status == "infeasible")
        assert plan.status == status
        if status == "infeasible":
            assert "inside its corridors with any thrust, however large" in plan.message


def test_windows_without_burns_in_which_a_craft_drifts_out_of_its_corridor_leave_no_plan():
    still = replace(approach(1, corridors=(BOX,)), problem=Problem(thrust=Thrust("norm")))
    begin = still.initial + np.array([0.0, 0, 0, 0.05, 0, 0])  # 30 m in ten minutes
    for window, status in (((0.0, 700.0), "infeasible"), ((0.0, 240.0), "solved")):
        problem = Problem(thrust=Thrust("norm", no_burn=(window,)))
        plan = planned(replace(still, problem=problem, initial=begin, ends="any"))
        assert plan.status == status, plan.message


def test_plans_that_leave_a_corridor_may_burn_less_than_the_bound_and_claim_it_rightly():
    plan = planned(approach(1, corridors=(BOX,)), name="decoupled-optimum")
    found, safe = plan.certificate, planned(approach(1, corridors=(BOX,))).certificate
    assert plan.status == "unsafe"
    assert found.fuel < found.fuel_lower_bound == safe.fuel_lower_bound
    assert not any("fuel_lower_bound" in one for one in recheck(plan).faults)
    assert "gap" not in repr(plan)
    assert dict(certificate_rows(plan, plan.status))["Gap to that bound"].startswith("none: all")
    assert plan_cells(summary(plan))[3] == MISSING
    claim = replace(safe, fuel_lower_bound=1.01 * safe.fuel)
    forged = replace(planned(approach(1, corridors=(BOX,))), certificate=claim)
    assert any("fuel_lower_bound" in one for one in recheck(forged).faults)


def test_less_delta_v_than_a_corridor_takes_is_proven_infeasible():
    asked = approach(1, corridors=(BOX,))
    document = document_of(asked)
    least = least_fuel_inside(document, Case.of(document, 1), asked.initial, asked.goal)
    needed = asked.problem.time_step * float(least[0])
    for share, status in ((0.999, "infeasible"), (1.01, "solved")):
        plan = planned(replace(asked, craft=(Spacecraft(delta_v=share * needed),)))
        assert plan.status == status
        assert ("inside its corridors" in plan.message) == (status == "infeasible")


def least_by_open_times(asked: Scenario) -> np.ndarray:
    """Least fuel of the first craft inside its corridors, m/s², by the node of its waypoint."""
    found, (by,), problem = [], asked.waypoints, asked.problem
    for node in range(1, problem.intervals):
        timed = replace(asked, waypoints=(replace(by, time=node * problem.time_step),))
        document = document_of(timed)
        case = Case.of(document, asked.n)
        found.append(least_fuel_inside(document, case, asked.initial, asked.goal)[0])
    return np.array(found)


def test_where_times_of_waypoints_are_open_the_bound_is_the_least_of_all_times():
    """Times that are cheapest without the corridor are not with it."""
    asked = approach(1, corridors=(BOX,), waypoints=(Waypoint(0, (-25.0, -60.0, -15.0)),))
    plan, bare = planned(asked), planned(replace(asked, corridors=()))
    least, found = least_by_open_times(asked), plan.certificate
    assert found.fuel_lower_bound == pytest.approx(least.min(), rel=1e-4)
    assert plan.status == "solved" and found.optimality_gap < 0.01
    assert "left out" not in found.fuel_lower_bound_proof
    cheapest = round(found_time(bare) / asked.problem.time_step) - 1
    assert least[cheapest] > 1.05 * least.min()
    still = np.array([[0.0, 900.0, 0, 0, 0, 0]])  # another craft, in a corridor of its own
    two = Scenario(
        asked.problem,
        np.concatenate([asked.initial, still]),
        np.concatenate([asked.goal, still]),
        waypoints=asked.waypoints,
        corridors=(
            replace(BOX, craft=(0,)),
            Corridor(Box((-30.0, 800.0, -20.0), (30.0, 1000.0, 20.0)), 0.0, 1200.0, (1,)),
        ),
    )
    assert planned(two).certificate.fuel_lower_bound == pytest.approx(least.min(), rel=1e-4)


def test_a_waypoint_by_no_time_inside_a_corridor_leaves_no_plan():
    """At the wall, from which the craft comes back too late; without the corridor it does."""
    low = replace(approach(1, corridors=(BOX,)), problem=Problem(max_acceleration=2e-3))
    for place, status in ((-250.0, "solved"), (-395.0, "infeasible")):
        asked = replace(low, waypoints=(Waypoint(0, (0.0, place, 0.0)),))
        plan = planned(asked)
        assert np.isfinite(least_by_open_times(asked)).any() == (status == "solved")
        assert plan.status == status, plan.message
    assert planned(replace(asked, corridors=())).status == "solved"
    assert "by its waypoints inside its corridors within its limits" in plan.message


def test_some_of_the_craft_alone_need_what_they_need_beside_the_others():
    """Each has limits, a waypoint and corridors of its own, and one that is of all."""
    states = [
        np.array([[0.0, y, 0, 0, 0, 0] for y in ys]) for ys in ((-300, -360, -99), (-40,) * 3)
    ]
    strong, weak = Spacecraft(max_acceleration=4e-3), Spacecraft(max_acceleration=3e-3)
    all_three = Scenario(
        Problem(),
        states[0],
        states[1] + 99 * np.eye(6)[[0, 2, 0]] * [[1], [1], [-1]],
        ends="any",
        craft=(strong, weak, Spacecraft()),
        waypoints=(Waypoint(0, (9.0, -200.0, 0.0)), Waypoint(2, (0.0, -60.0, 9.0), None, 360.0)),
        corridors=(
            Corridor(Box((-10.0, -400.0, -10.0), (10.0, 0.0, 10.0)), 0.0, 700.0, (0,)),
            Corridor(Box((-10.0, -120.0, -10.0), (10.0, 0.0, 10.0)), 0.0, 700.0, (2,)),
            Corridor(Box((-102.0, -400.0, -102.0), (102.0, 0.0, 102.0)), 0.0, 1200.0),
        ),
    )
    some = [2, 0]
    alone, beside = (Batch([one]).optima for one in (all_three.only(some), all_three))
    np.testing.assert_allclose(alone.lower_bound, beside.lower_bound[some], rtol=1e-6)
    free = Batch([replace(all_three, corridors=())]).optima.lower_bound[some]
    assert (alone.lower_bound > 1.001 * free).all()


def found_time(plan: Plan) -> float:
    """The time of the node at which a plan passes its only waypoint, s."""
    place = plan.scenario.waypoints[0].position
    node = int(np.linalg.norm(plan.states[0, :, :3] - place, axis=1).argmin())
    return node * plan.scenario.problem.time_step


def test_files_keep_corridors_and_false_margins_are_found(tmp_path):
    plan = planned(approach(**KINDS["both and a target"]))
    write_plan(tmp_path / "p.json", plan)
    again = read_plan(tmp_path / "p.json")
    assert again.scenario.corridors == plan.scenario.corridors
    assert recheck(again).faults == ()
    claim = again.certificate.corridor
    assert claim is not None and claim == plan.certificate.corridor
    more = replace(claim, min_margin_bound=claim.min_margin_bound + 1)
    forged = replace(again, certificate=replace(again.certificate, corridor=more))
    assert any("corridor.min_margin_bound" in fault for fault in recheck(forged).faults)
    text, _ = page(plan, "approach")
    assert "Least distance inside of a corridor" in text
    assert "the cone from (0, 0, 0) m" in text


def test_what_does_not_count_them_refuses_them():
    asked = approach(corridors=(BOX,))
    with pytest.raises(InputError, match="a risk is asked for"):
        planned(asked, Requirements(risk=RiskLimit(1e-2, navigation_sigma=0.1)))


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Box((0.0, 0.0, 0.0), (1.0, 0.0, 1.0)), "expected less than max"),
        (lambda: Cone((0.0,) * 3, (0.0,) * 3, 10.0), "expected a direction"),
        (lambda: Cone((0.0,) * 3, (1.0, 0.0, 0.0), 90.0), "up to 89 deg"),
        (lambda: approach(corridors=(replace(BOX, end=1201.0),)), "from 0 to 1200 s"),
        (lambda: approach(corridors=(replace(BOX, begin=900.0, end=800.0),)), "not before"),
        (lambda: approach(corridors=(replace(BOX, craft=(2,)),)), "numbers from 0 to 1"),
        (lambda: approach(corridors=(replace(BOX, craft=(1,) * 5000),)), "0 to 1, each once"),
        (lambda: approach(corridors=(BOX,) * 20_000), "20000 corridors; expected at most 500"),
    ],
)
def test_what_is_no_corridor_is_refused_in_a_sentence(make, said):
    with pytest.raises(InputError, match=said):
        make()


@pytest.mark.parametrize("begin", [0.0, 700.4])
def test_a_corridor_up_to_the_end_may_end_a_rounding_error_after_it(begin):
    problem = Problem(time_step=700.4 / 10)
    assert problem.duration < 700.4
    to_the_end = replace(BOX, begin=begin, end=700.4)
    plan = planned(Scenario(problem, FAR[1:], NEAR[1:], corridors=(to_the_end,)))
    assert plan.status == "solved"
    assert inside(plan) > 0


def test_a_trade_off_keeps_corridors_and_refuses_those_beyond_a_shorter_transfer():
    early = approach(1, corridors=(replace(BOX, end=700.0),))
    points = prolearn.tradeoff(early, 960.0, 1200.0, steps=2)
    assert [point.safe for point in points] == [True, True]
    assert all(inside(point.plan) > 0 for point in points)
    with pytest.raises(InputError, match="waypoints and corridors take 1200 s"):
        prolearn.tradeoff(approach(1, corridors=(BOX,)), 960.0, 1200.0, steps=2)


def test_scenarios_made_in_python_have_them():
    made = prolearn.scenario(FAR.tolist(), NEAR.tolist(), corridors=[BOX, CONE])
    assert made.corridors == (BOX, CONE)
