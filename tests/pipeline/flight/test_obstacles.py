"""Flights beside obstacles, of craft of their own radii, and in corridors: by other integrators."""

import json
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pyarrow.parquet as pq
import pytest
from judge import Case, least_clearance, least_inside, outside
from judge.corridors import inside
from relative import flight, pull
from scipy.stats import ncx2, norm

import prolearn
from pipeline.errors import InputError
from pipeline.expert import solve
from pipeline.figures.intervals import wilson
from pipeline.flight.effects import effects, flight_report
from pipeline.flight.errors import COLD_GAS, Errors, draws
from pipeline.flight.least_distances import OF_CORRIDORS, OF_SIZES
from pipeline.flight.loops import Loop, TrialSettings, fly_loops
from pipeline.flight.montecarlo import FIELDS, fly_all
from pipeline.flight.trials import fly_trials, open_loop
from pipeline.flight.world import Conditions, LinearWorld, problem_in, world_of
from pipeline.orbit.corridors import Box, Cone, Corridor
from pipeline.orbit.participants import Obstacle
from pipeline.orbit.problem import Problem
from pipeline.parallel.workers import Workers
from pipeline.plan.requirements import Requirements
from pipeline.scenario import Scenario, draw
from pipeline.scenario.document import document_of
from pipeline.scenario.spacecraft import Spacecraft

E = Problem.mean_motion
DEBRIS = Obstacle("debris", (30.0, -80.0, 20.0, 0.0, -60 * E, 0.01), radius=10.0)
CHIEF = Obstacle("chief", (0.0,) * 6, radius=30.0)
STATION = Obstacle(
    "station", (5.0, 20.0, -10.0, 0.0, 0.0, 0.0), semi_axes=(20.0, 60.0, 20.0), hold=True
)
RADII = tuple(Spacecraft(radius=r) for r in (3.0, 5.0, 7.5, 12.0, 3.0, 20.0))
AT_ONCE = Corridor(Box((-320.0, -640.0, -320.0), (320.0, 640.0, 320.0)), 480.0, 480.0, (2,))
ROOM = Corridor(Box((-320.0, -640.0, -320.0), (320.0, 640.0, 320.0)), 130.0, 1110.0)
WAY = Corridor(Cone((0.0, -2e3, 0.0), (0.0, 1.0, 0.0), 20.0), 500.0, 500.0, (1, 4))

KINDS = {
    "radii": {"craft": RADII},
    "a chief and debris": {"obstacles": (CHIEF, DEBRIS)},
    "radii, debris and a station": {"craft": RADII, "obstacles": (STATION, DEBRIS)},
}
DRAG = {"ballistic": 0.5, "spread": 0.5}
ROUGH = Conditions(eccentricity=0.01, inclination_deg=60.0, **DRAG)
AIR = 400e3, 3.725e-12, 58.515e3  # at 400 km and above, where the perigee is, by Vallado's table
PARTS = 240  # looks at each interval, every half second


def swarm(index: int, **own) -> Scenario:
    return replace(draw("rings", index, 6, 0, Problem()), **own)


@cache
def planned(index, kind=None):
    """The expert's plan for a swarm, with obstacles or radii of a kind or without."""
    return solve(swarm(index, **KINDS.get(kind, {})))


@cache
def planned_flown(index, kind=None):
    """Reference flight of that plan by DOP853, with eccentricity, J2 and drag."""
    plan = planned(index, kind)
    return integrated(plan.scenario, plan.controls, ROUGH)


@cache
def planned_effects(index, kind=None):
    """Flights of that plan by the product: in the linear model and in the nonlinear one."""
    plan = planned(index, kind)
    return effects(plan.scenario, plan.controls, ROUGH)


def integrated(scenario, controls, conditions, after=0):
    """Craft and obstacles flown by DOP853, (n + m, intervals, PARTS + 1, 3); what is held stays."""
    orbit = problem_in(scenario.problem, conditions).orbit
    n, obstacles = scenario.n, scenario.obstacles
    states = np.concatenate([scenario.initial, *([one.state] for one in obstacles)])
    pushed = np.zeros((len(states), controls.shape[1] + after, 3))
    pushed[:n, : controls.shape[1]] = controls
    shares = np.concatenate([[0.0], np.linspace(-1, 1, n), np.zeros(len(obstacles))])
    held = (conditions.ballistic or 0.0) * (1 + conditions.spread * shares)
    air = AIR if conditions.ballistic else None
    force = partial(pull, j2=conditions.j2, ballistic=held, air=air)
    grid = scenario.problem.time_step, PARTS
    found = flight(orbit.states(np.zeros(1))[0], states, pushed, grid, force)[..., :3]
    for k, one in enumerate(obstacles):
        if one.hold:
            found[n + k] = one.state[:3]
    return found


def gaps(scenario, craft, others, radii, axes):
    """Least clearance over time between each craft and every participant, (n, n + m), m."""
    least = np.full((len(craft), len(others)), np.inf)
    for i, one in enumerate(craft):
        for j, other in enumerate(others):
            apart = (one - other).reshape(-1, 3)
            if j < scenario.n:
                least[i, j] = np.linalg.norm(apart, axis=1).min() - radii[i] - radii[j]
            else:
                size = axes[j - scenario.n]
                near = apart[np.linalg.norm(apart / size, axis=1).argsort()[:50]]
                least[i, j] = outside(near, size).min() - radii[i]
    least[np.tril_indices(len(craft))] = np.inf
    return least


def sizes(scenario):
    radii = [one.radius for one in scenario.craft] or [7.5] * scenario.n
    return radii, [np.array(one.semi_axes or [one.radius] * 3) for one in scenario.obstacles]


@pytest.mark.parametrize("kind", KINDS)
def test_in_the_linear_world_clearance_is_that_of_the_judge_and_the_certificate(kind):
    plan = planned(1, kind)
    first = planned_effects(1, kind)[0].clearance
    document = document_of(plan.scenario)
    truth = least_clearance(document, Case.of(document), plan.states, plan.controls)
    claimed = plan.certificate.clearance
    assert first.min_clearance == pytest.approx(claimed.min_clearance, abs=2e-4)
    assert first.min_clearance_bound <= first.min_clearance
    assert (first.craft, first.other) == (claimed.craft, claimed.other)
    assert first.min_clearance <= truth.clearance + 2e-4
    if claimed.other != "station":  # of the ellipsoid it is at most the true distance
        assert first.min_clearance == pytest.approx(truth.clearance, abs=2e-4)
        assert (first.craft, first.other) == (truth.craft, truth.other)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("index", [1, 2])
def test_in_the_nonlinear_world_obstacles_move_as_craft_do_or_stay(kind, index):
    """With J2, an eccentric orbit, and so much drag that it matters who has how much."""
    plan = planned(index, kind)
    scenario = plan.scenario
    last = planned_effects(index, kind)[-1]
    flown = planned_flown(index, kind)
    nodes = np.concatenate([last.states, last.obstacles])[:, 1:, :3]
    np.testing.assert_allclose(flown[:, :, -1], nodes, atol=1e-5)
    least = gaps(scenario, flown[:6], flown, *sizes(scenario))
    craft, other = np.unravel_index(least.argmin(), least.shape)
    found = last.clearance
    assert found.min_clearance_bound <= found.min_clearance
    # Of how deep inside an ellipsoid it says nothing.
    assert found.min_clearance_bound <= max(least.min(), 0.0)
    name = other if other < 6 else scenario.obstacles[other - 6].name
    if found.other != "station":  # half a second at some m/s
        assert found.min_clearance == pytest.approx(least.min(), abs=0.05)
        assert (found.craft, found.other) == (craft, name)
    report = flight_report(plan, ROUGH, [last], None)
    assert report["clearance"]["other"] == found.other
    assert report["safe"] == (found.min_clearance_bound > 0)
    assert not report["safe"] or least.min() > 0


def test_a_plan_made_for_a_circle_comes_too_close_on_an_eccentric_orbit_and_that_is_said():
    found_safe = []
    for index in (0, 1):
        of = index, "a chief and debris"
        plan, found, flown = planned(*of), planned_effects(*of), planned_flown(*of)
        truth = gaps(plan.scenario, flown[:6], flown, *sizes(plan.scenario))
        assert plan.status == "solved"
        found_safe.append(flight_report(plan, ROUGH, found, None)["safe"])
        assert found_safe[-1] == (truth.min() > 0)
    assert {*found_safe} == {True, False}


def test_craft_of_equal_default_radii_are_judged_as_without():
    plan = planned(0)
    same = replace(plan.scenario, craft=tuple(Spacecraft(radius=7.5) for _ in range(6)))
    alike, sized = (effects(one, plan.controls, ROUGH)[-1] for one in (plan.scenario, same))
    assert alike.clearance is None and alike.corridor is None
    assert sized.nearest == alike.nearest
    assert sized.clearance.min_clearance == pytest.approx(alike.nearest.distance - 15, abs=1e-9)


@pytest.mark.parametrize("corridors", [(ROOM,), (AT_ONCE,), (WAY, ROOM)], ids=len)
def test_corridors_are_kept_as_far_as_other_integrators_say(corridors):
    scenario = swarm(3, corridors=corridors)
    plan = replace(planned(3), scenario=scenario)
    rows = effects(scenario, plan.controls, ROUGH)
    document = document_of(scenario)
    flown = planned_flown(3)
    paths = np.concatenate([flown[:, :, :-1].reshape(6, -1, 3), flown[:, -1, -1:]], axis=1)
    times, least = np.arange(paths.shape[1]) * 120.0 / PARTS, []
    for one in document["corridors"]:
        looked = (times >= one["from"]) & (times <= one["to"])
        for craft in one.get("craft") or range(6):
            least += inside(paths[craft, looked], one).tolist()
    linear = least_inside(document, Case.of(document), plan.states, plan.controls)
    for row, truth in ((rows[0], linear), (rows[-1], min(least))):
        found = row.corridor
        assert found.min_margin_bound <= found.min_margin
        assert found.min_margin_bound <= truth + 1e-6
        assert found.min_margin - found.min_margin_bound < 1e-4
        if WAY not in corridors:  # of which the pyramid inside counts
            assert found.min_margin == pytest.approx(truth, abs=0.02)
    report = flight_report(plan, ROUGH, rows, None)
    assert report["corridor"]["min_margin"] == rows[-1].corridor.min_margin
    assert not report["safe"] or rows[-1].corridor.min_margin_bound > 0


def test_at_the_nodes_only_obstacles_count_where_they_are_then():
    asked = swarm(1, craft=RADII, obstacles=(CHIEF, DEBRIS))
    plan = solve(asked, requirements=Requirements("nodes"))
    last = effects(asked, plan.controls, ROUGH)[-1]
    there = integrated(asked, plan.controls, ROUGH)[:, :, -1]
    starts = np.concatenate([asked.initial[:, :3], [one.state[:3] for one in asked.obstacles]])
    there = np.concatenate([starts[:, None], there], axis=1)
    close = sum(
        int((gaps(asked, there[:6, [k]], there[:, [k]], *sizes(asked)) <= 0).sum())
        for k in range(11)
    )
    report = flight_report(plan, ROUGH, [last], None)
    assert report["node_collisions"] == close
    assert report["safe"] == (close == 0)
    place = tuple((last.states[2, 4] * [1, 1, 1, 0, 0, 0]).tolist())
    met = replace(asked, obstacles=(Obstacle("met", place, radius=5.0, hold=True),))
    rows = effects(met, plan.controls, ROUGH)
    found = flight_report(replace(plan, scenario=met), ROUGH, rows, None)
    assert found["node_collisions"] >= 1 and not found["safe"]


@pytest.mark.parametrize("obstacle", [DEBRIS, STATION], ids=lambda one: one.name)
def test_craft_adrift_come_as_close_to_obstacles_as_when_integrated(obstacle):
    asked, orbits, after = swarm(2, craft=RADII, obstacles=(obstacle,)), 0.1, 5
    conditions = Conditions(eccentricity=0.01)
    plan = solve(asked)
    n, T = 6, 11
    whole = np.concatenate([plan.controls, np.zeros((n, after, 3))], axis=1)
    lost = np.repeat(whole[:, None], T, axis=1)
    for node in range(T):
        lost[:, node, node:] = 0.0
    twins = replace(
        asked,
        initial=np.repeat(asked.initial, T, axis=0),
        goal=np.repeat(asked.goal, T, axis=0),
        craft=(),
        obstacles=(),
    )
    beside = integrated(asked, plan.controls, conditions, after)
    adrift = integrated(twins, lost.reshape(n * T, -1, 3), conditions).reshape(
        n, T, -1, PARTS + 1, 3
    )
    radii, axes = sizes(asked)
    least = {}
    for node in range(T):
        part = slice(node, node + after)
        for i in range(n):
            apart = np.linalg.norm(adrift[i, node, part] - beside[:n, part], axis=-1)
            apart = apart.min(axis=(1, 2)) - radii - radii[i]
            apart[i] = np.inf
            gap = (adrift[i, node, part] - beside[n, part]).reshape(-1, 3)
            near = gap[np.linalg.norm(gap / axes[0], axis=1).argsort()[:20]]
            met = outside(near, axes[0]).min() - radii[i]
            least[i, node] = min(float(apart.min()), met)
    report = flight_report(plan, conditions, effects(asked, plan.controls, conditions), orbits)
    found, truth = report["passive_safety"]["clearance"], min(least.values())
    assert found["min_clearance_bound"] <= max(truth, 0.0)
    if found["other"] != "station":
        assert found["min_clearance"] == pytest.approx(truth, abs=0.05)
        assert least[found["craft"], found["node"]] == pytest.approx(truth, abs=0.05)
    assert not report["safe"] or truth > 0


def test_what_is_held_does_not_fall_where_it_would_if_it_were_let_go():
    """Released 150 km below, the obstacle would fall into the Earth; it is held there."""
    below = Obstacle("below", (-150e3, 0.0, 0.0, 0.0, 0.0, 0.0), radius=5.0, hold=True)
    plan = solve(swarm(2, craft=RADII))
    beside = replace(plan.scenario, obstacles=(below,))
    alone, met = (
        flight_report(
            replace(plan, scenario=one), ROUGH, effects(one, plan.controls, ROUGH), orbits=0.5
        )["passive_safety"]["clearance"]
        for one in (plan.scenario, beside)
    )
    assert met["other"] == alone["other"]
    assert met["min_clearance"] == pytest.approx(alone["min_clearance"], abs=1e-6)


STRAIGHT = Problem(mean_motion=1e-12, time_step=100.0, nodes=5, collision_radius=30.0)
"""So slow an orbit that motion is straight."""


def flown(scenario, errors, trials=4000):
    drawn = draws(1, range(trials), scenario.n, 4)
    controls = np.zeros((scenario.n, 4, 3))
    world = LinearWorld(STRAIGHT.dynamics)
    return fly_trials(scenario, world, open_loop(controls), drawn, errors)


@pytest.mark.parametrize("moving", [0.0, 1.0], ids=["held", "drifting"])
@pytest.mark.parametrize("offset", [12.0, 15.0])
def test_errors_of_a_craft_alone_bring_it_too_close_as_often_as_the_rice_distribution_has_it(
    offset, moving
):
    # Apart at the pass: √(X² + Z²), X normal about the offset and Z about 0, both σ wide.
    state = (0.0, -200 * moving, 0.0, 0.0, moving, 0.0)
    met = Obstacle("it", state, radius=12.0, hold=not moving)
    ends = np.array([[offset, 200.0, 0, 0, -1, 0]])
    craft = (Spacecraft(radius=3.0),)
    rows = flown(
        Scenario(STRAIGHT, ends, ends, craft=craft, obstacles=(met,)), Errors(position=2.0)
    )
    share = float((rows["min_clearance"] <= 0).mean())
    low, high = wilson(share, 4000)
    assert low <= ncx2.cdf((15.0 / 2) ** 2, 2, (offset / 2) ** 2) <= high
    assert (rows["first_craft"] == -1).all() and np.isinf(rows["min_separation"]).all()
    assert {*rows["clearance_other"]} == {1}, "numbered on after the craft"
    if moving:
        assert rows["min_clearance_time"] == pytest.approx(200.0, abs=10.0)


def test_errors_lead_out_of_a_corridor_as_often_as_the_normal_distribution_has_it():
    far = Box((-4.0, -1e3, -1e3), (1e3, 1e3, 1e3))
    ends = np.array([[0.0, 200, 0, 0, -1, 0], [0.0, 400, 0, 0, -1, 0]])
    scenario = Scenario(STRAIGHT, ends, ends, corridors=(Corridor(far, 50.0, 330.0, (1,)),))
    rows = flown(scenario, Errors(position=2.0))
    low, high = wilson(float((rows["min_margin"] <= 0).mean()), 4000)
    assert low <= norm.cdf(-4.0 / 2) <= high
    assert {*rows["margin_craft"]} == {1} and {*rows["margin_corridor"]} == {0}
    assert "min_clearance" not in rows


def test_trials_without_errors_are_the_flight():
    asked = swarm(1, **KINDS["radii, debris and a station"], corridors=(ROOM,))
    plan = replace(planned(1, "radii, debris and a station"), scenario=asked)
    last = effects(asked, plan.controls, ROUGH)[-1]
    drawn = draws(0, range(3), 6, 10)
    rows = fly_trials(asked, world_of(asked, ROUGH), open_loop(plan.controls), drawn, Errors())
    clear, corridor = last.clearance, last.corridor
    assert rows["min_clearance"] == pytest.approx(clear.min_clearance, abs=1e-6)
    assert rows["min_clearance_time"] == pytest.approx(clear.time, abs=1e-3)
    assert rows["min_margin"] == pytest.approx(corridor.min_margin, abs=1e-6)
    names = [*range(6), *(one.name for one in asked.obstacles)]
    assert {names[k] for k in rows["clearance_other"]} == {clear.other}
    assert {*rows["margin_craft"]} == {corridor.craft}


def test_a_folder_has_their_columns_and_refuses_other_obstacles_radii_and_corridors(tmp_path):
    asked = swarm(1, **KINDS["radii, debris and a station"], corridors=(ROOM,))
    loops = [Loop("open", solve(asked).controls)]
    of = TrialSettings(asked, world_of(asked, ROUGH), COLD_GAS, seed=5, portion=4)
    whole = fly_all(tmp_path / "whole", of, loops, 10, workers=Workers(1))["open"]
    fly_all(tmp_path / "more", of, loops, 3, workers=Workers(1))
    more = fly_all(tmp_path / "more", of, loops, 10, workers=Workers(1))["open"]
    held = fly_loops(replace(of, portion=None), loops, 10)["open"]
    for name in (*OF_SIZES, *OF_CORRIDORS):
        np.testing.assert_array_equal(more[name], whole[name])
        if whole[name].dtype.kind == "i":
            np.testing.assert_array_equal(held[name], whole[name])
    for path in (tmp_path / "whole").glob("loop=open/*.parquet"):
        assert path.read_bytes() == (tmp_path / "more/loop=open" / path.name).read_bytes()
    for changed, named in [
        ({"obstacles": (STATION, replace(DEBRIS, radius=11.0))}, r"obstacles\.1\.radius = 10.0"),
        ({"obstacles": (DEBRIS, STATION)}, r"obstacles\.0\."),
        ({"obstacles": ()}, "obstacles"),
        ({"craft": ()}, r"radii = "),
        ({"corridors": (replace(ROOM, end=1000.0),)}, r"corridors\.0\.end = 1110"),
    ]:
        with pytest.raises(InputError, match=f"begun with {named}"):
            fly_all(tmp_path / "more", replace(of, scenario=replace(asked, **changed)), loops, 10)


def test_a_folder_without_them_has_the_columns_it_ever_had(tmp_path):
    asked = swarm(1)
    of = TrialSettings(asked, LinearWorld(asked.problem.dynamics), COLD_GAS)
    fly_all(tmp_path, of, [Loop("open", solve(asked).controls)], 2, workers=Workers(1))
    (path,) = tmp_path.glob("loop=open/*.parquet")
    schema = pq.read_schema(path)
    assert schema.names == [field.name for field in FIELDS]
    assert not {"radii", "obstacles", "corridors"} & {*json.loads(schema.metadata[b"prolearn"])}


def test_planning_anew_refuses_them_and_open_loop_counts_them():
    plan = solve(swarm(1, **KINDS["a chief and debris"], corridors=(ROOM,)))
    with pytest.raises(InputError, match="guidance that plans anew does not know; expected no rep"):
        prolearn.monte_carlo(plan, 2, replan="expert")
    made = prolearn.monte_carlo(plan, 30)
    (summary,), rows = made.summaries, made.trials["open loop"]
    assert summary.within_radius == float((rows["min_clearance"] <= 0).mean()) > 0
    assert summary.least_clearance == rows["min_clearance"].min()
    assert summary.outside_corridor == float((rows["min_margin"] <= 0).mean())
    assert made.figure().axes[0].get_xlabel() == "least clearance (m)"
    assert "least_clearance" in summary.document()
    alike = prolearn.monte_carlo(solve(swarm(1)), 2).summaries[0].document()
    assert not {"least_clearance", "outside_corridor"} & {*alike}
