"""scenario.json: what is written is read back, and every mistake has its sentence."""

import json
import subprocess
import sys

import numpy as np
import pytest

from pipeline.errors import InputError
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import mean_motion_at
from pipeline.scenario import Scenario, check, draw
from pipeline.scenario.document import SCHEMA, read_scenario, write_scenario

PROBLEM = Problem(time_step=90.0, nodes=7, collision_radius=10.0, max_acceleration=2e-3)


@pytest.fixture
def document(tmp_path):
    path = tmp_path / "scenario.json"
    write_scenario(path, draw("rings", 0, 3, 0, PROBLEM))
    return path


def change(path, **fields):
    document = json.loads(path.read_text()) | fields
    path.write_text(json.dumps({k: v for k, v in document.items() if v != "absent"}))
    return path


def test_a_scenario_survives_the_file(document):
    read, drawn = read_scenario(document), draw("rings", 0, 3, 0, PROBLEM)
    assert read.problem == drawn.problem
    assert (read.initial == drawn.initial).all()
    assert (read.goal == drawn.goal).all()


def test_an_altitude_stands_for_its_mean_motion(document):
    read = read_scenario(change(document, mean_motion="absent", altitude=500000))
    assert read.problem.mean_motion == mean_motion_at(500e3)


def test_left_out_settings_are_those_of_the_reference_problem(document):
    fields = dict.fromkeys(["time_step", "nodes", "collision_radius", "max_acceleration"], "absent")
    read = read_scenario(change(document, mean_motion="absent", altitude=500e3, **fields))
    assert read.problem == Problem()


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"schema": "absent"}, "schema is missing"),
        ({"schema": "prolearn.scenario/9"}, "schema is 'prolearn.scenario/9'"),
        ({"goal": "absent"}, "goal is missing"),
        ({"radius": 3}, "radius is not a field"),
        ({"collision_radius": -1}, "collision_radius is -1"),
        ({"nodes": 2}, "nodes is 2"),
        ({"time_step": "fast"}, "time_step is 'fast'"),
        ({"altitude": 5e5}, "one of mean_motion"),
        ({"mean_motion": "absent"}, "one of mean_motion"),
        ({"initial": [[0, 0, 0, 0, 0]]}, r"initial\[0\]"),
        ({"initial": [[0, 0, 0, 0, 0, "x"]]}, r"initial\[0\]\[5\] is 'x'"),
        ({"initial": [[float("nan")] * 6] * 3}, r"initial\[0\]\[0\] is nan"),
        ({"goal": [[0.0] * 6]}, "initial has 3 states and goal has 1"),
        ({"initial": [], "goal": []}, "initial"),
    ],
)
def test_a_wrong_field_is_named_with_what_is_wrong(document, fields, words):
    with pytest.raises(InputError, match=words) as caught:
        read_scenario(change(document, **fields))
    assert "scenario.json" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "words"), [("{", "not JSON"), ("[1, 2]", "schema"), ("\xff", "JSON")]
)
def test_what_is_no_scenario_at_all_is_refused(tmp_path, content, words):
    path = tmp_path / "scenario.json"
    path.write_text(content)
    with pytest.raises(InputError, match=words):
        read_scenario(path)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_scenario(tmp_path / "none.json")


def test_formations_within_the_collision_radius_are_refused_with_the_pair():
    drawn = draw("rings", 0, 3, 0, Problem())
    initial = drawn.initial.copy()
    initial[2] = initial[0]
    initial[2, 1] += 3
    with pytest.raises(InputError, match=r"initial\[0\] and initial\[2\] are 3 m apart"):
        check(Scenario(drawn.problem, initial, drawn.goal))


def test_drifting_states_are_refused_unless_allowed_and_the_cure_works():
    drawn = draw("rings", 0, 3, 0, Problem())
    goal = drawn.goal.copy()
    goal[1, 4] += 0.01
    drifting = Scenario(drawn.problem, drawn.initial, goal)
    with pytest.raises(InputError, match=r"goal\[1\] drifts.*--allow-drift") as caught:
        check(drifting)
    check(drifting, allow_drift=True)
    goal[1, 4] = float(str(caught.value).split("set vy to ")[1].split(",")[0])
    check(Scenario(drawn.problem, drawn.initial, goal))


def test_states_that_are_not_finite_are_refused():
    states = np.zeros((2, 6))
    states[1, 3] = np.inf
    with pytest.raises(InputError, match=r"initial\[1\]"):
        Scenario(Problem(), states, np.zeros((2, 6)))


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        (
            '"tilt_deg"',
            '"tilt"',
            r"initial\.rings\[0\]\.tilt is not a field of this schema \(did you "
            r"mean tilt_deg\?\); expected",
        ),
        ('"nodes"', '"node"', r"node is not a field of this schema \(did you mean nodes\?\)"),
        ('"nodes"', '"altogether"', "altogether is not a field of this schema; remove it"),
        ('"nodes": 9', '"nodes": 9, "nodes": 12', "nodes is there twice"),
        ('"size": 200', '"size": 200, "size": 300', "size is there twice"),
        ('"nodes": 9', '"nodes": "9"', "nodes is '9': expected a number, without quotes"),
        ('"nodes": 9', '"nodes": true', "nodes is True: expected a number, without quotes"),
        (
            '"size": 200',
            '"size": "200"',
            r"rings\[0\]\.size is '200': input should be a valid number",
        ),
        (
            '"nodes": 9',
            '"nodes": 9, "corridors": [{"craft": [], "from": 0, "to": 9, "box": {"min": [0, 0, 0], '
            '"max": [1, 1, 1]}}]',
            r"corridors\[0\]: craft is empty; name some, or leave the field out for all",
        ),
    ],
)
def test_what_is_nearly_right_is_refused_with_what_was_meant(tmp_path, before, after, words):
    path = tmp_path / "s.json"
    ring = '{"rings": [{"craft": 3, "size": 200, "tilt_deg": 5}]}'
    text = (
        f'{{"schema": "{SCHEMA}", "altitude": 500000, "nodes": 9, "initial": {ring}, '
        f'"goal": {ring}}}'
    )
    path.write_text(text)
    assert read_scenario(path).problem.nodes == 9
    path.write_text(text.replace(before, after, 1))
    with pytest.raises(InputError, match=words):
        read_scenario(path)


def test_a_byte_order_mark_is_read_over(document):
    read = read_scenario(document)
    document.write_bytes(b"\xef\xbb\xbf" + document.read_bytes())
    assert np.array_equal(read_scenario(document).goal, read.goal)


LISTS = """
from pipeline.errors import InputError
from pipeline.expert import solve
from pipeline.orbit.problem import Problem
from pipeline.scenario import Scenario

states = [[0, 0, 0, 0, 0, 0], [0, 50, 0, 0, 0, 0]]
assert solve(Scenario(Problem(), states, states)).status == "solved"
for bad in ([[0, 0, "x", 0, 0, 0]], [[0.0] * 6, [0.0] * 5], "states", {}):
    try:
        Scenario(Problem(), bad, states)
    except InputError as error:
        assert "initial is no array of numbers" in str(error)
    else:
        assert False, bad
"""


def test_a_scenario_is_built_from_lists_or_says_what_it_wants():
    # Apart from these tests, which have every argument's type checked.
    subprocess.run([sys.executable, "-c", LISTS], check=True)
