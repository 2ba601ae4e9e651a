"""prolearn fly: what a person reads, what a program reads, and what is refused."""

import json
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from pipeline.expert import decoupled_optima, solve
from pipeline.flight.world import Conditions
from pipeline.orbit.corridors import Box, Corridor
from pipeline.orbit.participants import Obstacle
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import Reference
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.plan.document import plan_document, write_plan
from pipeline.plan.judge import Draft, certified_plan
from pipeline.scenario import Scenario, draw

SCENARIO = draw("rings", 0, 10, 3, Problem())

REFERENCE = Reference(datetime(2026, 3, 1, tzinfo=UTC), 51.6, 40.0, 10.0)


@pytest.fixture
def flown(run, tmp_path):
    """Fly the expert's plan with options."""
    write_plan(tmp_path / "plan.json", solve(SCENARIO))
    return lambda *options: run("fly", "plan.json", *options)


def test_the_table_fits_80_columns_and_says_what_the_document_says(flown):
    table, told = flown("--drag", "0.01"), flown("--drag", "0.01", "--json")
    assert table.stderr == "" and told.stderr == ""
    lines = table.stdout.splitlines()
    assert max(map(len, lines)) <= 80
    report = json.loads(told.stdout)
    assert table.returncode == told.returncode == (0 if report["safe"] else 1)
    assert [row["effect"] for row in report["effects"]] == [
        *("plan", "curvature", "eccentricity", "J2", "drag")
    ]
    last = report["effects"][-1]
    assert report["goal_error"] == last["goal_error"] > 0.1
    (row,) = [line for line in lines if line.startswith("+ drag")]
    i, j = report["min_separation_pair"]
    apart = f"{report['min_separation']:.2f}"
    assert row.split()[2] == f"{last['goal_error']:#.3g}"
    assert row.split()[-3:] == [f"{i},{j}", f"{report['min_separation_time']:.0f}", apart]
    assert f"Δv is {report['delta_v']:#.3g} m/s, as planned." in lines
    miss = report["goal_errors"][report["goal_error_craft"]][:3]
    assert sum(one**2 for one in miss) ** 0.5 == pytest.approx(report["goal_error"])


def test_defaults_are_those_of_the_conditions(flown):
    said = json.loads(flown("--json").stdout)["conditions"]
    assert ReferenceOrbit(**said) == Conditions().orbit(SCENARIO.problem)


def test_the_scenarios_reference_orbit_is_flown_unless_options_say_otherwise(run, tmp_path):
    write_plan(tmp_path / "plan.json", solve(replace(SCENARIO, reference=REFERENCE)))
    said = json.loads(run("fly", "plan.json", "--raan", "7", "--json").stdout)["conditions"]
    expected = Conditions(0.001, 51.6, 7.0, 90.0, 10.0).orbit(SCENARIO.problem)
    assert ReferenceOrbit(**said) == expected


def test_a_pair_that_comes_too_close_is_named_and_the_status_is_1(run, tmp_path):
    own = decoupled_optima(SCENARIO.initial, SCENARIO.goal, SCENARIO.problem)
    draft = Draft(own.controls, float(own.lower_bound.sum()))
    plan = certified_plan("decoupled optimum", SCENARIO, draft)
    i, j = plan.certificate.min_separation_pair
    assert plan.certificate.min_separation < 14
    write_plan(tmp_path / "plan.json", plan)
    done = run("fly", "plan.json")
    assert done.returncode == 1
    assert f"Not safe: craft {i} and {j} come within " in done.stdout.replace("\n", " ")


def test_two_craft_in_one_place_come_too_close(run, tmp_path):
    """The bound on their separation is 0, which is not none."""
    alone = draw("rings", 0, 1, 0, Problem())
    both = replace(alone, initial=[*alone.initial] * 2, goal=[*alone.goal] * 2)
    own = decoupled_optima(both.initial, both.goal, both.problem)
    draft = Draft(own.controls, float(own.lower_bound.sum()))
    plan = certified_plan("decoupled optimum", both, draft)
    write_plan(tmp_path / "plan.json", plan)
    done = run("fly", "plan.json")
    assert done.returncode == 1
    assert "Not safe: craft 0 and 1 come within 0.00 m" in done.stdout.replace("\n", " ")


def test_a_craft_alone_is_safe(run, tmp_path):
    scenario = draw("rings", 0, 1, 0, Problem())
    write_plan(tmp_path / "plan.json", solve(scenario))
    done = run("fly", "plan.json")
    assert done.returncode == 0, done.stderr
    told = json.loads(run("fly", "plan.json", "--json").stdout)
    assert told["safe"] and told["min_separation"] is None


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--eccentricity", "0.9"), "eccentricity is 0.9; expected a number from 0 to 0.85"),
        (("--eccentricity", "-0.001"), "eccentricity is -0.001"),
        (("--inclination", "nan"), "inclination_deg is nan"),
        (("--drag", "-1"), "prolearn: --drag is -1; expected a positive C_D A/m"),
        (("--drag-spread", "0.2"), "--drag-spread is 0.2 without --drag"),
        (("--drag", "0.01", "--drag-spread", "2"), "prolearn: --drag-spread is 2; expected"),
    ],
    ids=" ".join,
)
def test_conditions_that_make_no_sense_are_answered_in_a_sentence(flown, options, words):
    done = flown(*options)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert words in done.stderr


def version_1(document):
    document["schema"] = "prolearn.plan/1"
    del document["scenario"]


def overflow(document):
    document["controls"][2][3][0] = 1e300


def low(document):
    document["scenario"]["mean_motion"] = 1.2e-3


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (version_1, "leaves out the scenario"),
        (overflow, "plan.json: the controls lead craft 2 "),
        (low, "plan.json: the reference orbit is 133 km high; expected at least 150 km for drag"),
    ],
)
def test_a_plan_that_cannot_be_flown_is_answered_in_a_sentence(run, tmp_path, change, words):
    document = json.loads(json.dumps(plan_document(solve(SCENARIO))))
    change(document)
    (tmp_path / "plan.json").write_text(json.dumps(document))
    done = run("fly", "plan.json", "--drag", "0.01")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert words in done.stderr


@pytest.mark.parametrize("radius", [60.0, 95.0])
@pytest.mark.parametrize(
    "options", [("--eccentricity", "0", "--no-j2"), ("--eccentricity", "0.02")]
)
def test_obstacles_and_corridors_are_in_table_and_document_and_decide_the_status(
    run, tmp_path, radius, options
):
    ends = np.array([[[0.0, -200.0, 0, 0, 0, 0]], [[0.0, 200.0, 0, 0, 0, 0]]])
    target = Obstacle("target", (0.0,) * 6, radius=60.0, hold=True)
    room = Corridor(Box((-150.0, -300.0, -150.0), (150.0, 200.2, 150.0)), 600.0, 1200.0)
    made = solve(Scenario(Problem(), *ends, obstacles=(target,), corridors=(room,)))
    assert made.status == "solved"
    larger = replace(made.scenario, obstacles=(replace(target, radius=radius),))
    write_plan(tmp_path / "plan.json", replace(made, scenario=larger))
    asked = "plan.json", *options, "--passive-safety", "0.1"
    table, told = run("fly", *asked), run("fly", *asked, "--json")
    assert told.stdout, told.stderr
    report = json.loads(told.stdout)
    clear, inside = report["clearance"], report["corridor"]
    adrift = report["passive_safety"]["clearance"]
    assert report["min_separation"] is None
    assert clear["other"] == adrift["other"] == "target"
    assert (clear["min_clearance_bound"] > 0) == (radius == 60.0)
    assert (inside["min_margin_bound"] > 0) == ("--no-j2" in options)
    assert report["safe"] == (radius == 60.0 and "--no-j2" in options)
    assert table.returncode == told.returncode == (0 if report["safe"] else 1)
    assert max(map(len, table.stdout.splitlines()[:-1])) <= 80
    text = " ".join(table.stdout.split())
    assert f"0,target {clear['time']:.0f} {clear['min_clearance']:+.2f}" in text
    margin, by = inside["min_margin"], clear["min_clearance"]
    where = f"{abs(margin):.2f} m {'in' if margin > 0 else 'out'}side corridors[0] at"
    assert f"{'Craft' if margin > 0 else 'Not kept: craft'} 0 is {where}" in text
    if by > 0:
        assert f"Craft 0 keeps clear of target by {by:.2f} m" in text
    else:
        assert f"Not safe: craft 0 comes {-by:.2f} m too close to target" in text
    assert ("Not passively safe: Adrift" in text) == (adrift["min_clearance_bound"] <= 0)
