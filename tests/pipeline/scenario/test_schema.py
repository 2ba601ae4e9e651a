"""The published JSON Schemas: they are what the code gives, and accept what the code accepts."""

import json
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator

from pipeline.errors import InputError
from pipeline.expert import solve
from pipeline.orbit.problem import Problem
from pipeline.plan.document import json_schema as of_plans
from pipeline.plan.document import plan_document
from pipeline.planners.as_flown import AsFlown
from pipeline.planners.classical import Expert
from pipeline.scenario import draw
from pipeline.scenario.document import json_schema, read_scenario, write_scenario

BOX = {"min": [-9e3, -9e3, -9e3], "max": [9e3, 9e3, 9e3]}
ROOT = Path(__file__).parents[3]
EXAMPLES = sorted((ROOT / "examples").glob("*.json"))


@pytest.mark.parametrize(("name", "made"), [("scenario", json_schema), ("plan", of_plans)])
def test_the_published_schema_is_what_the_code_gives(name, made):
    published = (ROOT / f"docs/schema/{name}.schema.json").read_text(encoding="utf-8")
    assert json.loads(published) == made()


def fields_of(schema):
    for part in (schema, *schema.get("$defs", {}).values()):
        for name, field in part.get("properties", {}).items():
            yield part["title"], name, field


def test_every_field_of_a_scenario_is_described():
    fields = list(fields_of(json_schema()))
    assert len(fields) > 15
    assert [name for title, name, field in fields if len(field.get("description", "")) < 8] == []


@pytest.fixture(scope="module")
def accepts():
    for schema in (json_schema(), of_plans()):
        Draft202012Validator.check_schema(schema)
    return lambda schema, document: Draft202012Validator(schema).is_valid(document)


RING = {"craft": 3, "size": 100.0}
ORBIT = {"semi_major_axis": 8e6, "eccentricity": 0.1}
AT, FORMATION = {"craft": 1, "position": [0, 300, 40]}, {"formation": {"rings": [RING]}}
WAYPOINTS = [
    AT,
    AT | {"velocity": None, "formation": None, "time": 600},
    FORMATION | {"time": 600},
    {},
    {"craft": 2},
    {"position": [0, 0, 0]},
    AT | {"craft": None},
    FORMATION,
    FORMATION | {"time": None},
    FORMATION | AT | {"time": 600},
    FORMATION | {"time": 600, "position": [0, 0, 0]},
    FORMATION | {"time": 600, "velocity": None},
    {"formation": 3, "time": 600},
]

CHANGES = [
    {},
    {"initial": {"rings": [RING]}},
    {"initial": {"rings": [{"phases_deg": [0, 120, 200.5], "size": 100, "tilt_deg": 5}]}},
    {"initial": {"rings": [RING | {"phases_deg": [1]}]}},
    {"initial": {"rings": [{"phases_deg": [0, 120, 200.5], "size": 100, "first_phase_deg": 5}]}},
    {"initial": {"rings": [{"size": 1}]}},
    {"initial": {"rings": [RING | {"tilt_deg": 90}]}},
    {"initial": {"rings": [RING | {"tilt": 1}]}},
    {"initial": {"rings": []}},
    {"initial": [[0, 0, 0, 0, 0]]},
    {"initial": 3},
    {"altitude": 5e5},
    {"altitude": None},
    {"altitude": 5e5, "mean_motion": None},
    {"altitude": None, "mean_motion": None},
    {"orbit": ORBIT},
    {"orbit": ORBIT, "mean_motion": None},
    {"orbit": ORBIT, "mean_motion": None, "altitude": 5e5},
    *({"waypoints": [one]} for one in WAYPOINTS),
    {"nodes": 2},
    {"obstacles": [{"name": "it", "state": [0, 0, 0, 0, 0, 0], "radius": 3}]},
    {"obstacles": [{"name": "it", "position": [0, 0, 0], "semi_axes": [1, 2, 3]}]},
    {"obstacles": [{"name": "it", "state": [0, 0, 0], "radius": 3}]},
    {"obstacles": [{"position": [0, 0, 0], "radius": 3}]},
    {"obstacles": [{"name": "it", "position": [0, 0, 0]}]},
    {"obstacles": [{"name": "it", "radius": 3}]},
    {"craft": [{"radius": 3}, {}, {}]},
    {"corridors": [{"from": 0, "to": 9, "box": {"min": [0, 0, 0], "max": [1, 1, 1]}}]},
    {"corridors": [{"from": 0, "to": 9, "box": {"min": [0, 0, 0]}}]},
    {"corridors": [{"from": 0, "to": 9}]},
    {"corridors": [{"to": 9, "box": {"min": [0, 0, 0], "max": [1, 1, 1]}}]},
    {"corridors": [{"from": 0, "to": 9, "craft": [1], "cone": {"apex": [0, 0, 0]}}]},
    {
        "corridors": [
            {
                "from": 0,
                "to": 9,
                "craft": [1],
                "cone": {"apex": [0, 0, 0], "axis": [0, 1, 0], "half_angle_deg": 20},
            }
        ]
    },
    *(
        {"corridors": [{"from": 0, "to": 9, "craft": craft, "box": BOX}]}
        for craft in ([], [0, 2], None)
    ),
    {"craft": [{"radius": 0}, {}, {}]},
    {"colour": "red"},
    {"reference": {"epoch": "2026-03-01T12:00:00Z"}},
    {
        "reference": {
            "epoch": "2026-03-01T12:00:00Z",
            "inclination_deg": 97,
            "raan_deg": 0,
            "argument_of_latitude_deg": 0,
        }
    },
]


@pytest.mark.parametrize("change", CHANGES, ids=str)
def test_an_independent_validator_accepts_what_is_read_and_refuses_what_is_refused(
    change, accepts, tmp_path
):
    path = tmp_path / "scenario.json"
    write_scenario(path, draw("rings", 0, 3, 0, Problem()))
    document = json.loads(path.read_text()) | change
    path.write_text(json.dumps(document))
    try:
        read_scenario(path)
        read = True
    except InputError:
        read = False
    assert accepts(json_schema(), document) == read


@pytest.mark.parametrize("file", EXAMPLES, ids=lambda file: file.stem)
def test_an_independent_validator_accepts_the_examples(file, accepts):
    assert accepts(json_schema(), json.loads(file.read_text(encoding="utf-8")))


def test_an_independent_validator_accepts_plans_as_flown(accepts):
    scenario = read_scenario(ROOT / "examples/tandem-x-both.json")
    (plan,) = AsFlown(Expert()).plan([scenario])
    assert accepts(of_plans(), json.loads(json.dumps(plan_document(plan))))


def test_an_independent_validator_accepts_plans_and_refuses_others(accepts):
    for limit in (None, 1e-6):
        scenario = draw("rings", 0, 2, 0, Problem(max_acceleration=limit))
        document = json.loads(json.dumps(plan_document(solve(scenario))))
        assert accepts(of_plans(), document)
        assert not accepts(of_plans(), document | {"status": "done"})
