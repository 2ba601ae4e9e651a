"""Waypoints, corridors and obstacles of plans as flown, flown again by an integrator."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from relative import file_flown, linear_flight, pull
from scipy.optimize import linprog

from pipeline.orbit.corridors import Box, Cone, Corridor
from pipeline.orbit.nonlinear import NonlinearFlight
from pipeline.orbit.participants import Obstacle
from pipeline.orbit.partition import pairs
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import R_EARTH
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.orbit.thrust import Thrust
from pipeline.plan.document import plan_document, read_plan, write_plan
from pipeline.plan.plan import SOLVED, UNSAFE
from pipeline.plan.recheck import recheck
from pipeline.plan.requirements import Requirements
from pipeline.planners.as_flown import AsFlown
from pipeline.planners.goal_assignment import GoalAssignment
from pipeline.planners.named import named_planner
from pipeline.scenario import Scenario, draw
from pipeline.scenario.waypoint import Waypoint

PARTS = 40
"""Looks at each interval: every 3 s."""

DRAWN = draw("rings", 1, 6, 0, Problem())
SAILS = {"ballistic": 3.0, "spread": 0.9}


def about(e, **changed):
    """An orbit with its perigee 500 km above an oblate Earth, shortly before that."""
    return ReferenceOrbit((R_EARTH + 500e3) / (1 - e), e, 51.6, 40.0, 30.0, 10.0, **changed)


def between(size=1.0, time=600.0, velocity=None):
    """A waypoint of each craft, beyond where the next one starts."""
    places = 1.5 * size * np.roll(DRAWN.initial[:, :3], -1, axis=0)
    return tuple(Waypoint(k, tuple(one), velocity, time) for k, one in enumerate(places.tolist()))


def rings(e, waypoints, size=1.0, thrust=None, **changed):
    """Six craft on rings so many times as large, with waypoints."""
    problem = replace(Problem(), collision_radius=15.0 * size).about(about(e, **changed))
    problem = replace(problem, thrust=thrust or problem.thrust)
    ends = {end: size * getattr(DRAWN, end) for end in ("initial", "goal")}
    return replace(DRAWN, problem=problem, waypoints=waypoints, **ends)


TWO = (Waypoint(0, (300.0, 500.0, 0.0)), Waypoint(0, (10.0, 300.0, 0.0), None, 840.0))

MISSIONS = {
    "given times": rings(0.01, between()),
    "open times": rings(0.01, between(time=None)),
    "one open before a given": rings(0.3, TWO),
    "a formation, with velocities": rings(0.5, between(10.0, 360.0, (0.1, -0.2, 0.05)), 10.0),
    "pointed thrusters": rings(0.01, between(), thrust=Thrust("norm")),
    "sails": rings(0.01, between(time=None), **SAILS),
}


@cache
def expert():
    return named_planner("expert")


@cache
def planned(name, planner="expert"):
    return AsFlown(named_planner(planner)).plan([MISSIONS[name]])[0]


def missed(plan, flown):
    """By how much a flight misses waypoints at the nodes nearest to them, in their order."""
    nodes, worst = {}, [0.0, 0.0]
    for one in plan.scenario.waypoints:
        ends = flown[one.craft, :, -1]  # at the nodes from the first on
        off = np.linalg.norm(ends[:, :3] - one.position, axis=1)
        off[: nodes.get(one.craft, 0)] = np.inf
        node = int(off.argmin()) if one.time is None else round(one.time / 120.0) - 1
        nodes[one.craft] = node + 1
        worst[0] = max(worst[0], off[node])
        if one.velocity is not None:
            worst[1] = max(worst[1], float(np.abs(ends[node, 3:] - one.velocity).max()))
    return worst


@pytest.mark.parametrize("name", MISSIONS)
def test_an_integrator_passes_every_waypoint_and_meets_the_goals(name):
    plan = planned(name)
    assert plan.status == SOLVED, plan.message
    flown = file_flown(plan_document(plan), PARTS, plan.scenario.problem.orbit.air and AIR)
    off = missed(plan, flown)
    assert off[0] < 1e-5 and off[1] < 1e-8
    assert plan.certificate.waypoint_error < 1e-6
    assert plan.certificate.waypoint_velocity_error < 1e-9
    miss = np.abs(flown[:, -1, -1] - plan.scenario.goal)
    assert miss[:, :3].max() < 1e-5 and miss[:, 3:].max() < 1e-8
    i, j = pairs(6)
    apart = np.linalg.norm((flown[i] - flown[j])[..., :3], axis=-1).min()
    assert apart > plan.scenario.problem.collision_radius
    assert apart >= plan.certificate.min_separation_bound - 1e-6
    assert recheck(plan).faults == ()


AIR = (lambda air: (air.base, air.density, air.scale))(about(0.01, **SAILS).air)


@pytest.mark.parametrize("name", ["given times", "open times", "sails"])
def test_the_linear_plan_misses_them_in_flight_and_little_more_fuel_meets_them(name):
    """The sails by metres, as drag moves them where linear motion does not know it."""
    (linear,) = expert().plan([MISSIONS[name]])
    problem = MISSIONS[name].problem
    states = NonlinearFlight(linear.scenario.initial, linear.controls, problem).states
    astray = missed(linear, states[:, 1:, None])
    assert astray[0] > (1.0 if name == "sails" else 1e-3)
    found = planned(name).certificate
    assert -1e-9 <= found.optimality_gap < linear.certificate.optimality_gap + 1e-3
    assert found.fuel_lower_bound == pytest.approx(linear.certificate.fuel_lower_bound, rel=1e-2)


@pytest.mark.parametrize("name", ["given times", "one open before a given"])
def test_the_bound_is_that_of_linear_programs_by_highs_about_the_flight(name):
    """Least over all choices of open times; of what linear motion leaves out, at each node."""
    plan = planned(name)
    scenario, problem = plan.scenario, plan.scenario.problem
    begin, n = problem.orbit.states(np.zeros(1))[0], scenario.n
    many, intervals = 3 * problem.intervals, problem.intervals
    force = partial(pull, j2=True)
    linear = linear_flight(begin, problem.time_step, intervals, 1, force)
    units = np.eye(many).reshape(many, intervals, 3)
    reach = linear(np.zeros((many, 6)), units)[:, :, -1].transpose(1, 2, 0)  # nodes, 6, controls
    flown = file_flown(plan_document(plan), 1)[:, :, -1]
    weight = np.array([1, 1, 1, 1e3, 1e3, 1e3])

    def least(craft, passed):
        burned = plan.controls[craft].ravel()
        goal = scenario.goal[craft] - flown[craft, -1] + reach[-1] @ burned
        rows, wanted = [weight[:, None] * reach[-1]], [weight * goal]
        for node, place in passed:
            rows.append(reach[node - 1, :3])
            off = np.array(place) - flown[craft, node - 1, :3]
            wanted.append(off + reach[node - 1, :3] @ burned)
        maps = np.concatenate(rows) / 1e4
        equal = np.hstack([maps, -maps]), np.concatenate(wanted)
        found = linprog(np.ones(2 * many), A_eq=equal[0], b_eq=equal[1], bounds=(0, None))
        return found.fun / 1e4 if found.status == 0 else np.inf

    total = 0.0
    for k in range(n):
        mine = [one for one in scenario.waypoints if one.craft == k]
        ways = [[(5, mine[0].position)]] if name == "given times" else [[]]
        if mine and name != "given times":
            ways = [[(a, TWO[0].position), (7, TWO[1].position)] for a in range(1, 7)]
        total += min(least(k, way) for way in ways)
    assert plan.certificate.fuel_lower_bound == pytest.approx(total, rel=1e-5)
    assert plan.certificate.fuel >= total * (1 - 1e-6)


def test_a_baseline_flies_past_them_and_is_unsafe_as_in_linear_motion():
    plan = planned("given times", "minimum-energy")
    assert plan.status == UNSAFE
    off, _ = missed(plan, file_flown(plan_document(plan), 1))
    assert plan.certificate.waypoint_error == pytest.approx(off, rel=0.5)
    assert plan.certificate.goal_error < 1e-6
    assert "misses a waypoint by" in plan.message


def test_goals_are_assigned_after_waypoints():
    (plan,) = AsFlown(GoalAssignment(expert())).plan([MISSIONS["open times"]])
    assert plan.status == SOLVED
    assert missed(plan, file_flown(plan_document(plan), 1))[0] < 1e-5
    assert plan.certificate.fuel <= planned("open times").certificate.fuel
    assert plan.certificate.fuel_lower_bound <= plan.certificate.fuel * (1 + 1e-6)


def test_the_refiner_has_the_expert_pass_them_and_files_say_by_how_much_they_are_missed(tmp_path):
    plan = planned("given times", "refiner")
    assert missed(plan, file_flown(plan_document(plan), 1))[0] < 1e-5
    write_plan(tmp_path / "p.json", plan)
    again = read_plan(tmp_path / "p.json")
    assert again.certificate == plan.certificate
    assert recheck(again).faults == ()
    moved = replace(between()[0], position=(0.0, 500.0, 0.0))
    other = replace(again.scenario, waypoints=(moved,))
    assert any(
        "misses a waypoint" in one.lower() for one in recheck(replace(again, scenario=other)).faults
    )


FAR = np.array([[0.0, -300, 0, 0, 0, 0], [0.0, -360, 0, 0, 0, 0]])
NEAR = np.array([[0.0, -40, 0, 0, 0, 0], [0.0, -300, 0, 0, 0, 0]])


def approach(e, size=1.0, times=(0.0, 1200.0), **changed):
    """Two craft that come nearer within a box, and the first in a cone at the end."""
    problem = Problem().about(about(e, **changed))
    box = Box((-3.0 * size, -400.0 * size, -2.0 * size), (3.0 * size, 0.0, 2.0 * size))
    cone = Cone((0.0, 0.0, 0.0), (0.0, -1.0, 0.0), 10.0)
    corridors = Corridor(box, *times), Corridor(cone, 600.0, 1200.0, (0,))
    return Scenario(problem, size * FAR, size * NEAR, ends="any", corridors=corridors)


def inside(plan, size):
    """Least distance inside of box and cone in a flight that is seen every second."""
    flown = file_flown(plan_document(plan), 120, plan.scenario.problem.orbit.air and AIR)
    time = 120.0 * np.arange(10)[:, None] + np.arange(121)
    box, cone = plan.scenario.corridors
    x, y, z = np.moveaxis(flown[..., :3], -1, 0)
    within = np.min([3 * size - abs(x), 2 * size - abs(z), -y, 400 * size + y], axis=0)
    tilt = np.deg2rad(10.0)
    from_edge = -y[0] * np.sin(tilt) - np.hypot(x[0], z[0]) * np.cos(tilt)
    counts = (box.begin <= time) & (time <= box.end)
    return within[:, counts].min(), from_edge[time >= cone.begin].min()


@pytest.mark.parametrize(
    ("e", "size", "more"),
    [
        (0.01, 1.0, {}),
        (0.3, 30.0, {}),
        (0.01, 1.0, {"times": (250.0, 590.0)}),
        (0.01, 10.0, SAILS),
    ],
    ids=["small", "kilometres", "between nodes", "sails"],
)
@pytest.mark.parametrize("requirements", [Requirements(), Requirements("nodes")], ids=str)
def test_corridors_hold_at_all_times_in_flight(e, size, more, requirements):
    asked = approach(e, size, **more)
    (plan,) = AsFlown(named_planner("expert", requirements)).plan([asked])
    assert plan.status == SOLVED, plan.message
    box, cone = inside(plan, size)
    found = plan.certificate.corridor
    assert 0 < found.min_margin_bound <= found.min_margin < found.min_margin_bound + 1e-3
    assert found.min_margin_bound <= min(box, cone)
    if found.corridor == 0:  # for a pyramid is inside of its cone
        assert found.min_margin == pytest.approx(box, abs=1e-3 * size)
    assert plan.certificate.fuel_lower_bound_proof.endswith(
        "program, about the flight, to first order"
    )
    assert plan.certificate.optimality_gap < 0.01
    assert recheck(plan).faults == ()


def test_the_bound_in_corridors_is_that_of_a_linear_program_about_the_flight():
    """By flights with each control a little changed, inside of the box at 20 times an interval.

    Craft 0 also in a pyramid inside of its cone, which costs some more than that of 16 sides.
    """
    (plan,) = AsFlown(expert()).plan([approach(0.3, 30.0)])
    box, document, step, parts = plan.scenario.corridors[0].inside, plan_document(plan), 1e-5, 20
    change = step * np.concatenate([np.zeros((1, 30)), np.eye(30)]).reshape(1, 31, 10, 3)
    document["controls"] = (plan.controls[:, None] + change).reshape(62, 10, 3)
    initial = np.repeat(plan.scenario.initial, 31, axis=0)
    document["scenario"] = {**document["scenario"], "initial": initial}
    flown = file_flown(document, parts)[:, :, :-1].reshape(2, 31, 10 * parts, 6)
    end = file_flown(document, 1)[:, -1, -1].reshape(2, 31, 6)
    least = 0.0
    for k in range(2):
        places = flown[k, 0, :, :3]
        reach = np.moveaxis(flown[k, 1:, :, :3] - places, 0, -1) / step  # (times, 3, controls)
        to_end = (end[k, 1:] - end[k, 0]).T / step
        normal = np.concatenate([np.eye(3), -np.eye(3)])
        faces = [(normal, np.array([*box.max, *(-one for one in box.min)]), slice(None))]
        if k == 0:
            turn = np.linspace(0, 2 * np.pi, 65)[:-1]
            around = np.stack([np.cos(turn), 0 * turn, np.sin(turn)], axis=1)
            wide = np.tan(np.deg2rad(10.0)) * np.cos(np.pi / 16) * np.cos(np.pi / 64)
            faces.append(
                (around + wide * np.array([0.0, 1.0, 0.0]), np.zeros(64), slice(100, None))
            )
        now = plan.controls[k].ravel()
        above, most = [], []
        for out, offset, when in faces:
            rows = np.einsum("fc,tcm->tfm", out, reach[when])
            above.append(rows.reshape(-1, 30))
            most.append((offset - places[when] @ out.T + rows @ now).ravel())
        above, most = np.concatenate(above), np.concatenate(most)
        size = np.repeat([1.0, 1200.0], 3)[:, None]
        found = linprog(
            np.ones(60),
            A_ub=np.hstack([above, -above]) * 1e-3,
            b_ub=most,
            A_eq=size * np.hstack([to_end, -to_end]) * 1e-3,
            b_eq=size[:, 0] * (to_end @ now),
        )
        assert found.status == 0
        least += 1e-3 * found.fun
    assert plan.certificate.fuel_lower_bound == pytest.approx(least, rel=2e-3)


@pytest.mark.parametrize("begin", [300.0, 371.0])
def test_the_bound_of_a_flight_counts_a_corridor_from_where_it_begins(begin):
    """Early, between nodes; the plan attains the bound but for its margin of 5 cm."""
    asked = replace(approach(0.01), waypoints=())
    low, high = (tuple((asked.goal[0, :3] + side).tolist()) for side in (-30.0, 30.0))
    near = Corridor(Box(low, high), begin, asked.problem.duration, (0,))
    (plan,) = AsFlown(expert()).plan([replace(asked, corridors=(near,))])
    (free,) = AsFlown(expert()).plan([replace(asked, corridors=())])
    assert plan.status == SOLVED, plan.message
    assert plan.certificate.fuel > 1.5 * free.certificate.fuel
    assert plan.certificate.optimality_gap < 1e-3


def test_where_times_of_waypoints_are_open_the_bound_of_a_flight_counts_corridors():
    """It is that for the times at which the waypoint is passed, which are the best."""
    asked = replace(approach(0.3, 30.0), waypoints=(Waypoint(0, (0.0, -6000.0, 0.0)),))
    (plan,) = AsFlown(expert()).plan([asked])
    assert plan.status == SOLVED, plan.message
    node = int(np.abs(plan.states[0, :, 1] + 6000.0).argmin())
    by = replace(asked.waypoints[0], time=node * asked.problem.time_step)
    (timed,) = AsFlown(expert()).plan([replace(asked, waypoints=(by,))])
    found, same = plan.certificate, timed.certificate
    assert found.fuel_lower_bound == pytest.approx(same.fuel_lower_bound, rel=1e-3)
    assert found.optimality_gap < 0.01
    assert found.fuel_lower_bound_proof.endswith("program, about the flight, to first order")


def test_where_goals_are_assigned_the_bound_of_a_flight_counts_corridors():
    asked = approach(0.3, 30.0)
    given = replace(asked, goal=asked.goal[::-1])
    (plan,) = AsFlown(GoalAssignment(expert())).plan([given])
    same, other = AsFlown(expert()).plan([plan.scenario, given])
    assert plan.status == SOLVED, plan.message
    found = plan.certificate.fuel_lower_bound
    assert found == pytest.approx(same.certificate.fuel_lower_bound, rel=1e-3)
    assert plan.certificate.optimality_gap < 0.01
    assert "left out" not in plan.certificate.fuel_lower_bound_proof
    assert plan.assignment.given_fuel_lower_bound == pytest.approx(
        other.certificate.fuel_lower_bound, rel=1e-2
    )


def test_where_the_linear_plan_leaves_its_corridor_in_flight_it_is_planned_again():
    """Sails, which drag moves by metres, of which linear motion knows nothing."""
    asked = approach(0.01, 10.0, **SAILS)
    (linear,) = expert().plan([asked])
    unaware = recheck(replace(linear, as_flown=True)).plan
    assert linear.certificate.corridor.min_margin > 0
    assert unaware.certificate.corridor.min_margin < -5.0
    assert unaware.certificate.corridor.min_margin == pytest.approx(
        inside(unaware, 10.0)[0], abs=0.05
    )
    (plan,) = AsFlown(expert()).plan([asked])
    assert plan.status == SOLVED
    assert plan.convex_solves > linear.convex_solves
    assert plan.certificate.fuel == pytest.approx(linear.certificate.fuel, rel=1e-2)


def test_a_false_margin_is_found_and_a_corridor_that_cannot_be_kept_is_named():
    (plan,) = AsFlown(expert()).plan([approach(0.01)])
    claim = replace(plan.certificate.corridor, min_margin_bound=1.0)
    forged = replace(plan, certificate=replace(plan.certificate, corridor=claim))
    assert any("corridor.min_margin_bound" in one for one in recheck(forged).faults)
    (straight,) = AsFlown(named_planner("minimum-energy")).plan([approach(0.01)])
    assert straight.status == UNSAFE
    assert "outside corridors[" in straight.message


@pytest.mark.parametrize("e", [0.01, 0.3])
def test_craft_that_lose_their_thrust_stay_clear_of_obstacles_as_the_certificate_says(e):
    """By brute force: each craft drifts from each node, and distances are sampled every 6 s."""
    problem, orbits, parts = Problem().about(about(e)), 0.1, 20
    target = Obstacle("target", (0.0,) * 6, radius=20.0, hold=True)
    debris = Obstacle("debris", (40.0, -250.0, 60.0, 0.0, -0.08, 0.0), radius=10.0)
    start = np.array([[0.0, -300, 0, 0, 0, 0], [0.0, -400, 0, 0, 0, 0]])
    goal = np.array([[0.0, -100, 0, 0, 0, 0], [0.0, -320, 0, 0, 0, 0]])
    asked = Scenario(problem, start, goal, ends="any", obstacles=(target, debris))
    planner = named_planner("expert", Requirements(passive_safety=orbits))
    (plan,) = AsFlown(planner).plan([asked])
    after = int(np.ceil(orbits * 2 * np.pi / problem.mean_motion / problem.time_step))
    T, n = problem.nodes, 2
    whole = np.concatenate([plan.controls, np.zeros((n, after, 3))], axis=1)
    lost = np.repeat(whole[:, None], T, axis=1)
    for node in range(T):
        lost[:, node, node:] = 0.0
    still = np.zeros((2, *whole.shape[1:]))
    states = [start, [one.state for one in asked.obstacles], np.repeat(start, T, axis=0)]
    everything = {
        **plan_document(plan),
        "controls": np.concatenate([whole, still, lost.reshape(n * T, -1, 3)]),
    }
    everything["scenario"] = {**everything["scenario"], "initial": np.concatenate(states)}
    flown = file_flown(everything, parts)[..., :3]
    beside, adrift = flown[:4], flown[4:].reshape(n, T, *flown.shape[1:])
    wanted, least = [7.5, 7.5, 20.0, 10.0], {}
    for i in range(n):
        for node in range(T):
            window = slice(node, node + after)
            apart = np.linalg.norm(adrift[i, node, window] - beside[:, window], axis=-1)
            for j in {0, 1, 2, 3} - {i}:
                least[i, j, node] = apart[j].min() - 7.5 - wanted[j]
    found = plan.certificate.passive_safety.clearance
    assert found.min_clearance_bound - 1e-6 <= min(least.values()) <= found.min_clearance + 0.05
    i, j, node = min(least, key=least.get)
    assert (found.craft, found.other, found.node) == (i, [0, 1, "target", "debris"][j], node)
    assert plan.status == (SOLVED if min(least.values()) > 0 else UNSAFE)
