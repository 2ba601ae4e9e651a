"""The yardstick's fast rows, run, against what is published and what can be worked out by hand."""

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.peers import needed
from benchmarks.yardstick import CASES, PEERS, case_row, judged, swarm_rows
from pipeline.errors import InputError
from pipeline.expert import solve
from pipeline.orbit.problem import Problem
from pipeline.scenario import draw

EXAMPLES = Path(__file__).parents[2] / "examples"
BY_NAME = {(case.file, case.thrust): case for case in CASES}


@pytest.mark.parametrize(
    ("thrust", "published"), [("components", 1.7913), ("norm", 1.3211)], ids=["1-norm", "2-norm"]
)
def test_simbol_x_costs_what_is_published_and_what_its_arcs_add(thrust, published):
    """An arc costs more in first order of its length, so half as long arcs cost half as much more:
    what two grids extrapolate to is what impulses cost."""
    coarse, fine = (float(case_row(BY_NAME["simbol-x", thrust], n)["ours, m/s"]) for n in (50, 100))
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


def test_peers_are_set_beside_ours_by_the_judge():
    rows = swarm_rows("rings", 4, 1, [p for p in PEERS if p.name in ("expert", "plain SCP")])
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


def test_a_peer_that_is_missing_says_what_to_install():
    with pytest.raises(InputError, match=r"^nothing==1 is not installed; .*pip install nothing==1"):
        needed("no_such_module", "nothing==1")
