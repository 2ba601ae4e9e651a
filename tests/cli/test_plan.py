"""prolearn plan: plans that a judge outside the project agrees with."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from pipeline.orbit.problem import Problem
from pipeline.scenario import draw
from pipeline.scenario.document import write_scenario

JUDGE = Path(__file__).parents[3] / "shared" / "oracle" / "check_plan.py"
needs_judge = pytest.mark.skipif(not JUDGE.exists(), reason=f"{JUDGE.name} is not beside")


def judged(scenario, plan, *options):
    done = subprocess.run(
        [sys.executable, JUDGE, scenario, plan, "--lower-bound", *options],
        capture_output=True,
        text=True,
        check=False,
    )
    return json.loads(done.stdout)


@needs_judge
@pytest.mark.parametrize("family", ["rings", "coplanar-split", "rotation"])
def test_the_judge_agrees_with_the_experts_certificate(family, prolearn, tmp_path):
    files = []
    for n in (1, 2, 9):
        files.append(tmp_path / f"{n}.json")
        write_scenario(files[-1], draw(family, 0, n, 0, Problem()))
    done = prolearn("plan", *files, "--planner", "expert", "--out", "plans")
    assert done.returncode == 0, done.stderr
    for file in files:
        plan = tmp_path / "plans" / f"{file.stem}.plan.json"
        report = judged(file, plan)
        assert report["sound"], report["faults"]
        said = json.loads(plan.read_text())
        assert said["schema"] == "prolearn.plan/1"
        assert said["status"] == "solved"
        for name in ("fuel", "delta_v", "fuel_lower_bound"):
            assert said["certificate"][name] == pytest.approx(report[name], rel=1e-6)


@needs_judge
def test_a_thrust_limit_and_another_grid_are_kept(prolearn, tmp_path):
    problem = Problem(time_step=200.0, nodes=9, max_acceleration=2e-3)
    write_scenario(tmp_path / "s.json", draw("rings", 1, 6, 0, problem))
    done = prolearn("plan", "s.json", "--out", "p.json")
    assert done.returncode == 0, done.stderr
    report = judged(tmp_path / "s.json", tmp_path / "p.json")
    assert report["sound"], report["faults"]


@needs_judge
def test_plans_apart_at_the_nodes_pass_the_papers_criterion(prolearn, tmp_path):
    write_scenario(tmp_path / "s.json", draw("rings", 0, 10, 1, Problem()))
    prolearn("plan", "s.json", "--out", "p.json", "--separation", "nodes")
    report = judged(tmp_path / "s.json", tmp_path / "p.json", "--nodes-only")
    assert report["sound"], report["faults"]
    assert report["node_collisions"] == 0


def test_an_infeasible_scenario_exits_with_1_and_says_why(prolearn, tmp_path):
    write_scenario(tmp_path / "s.json", draw("rings", 0, 2, 0, Problem(max_acceleration=1e-6)))
    done = prolearn("plan", "s.json", "--out", "p.json")
    assert done.returncode == 1
    assert "cannot reach its goal within max_acceleration" in done.stdout
    assert json.loads((tmp_path / "p.json").read_text())["status"] == "infeasible"


def test_a_baseline_plans_by_its_name(prolearn, tmp_path):
    write_scenario(tmp_path / "s.json", draw("rings", 0, 3, 0, Problem()))
    done = prolearn("plan", "s.json", "--out", "p.json", "--planner", "minimum-energy")
    assert json.loads((tmp_path / "p.json").read_text())["planner"] == "minimum energy"
    assert "gap" in done.stdout
