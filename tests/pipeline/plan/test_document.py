"""Plan files: they say what they were asked, and what is read is what was written."""

import json

import numpy as np
import pytest
from judge import judge_plan

from pipeline.errors import InputError
from pipeline.expert import solve, within_risk
from pipeline.orbit.problem import Problem
from pipeline.plan.document import read_plan, write_plan
from pipeline.plan.judge import Draft, certified_plan
from pipeline.plan.requirements import Requirements, RiskLimit
from pipeline.planners.classical import Expert
from pipeline.planners.goal_assignment import GoalAssignment
from pipeline.scenario import draw

SCENARIO = draw("rings", 3, 4, 0, Problem(time_step=100.0, nodes=9, max_acceleration=0.01))

KNOWN = {"rank": 1, "tried": 1, "given_fuel_lower_bound": None, "saving": None}
"""Of an assignment, besides the slots."""


@pytest.fixture
def written(tmp_path):
    """A plan and its file."""
    plan = solve(SCENARIO)
    write_plan(tmp_path / "plan.json", plan)
    return plan, tmp_path / "plan.json"


def test_a_plan_file_alone_is_enough_to_judge_it(written):
    document = json.loads(written[1].read_text())
    assert document["schema"] == "prolearn.plan/2"
    assert judge_plan(document["scenario"], document).wrong == ()


def test_what_is_read_is_what_was_written_to_the_bit(written):
    plan, path = written
    read = read_plan(path)
    scenario = read.scenario
    for name in ("states", "controls"):
        assert np.array_equal(getattr(read, name), getattr(plan, name))
    rest = ("planner", "status", "message", "certificate", "convex_solves", "timing")
    assert [getattr(read, name) for name in rest] == [getattr(plan, name) for name in rest]
    assert scenario.problem == SCENARIO.problem
    assert np.array_equal(scenario.initial, SCENARIO.initial)
    assert np.array_equal(scenario.goal, SCENARIO.goal)


def test_an_assignment_comes_back_with_the_scenario_that_is_flown(tmp_path):
    (plan,) = GoalAssignment(Expert()).plan([SCENARIO])
    slots = list(plan.assignment.slots)
    assert slots != [0, 1, 2, 3]
    write_plan(tmp_path / "plan.json", plan)
    document = json.loads((tmp_path / "plan.json").read_text())
    assert judge_plan(document["scenario"], document).wrong == ()
    read = read_plan(tmp_path / "plan.json")
    assert read.assignment == plan.assignment
    assert np.array_equal(read.scenario.goal, SCENARIO.goal[slots])


def test_a_plan_of_the_given_order_says_nothing_of_an_assignment(written):
    assert "assignment" not in json.loads(written[1].read_text())
    assert read_plan(written[1]).assignment is None


def test_separation_at_the_nodes_comes_back_and_at_all_times_is_what_is_not_said(written, tmp_path):
    assert "separation" not in json.loads(written[1].read_text())
    assert read_plan(written[1]).requirements == Requirements()
    plan = solve(SCENARIO, requirements=Requirements("nodes"))
    write_plan(tmp_path / "nodes.json", plan)
    assert json.loads((tmp_path / "nodes.json").read_text())["separation"] == "nodes"
    assert read_plan(tmp_path / "nodes.json").requirements == Requirements("nodes")


def test_a_risk_comes_back(tmp_path):
    plan = within_risk(solve(SCENARIO), Requirements(risk=RiskLimit(1e-3, 0.05, 1e-3)))
    assert plan.certificate.risk.uncertainty.direction == 1e-3
    write_plan(tmp_path / "plan.json", plan)
    assert read_plan(tmp_path / "plan.json").certificate == plan.certificate
    text = (tmp_path / "plan.json").read_text()
    assert '"position": 0.05' in text
    (tmp_path / "plan.json").write_text(text.replace('"position": 0.05', '"position": -1'))
    with pytest.raises(InputError, match=r"plan\.json: position is -1"):
        read_plan(tmp_path / "plan.json")


def test_each_node_has_a_line(written):
    lines = [line.strip().rstrip(",") for line in written[1].read_text().splitlines()]
    n, T = SCENARIO.n, SCENARIO.problem.nodes
    rows = [json.loads(line) for line in lines if line.startswith("[") and line.endswith("]")]
    assert sum(len(row) == 6 for row in rows) == n * T + 2 * n, "states, and both ends"
    assert sum(len(row) == 3 for row in rows) == n * (T - 1)
    assert max(map(len, lines)) < 200


def test_an_infinite_gap_comes_back_as_such(tmp_path):
    idle = np.zeros((SCENARIO.n, SCENARIO.problem.intervals, 3)) + 1e-3
    plan = certified_plan("one", SCENARIO, Draft(idle, 0.0))
    write_plan(tmp_path / "plan.json", plan)
    assert json.loads((tmp_path / "plan.json").read_text())["certificate"]["optimality_gap"] is None
    assert read_plan(tmp_path / "plan.json").certificate == plan.certificate


def test_files_of_version_1_which_leave_out_the_scenario_are_refused(written):
    _, path = written
    document = json.loads(path.read_text())
    del document["scenario"], document["certificate"]["goal_velocity_error"]
    path.write_text(json.dumps(document | {"schema": "prolearn.plan/1"}))
    with pytest.raises(InputError, match=r"plan/1, which leaves out the scenario.*plan again"):
        read_plan(path)


@pytest.mark.parametrize("wrong", ["1", True, float("nan"), float("inf")])
@pytest.mark.parametrize(
    "place",
    [
        ("certificate", "fuel"),
        ("certificate", "min_separation_pair", 0),
        ("certificate", "craft_delta_v", 1),
        ("assignment", "slots", 1),
        ("assignment", "saving"),
        ("timing", "plan"),
        ("convex_solves",),
    ],
)
def test_what_is_no_number_is_not_taken_for_one(written, place, wrong):
    document = json.loads(written[1].read_text())
    document["assignment"] = {"slots": [0, 1, 2, 3], **KNOWN}
    inside = document
    for name in place[:-1]:
        inside = inside[name]
    inside[place[-1]] = wrong
    written[1].write_text(json.dumps(document))
    with pytest.raises(InputError, match=rf"{place[0]}.* is .*(number|integer)"):
        read_plan(written[1])


def test_certificates_that_do_not_say_by_which_velocity_the_goal_is_missed_are_read(written):
    plan, path = written
    document = json.loads(path.read_text())
    del document["certificate"]["goal_velocity_error"]
    path.write_text(json.dumps(document))
    read = read_plan(path)
    assert np.array_equal(read.controls, plan.controls)
    assert np.isnan(read.certificate.goal_velocity_error)
    write_plan(path, read)
    assert np.isnan(read_plan(path).certificate.goal_velocity_error)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"schema": "prolearn.plan/9"}, "schema is 'prolearn.plan/9'"),
        ({"scenario": None}, r"scenario is missing, which prolearn\.plan/2 has"),
        ({"times": ["0"] * 9}, r"times\[0\] is '0'"),
        ({"status": "fine"}, "status is 'fine'"),
        ({"separation": "never"}, "separation is 'never'"),
        ({"speed": 1}, "speed is not a field"),
        ({"times": [0.0, 100.0]}, "4 craft and 2 nodes, its scenario has others"),
        ({"assignment": {"slots": [0, 1, 2, 2], **KNOWN}}, "assignment.slots is no order of the 4"),
        ({"assignment": {"slots": [0, 1, 2], **KNOWN}}, "assignment.slots is no order of the 4"),
        ({"times": [0.0, 1.0, *range(200, 900, 100)]}, "times are not those of the nodes"),
        ({"controls": []}, "give each of 4 craft 9 states and 8 controls"),
        ({"states": [[[0.0] * 5] * 9] * 4}, r"states\[0\]\[0\]"),
        ({"certificate": {"fuel": "little"}}, r"certificate\.fuel is 'little'"),
    ],
)
def test_a_wrong_field_is_named_with_what_is_wrong(written, change, words):
    path = written[1]
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(InputError, match=words) as caught:
        read_plan(path)
    assert "plan.json" in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "words"), [("{", "not JSON"), ("[1]", "plan file"), (None, "cannot be read")]
)
def test_what_is_no_plan_at_all_is_refused(tmp_path, content, words):
    if content is not None:
        (tmp_path / "plan.json").write_text(content)
    with pytest.raises(InputError, match=words):
        read_plan(tmp_path / "plan.json")
