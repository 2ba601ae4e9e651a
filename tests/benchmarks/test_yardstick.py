"""The yardstick's fast rows, run, against what is published and what can be worked out by hand."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from endless import endless
from judge.keep_out import outside
from relative import linear_maps, pull, state_of, true_anomaly

from benchmarks.peers import by_repair, required_module
from benchmarks.rendezvous import (
    AHEAD,
    ANGLES,
    AXES,
    CHIEF,
    HOLD,
    MOST,
    NODES,
    PORT,
    START,
    STEP,
    relative,
)
from benchmarks.yardstick import (
    CASES,
    PEERS,
    Peer,
    PeerPlanning,
    _figures,
    case_row,
    cost,
    judged,
    rendezvous_optima,
    swarm_rows,
)
from pipeline.errors import InputError
from pipeline.expert import solve
from pipeline.orbit.problem import Problem
from pipeline.scenario import Scenario, draw
from pipeline.scenario.document import read_scenario

EXAMPLES = Path(__file__).parents[2] / "examples"
BY_NAME = {(case.files[0], case.thrust): case for case in CASES}


@pytest.mark.parametrize(
    ("thrust", "published"), [("components", 1.7913), ("norm", 1.3211)], ids=["1-norm", "2-norm"]
)
def test_simbol_x_costs_what_is_published_and_what_its_arcs_add(thrust, published):
    """An arc costs more in first order of its length, so half as long arcs cost half as much more:
    what two grids extrapolate to is what impulses cost."""
    scenario = read_scenario(EXAMPLES / "simbol-x.json")
    given, spent = scenario.problem, []
    for n in (50, 100):
        grid = {"nodes": n + 1, "time_step": given.duration / n}
        problem = replace(given, **grid, thrust=replace(given.thrust, model=thrust))
        spent.append(cost(replace(scenario, problem=problem)))
    coarse, fine = spent
    assert published < fine < coarse < 1.03 * published
    assert 2 * fine - coarse == pytest.approx(published, rel=1.5e-3)


@pytest.mark.parametrize("thrust", ["components", "norm"])
@pytest.mark.parametrize(
    ("file", "published"),
    [
        ("tandem-x-plane", {"components": 0.1105, "norm": 0.1105}),
        ("tandem-x-both", {"components": 0.3315, "norm": 0.247}),
    ],
)
def test_the_tandem_x_like_cases_cost_their_lower_bound(file, published, thrust):
    row = case_row(BY_NAME[file, thrust])
    assert float(row["ours, m/s"]) == pytest.approx(published[thrust], rel=1.5e-3)
    assert 0.9999 < float(row["ratio"]) < 1.0015


@pytest.mark.parametrize(
    ("file", "initial", "goal"),
    [("tandem-x-plane", (300, 400), (300, 500)), ("tandem-x-both", (300, 500), (500, 300))],
)
def test_the_files_have_the_relative_elements_of_the_course_problems(file, initial, goal):
    """By the linear map at u = 0, where both ends are: y = -2 aδe_y, z = -aδi_y, vx = -n aδe_y; it
    leaves out the square of the distance over a, half a millimetre a hundred metres."""
    scenario = json.loads((EXAMPLES / f"{file}.json").read_text())
    n = np.sqrt(3.986004418e14 / 6886536.686**3)
    for end, (e_y, i_y) in (("initial", initial), ("goal", goal)):
        want = [0.0, -2 * e_y, -i_y, -n * e_y, 0.0, 0.0]
        np.testing.assert_allclose(scenario[end][0][:3], want[:3], atol=0.1)
        np.testing.assert_allclose(scenario[end][0][3:], want[3:], atol=2e-4)


LEGS = ("station-approach", "station-docking")
PULSE = 10  # of an interval, its inverse share


def pulsed(file: str, *, last: bool) -> Scenario:
    """An example whose burns take the first tenth of intervals, or at the very end the last."""
    scenario = read_scenario(EXAMPLES / f"{file}.json")
    problem = scenario.problem
    step, k = problem.time_step / PULSE, PULSE * np.arange(problem.intervals)
    begins, ends = step * (k + 1.5), step * (k + PULSE - 0.5)
    ends[-1] -= step * last
    finer = replace(
        problem,
        nodes=PULSE * problem.intervals + 1,
        time_step=step,
        thrust=replace(problem.thrust, no_burn=tuple(zip(begins, ends, strict=True))),
        max_acceleration=PULSE * problem.max_acceleration,
    )
    return replace(scenario, problem=finer)


@pytest.fixture(scope="module")
def found():
    """Of Transformer-MPC's program: the optimum without the station, and those about it."""
    return rendezvous_optima()


def test_the_rendezvous_in_pulses_costs_what_transformer_mpc_s_program_finds(found):
    """And more in the file's arcs, but not more than its 113 s explain: 30 m in nine arcs are 30 m
    in eight intervals, from middle to middle, to nine between impulses."""
    spent = [np.linalg.norm(burns, axis=0).sum() for _, burns in found]
    assert spent[0] < spent[-1] == min(spent[1:])
    (approach, docking) = LEGS
    pulses = cost(pulsed(approach, last=False)) + cost(pulsed(docking, last=True))
    assert pulses == pytest.approx(spent[-1], rel=3e-3)
    row = case_row(BY_NAME[approach, "norm"])
    assert float(row["theirs, m/s"]) == pytest.approx(spent[-1], abs=1e-4)
    assert pulses < float(row["ours, m/s"]) < 9 / 8 * pulses


def test_transformer_mpc_s_program_arrives_by_an_integrator(found):
    """Linear, under J2, about osculating elements: off by what its mean, near-circular elements
    leave out. Its burns keep to 20 mm/s; it is out of the ellipsoid at nodes, hardly so between."""
    elements, burns = found[-1]
    assert np.abs(burns).max() < MOST * (1 + 1e-6)
    rate = np.sqrt(398600.4418e9 / CHIEF[0] ** 3)
    anomaly = true_anomaly(*CHIEF[:2], 0.0, ANGLES[3] / rate)
    chief = state_of(*CHIEF[:2], np.array([*ANGLES[:3], ANGLES[2] + anomaly]))
    state, places = relative(0) @ START, []
    for k in range(NODES - 1):
        free, _, orbit = linear_maps(chief, np.linspace(0, STEP, 11), partial(pull, j2=True))
        states = free @ (state + np.append(np.zeros(3), burns[:, k]))
        places.append(states[:, :3])
        state, chief = states[-1], orbit[-1]
    np.testing.assert_allclose(places[HOLD][0], [0, AHEAD, 0], atol=0.5)
    np.testing.assert_allclose(state[:3], [0, PORT, 0], atol=0.5)
    nodes = [relative(k) @ elements[:, k] for k in range(HOLD)]
    assert min(outside(node[:3], AXES) for node in nodes) > -1e-3
    assert -0.1 < min(outside(at, AXES) for way in places[:HOLD] for at in way) < 0


def test_the_judge_refuses_a_way_through_the_station():
    """The plan of the same ends, made as if there were none."""
    scenario = read_scenario(EXAMPLES / "station-approach.json")
    controls = solve(replace(scenario, obstacles=())).controls
    verdict = judged(scenario, controls)
    assert verdict.arrives
    assert verdict.at_all_times < -5
    assert verdict.safe(0.0) == (False, False)


def test_the_files_start_where_transformer_mpc_does():
    """By its map from relative elements; its limit of a burn is that of an arc."""
    for file, first, last in zip(LEGS, (0, HOLD), (HOLD, NODES - 1), strict=True):
        problem = read_scenario(EXAMPLES / f"{file}.json").problem
        assert problem.intervals == last - first
        assert problem.time_step == pytest.approx(STEP, abs=1e-5)
        assert problem.max_acceleration * problem.time_step == pytest.approx(MOST, rel=1e-5)
        orbit = problem.orbit
        mean = ANGLES[3] + np.sqrt(3.986004415e14 / CHIEF[0] ** 3) * STEP * first
        latitude = np.degrees(ANGLES[2] + mean + 2 * CHIEF[1] * np.sin(mean)) % 360
        assert orbit.argument_of_latitude_deg == pytest.approx(latitude, abs=1e-4)
    approach = read_scenario(EXAMPLES / "station-approach.json")
    np.testing.assert_allclose(approach.initial[0], relative(0) @ START, atol=1e-6)
    np.testing.assert_allclose(approach.obstacles[0].semi_axes, AXES)


def test_a_foreign_planner_that_takes_too_long_is_ended_and_its_row_says_so():
    never = Peer("never", endless, "in a process of its own", foreign=True)
    slow = Peer("slow", by_repair, "in a process of its own", foreign=True)
    _, row = swarm_rows(("rings", 4, 2), [PEERS[0], never], patience=1)
    assert row["time, s"].startswith("no plan in ")
    assert float(row["time, s"].split()[3]) >= 1
    assert row["safe at nodes"] == "0 of 0"
    first = PeerPlanning(PEERS[0], 1)
    first.plan(draw("rings", 2022, 4, 0, Problem()))
    first.over = 1.2
    assert _figures(first, first, np.ones(1))["time, s"].endswith(", then ended")
    _, row = swarm_rows(("rings", 4, 2), [PEERS[0], slow], patience=100)
    _, here = swarm_rows(("rings", 4, 2), [PEERS[0], replace(slow, foreign=False)])
    assert row["safe at nodes"] == "2 of 2"
    assert row["fuel / least"] == here["fuel / least"]


def test_peers_are_set_beside_ours_by_the_judge():
    rows = swarm_rows(("rings", 4, 1), [p for p in PEERS if p.name in ("expert", "plain SCP")])
    assert [row["planner"] for row in rows] == ["expert", "plain SCP"]
    assert {row["safe at nodes"] for row in rows} == {"1 of 1"}
    for row in rows:
        assert float(row["fuel / least"]) == pytest.approx(1.0, abs=2e-3)


@pytest.mark.parametrize("k", range(3))
def test_repaired_optima_arrive_and_cost_no_less_than_each_craft_alone(k):
    scenario = draw("rings", 2022, 10, k, Problem())
    (repair,) = (peer for peer in PEERS if peer.name == "decoupled, repaired")
    verdict = judged(scenario, repair.plan(scenario))
    assert verdict.safe(15.0) == (True, True)
    assert verdict.fuel >= solve(scenario).certificate.fuel_lower_bound * (1 - 1e-6)


def test_the_judge_refuses_controls_that_do_not_arrive():
    scenario = draw("rings", 2022, 4, 0, Problem())
    controls = solve(scenario).controls
    assert judged(scenario, controls).safe(15.0) == (True, True)
    assert judged(scenario, 0.9 * controls).safe(15.0) == (False, False)


def test_a_peer_that_is_missing_or_broken_says_so_and_what_to_install(tmp_path, monkeypatch):
    with pytest.raises(InputError, match=r"^nothing==1 is not installed; .*pip install nothing==1"):
        required_module("no_such_module", "nothing==1")
    (tmp_path / "a_broken_peer.py").write_text("import no_such_module")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(
        InputError, match=r"^peer==1 cannot be imported \(.*'no_such_module'\); ins"
    ):
        required_module("a_broken_peer", "peer==1")
