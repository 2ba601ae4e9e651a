"""prolearn plan --world: plans that an integrator flies to their goals, from the file alone."""

import json
import re
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
from relative import file_flown

from pipeline.orbit.forces import atmosphere_near
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import R_EARTH, Reference
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.plan.document import read_plan
from pipeline.scenario import draw
from pipeline.scenario.document import write_scenario

OWN = ReferenceOrbit((R_EARTH + 500e3) / 0.7, 0.3, 51.6, 40.0, 30.0, 10.0)

REFERENCE = Reference(datetime(2026, 3, 1, tzinfo=UTC), 51.6, 40.0, 10.0)

LEAVE = "expected one of the two: leave"


@pytest.fixture(autouse=True)
def scenarios(tmp_path):
    """s.json and b.json without an orbit, own.json with one, about which its ends drift."""
    drawn = [draw("dense", 0, 6, index, Problem()) for index in range(2)]
    write_scenario(tmp_path / "s.json", drawn[0])
    write_scenario(tmp_path / "b.json", replace(drawn[1], reference=REFERENCE))
    own = replace(drawn[0], problem=drawn[0].problem.about(OWN), ends="any")
    write_scenario(tmp_path / "own.json", own)


def flown(path, air=None, at_nodes=False):
    """The plan file's fields; its goals are met and its craft are apart, or the test fails."""
    document = json.loads(path.read_text())
    asked = document["scenario"]
    states = file_flown(document, 24, air)
    missed = np.abs(states[:, -1, -1] - np.array(asked["goal"]))
    assert missed[:, :3].max() < 1e-5
    assert missed[:, 3:].max() < 1e-8
    i, j = np.triu_indices(len(states), 1)
    looked = states[:, :, -1 if at_nodes else slice(None), :3]
    apart = np.linalg.norm(looked[i] - looked[j], axis=-1).min()
    assert apart > asked["collision_radius"]
    return document


@pytest.mark.parametrize(
    ("options", "world"),
    [
        ((), {"eccentricity": 0.001, "inclination_deg": 97.4, "j2": True, "ballistic": None}),
        (("--eccentricity", "0.01", "--raan", "30"), {"eccentricity": 0.01, "raan_deg": 30.0}),
        (("--planner", "refiner", "--no-j2"), {"j2": False}),
        (("--assignment", "optimal"), {}),
        (("--planner", "refiner", "--effort", "default"), {}),
    ],
    ids=lambda one: " ".join(one) if isinstance(one, tuple) else "",
)
def test_the_file_alone_is_flown_to_its_goals(run, tmp_path, options, world):
    done = run("plan", "s.json", "--world", *options, "--out", "p.json")
    assert (done.returncode, done.stderr) == (0, "")
    document = flown(tmp_path / "p.json")
    assert document["world"] == document["scenario"]["orbit"]
    for name, value in world.items():  # mean elements, from which osculating ones differ by J2
        near = 2e-3 if name == "eccentricity" else 0.02
        expected = pytest.approx(value, abs=near) if isinstance(value, float) else value
        assert document["world"][name] == expected
    assert document["status"] == "solved"
    assert ("assignment" in document) == ("optimal" in options)
    assert document["certificate"]["fuel_lower_bound_proof"].endswith("to first order")


def test_nodes_and_drag_are_as_asked_for(run, tmp_path):
    asked = ("--separation", "nodes", "--drag", "0.05", "--drag-spread", "0.5")
    done = run("plan", "s.json", "--world", *asked, "--out", "p.json")
    assert done.returncode == 0, done.stderr
    about = json.loads((tmp_path / "p.json").read_text())["world"]
    layer = atmosphere_near(about["semi_major_axis"] * (1 - about["eccentricity"]) - R_EARTH)
    document = flown(tmp_path / "p.json", (layer.base, layer.density, layer.scale), at_nodes=True)
    assert (document["world"]["ballistic"], document["world"]["spread"]) == (0.05, 0.5)
    assert document["separation"] == "nodes"


def test_a_scenarios_own_orbit_or_reference_is_the_world(run, tmp_path):
    done = run("plan", "own.json", "s.json", "b.json", "--world", "--out", "plans", "--json")
    assert done.returncode == 0, done.stderr
    rows = json.loads(done.stdout)
    assert [row["status"] for row in rows] == ["solved"] * 3
    worlds = []
    for row, name in zip(rows, ("own", "s", "b"), strict=True):
        document = flown(tmp_path / "plans" / f"{name}.plan.json")
        assert row["fuel"] == document["certificate"]["fuel"]
        assert row["world"] == document["scenario"]["orbit"]
        assert row["min_separation"] == document["certificate"]["min_separation"]
        worlds.append(document["world"])
    assert read_plan(tmp_path / "plans" / "own.plan.json").scenario.problem.orbit == OWN
    assert worlds[0]["eccentricity"] == 0.3
    assert worlds[1]["inclination_deg"] == pytest.approx(97.4, abs=0.02)
    angles = [worlds[2][f"{name}_deg"] for name in ("inclination", "raan")]
    assert angles == pytest.approx([51.6, 40.0], abs=0.05)


def test_a_scenario_whose_flight_is_refused_is_unsolved_beside_those_that_are_planned(
    run, tmp_path
):
    """A craft that is 6.5 km/s slower than the reference falls to the Earth."""
    path = tmp_path / "own.json"
    asked = json.loads(path.read_text())
    ends = {"initial": [[0, 0, 0, 0, -6500, 0]], "goal": [[0] * 6]}
    path.write_text(json.dumps({**asked, **ends, "time_step": 2000, "nodes": 3}))
    done = run("plan", "own.json", "s.json", "--world", "--out", "plans", "--json")
    assert done.returncode == 1, done.stderr
    refused, planned = json.loads(done.stdout)
    assert (refused["status"], planned["status"]) == ("unsolved", "solved")
    assert "off their goals" in refused["message"]
    assert refused["world"] is None
    assert refused["model_error"] > 1e4
    flown(tmp_path / "plans" / "s.plan.json")
    assert not read_plan(tmp_path / "plans" / "own.plan.json").as_flown


def test_the_table_is_that_of_any_plan_and_no_model_error_is_told(run):
    done = run("plan", "s.json", "--world", "--out", "p.json")
    assert "The plan is p.json." in done.stdout
    (row,) = [line for line in done.stdout.splitlines() if line.startswith("s ")]
    assert " expert " in row and "%" in row
    assert "off" not in done.stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("s.json", "--eccentricity", "0.01"), "--eccentricity is given without --world; expected"),
        (("s.json", "--drag", "0.01"), "--drag is given without --world; expected"),
        (("s.json", "--no-j2"), "--no-j2 is given without --world; expected"),
        (("s.json", "--world", "--drag-spread", "0.1"), "--drag-spread is 0.1 without --drag"),
        (("s.json", "--world", "--eccentricity", "0.1"), "a perigee -187814 m above the Earth"),
        (
            ("own.json", "--world", "--eccentricity", "0.01"),
            f"--eccentricity is given and own.json has an orbit of its own; {LEAVE} it out",
        ),
        (
            ("s.json", "own.json", "--world", "--drag", "0.01"),
            f"--drag is given and own.json has an orbit of its own; {LEAVE} it out",
        ),
    ],
    ids=lambda one: " ".join(one) if isinstance(one, tuple) else "",
)
def test_what_has_no_effect_or_no_proof_is_refused_in_a_sentence(run, tmp_path, arguments, words):
    done = run("plan", *arguments, "--out", "out.json" if len(arguments) < 5 else "out")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1
    assert words in done.stderr
    assert not any((tmp_path / name).exists() for name in ("out.json", "out"))


def test_ends_that_drift_about_the_orbit_are_refused_unless_they_may(run, tmp_path):
    document = json.loads((tmp_path / "own.json").read_text())
    del document["ends"]
    (tmp_path / "own.json").write_text(json.dumps(document))
    done = run("plan", "own.json", "--world", "--out", "p.json")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert re.search(
        r"own\.json: initial\[\d\] drifts [+-][\d.]+ m along-track .* set vy to", done.stderr
    )
    assert run("scenario", "check", "own.json").returncode == 1
    allowed = run("plan", "own.json", "--world", "--allow-drift", "--out", "p.json")
    assert allowed.returncode == 0, allowed.stderr
    found = json.loads(run("scenario", "check", "own.json", "--json").stdout)
    (drifting,) = [
        one for one in found["findings"] if one["rule"] == "energy-matched" and one["end"] == "goal"
    ]
    assert abs(drifting["cases"][0]["numbers"]["drift_per_orbit"]) > 1.0


def test_a_plan_that_is_unsafe_in_the_flight_exits_with_1_and_names_the_pair(run, tmp_path):
    planner = ("--planner", "decoupled-optimum")
    done = run("plan", "s.json", "--world", *planner, "--out", "p.json")
    assert done.returncode == 1
    document = json.loads((tmp_path / "p.json").read_text())
    assert document["status"] == "unsafe"
    i, j = document["certificate"]["min_separation_pair"]
    said = " ".join(done.stdout.split())
    assert f"s.json: unsafe by decoupled optimum: craft {i} and {j} come within " in said
    assert " 0.00% " in said and "-0.00%" not in said, "its fuel is the bound, but for rounding"
    states = file_flown(document, 60)[..., :3]
    apart = np.linalg.norm(states[i] - states[j], axis=-1).min()
    assert apart == pytest.approx(document["certificate"]["min_separation"], abs=0.05)


@pytest.mark.parametrize("name", ["s", "own"])
def test_other_commands_take_the_plan(run, tmp_path, name):
    assert run("plan", f"{name}.json", "--world", "--out", "p.json").returncode == 0
    shown = run("show", "p.json")
    assert (shown.returncode, shown.stdout) == (0, "p.html: 6 craft by expert.\n")
    assert "<strong>Safe</strong>" in (tmp_path / "p.html").read_text()
    assert "Not as claimed" not in (tmp_path / "p.html").read_text()
    for kind in ("csv", "parquet"):
        done = run("convert", "p.json", "--to", kind)
        assert (done.returncode, done.stdout) == (0, f"p.{kind}: 6 craft at 11 nodes.\n")
    lines = (tmp_path / "p.csv").read_text().splitlines()
    assert len(lines) == 1 + 6 * 11


def test_a_tampered_plan_is_not_shown_as_safe(run, tmp_path):
    assert run("plan", "own.json", "--world", "--out", "p.json").returncode == 0
    document = json.loads((tmp_path / "p.json").read_text())
    document["controls"][2][4][1] += 1e-6
    (tmp_path / "p.json").write_text(json.dumps(document))
    shown = run("show", "p.json")
    assert "Misses its goal by" in " ".join(shown.stdout.split())
    document["world"]["eccentricity"] = 0.0
    (tmp_path / "p.json").write_text(json.dumps(document))
    refused = run("show", "p.json")
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)
    assert "world is another orbit than the scenario's" in refused.stderr


def test_waypoints_corridors_and_obstacles_of_a_file_are_kept_in_flight(run, tmp_path):
    own = json.loads((tmp_path / "s.json").read_text())
    fields = {name: own[name] for name in ("schema", "mean_motion", "collision_radius")}
    fields["initial"] = [[0, -300, 0, 0, 0, 0], [0, -400, 0, 0, 0, 0]]
    fields["goal"] = [[0, -100, 0, 0, 0, 0], [0, -320, 0, 0, 0, 0]]
    fields["waypoints"] = [{"craft": 0, "position": [20, -180, 10], "time": 600}]
    fields["corridors"] = [
        {"from": 0, "to": 1200, "box": {"min": [-25, -500, -15], "max": [25, -50, 15]}}
    ]
    fields["obstacles"] = [{"name": "target", "position": [0, 0, 0], "radius": 20}]
    fields["ends"] = "any"
    (tmp_path / "m.json").write_text(json.dumps(fields))
    done = run("plan", "m.json", "--world", "--passive-safety", "0.05", "--out", "p.json")
    assert done.returncode == 0, done.stdout + done.stderr
    states = file_flown(flown(tmp_path / "p.json"), 24)
    assert np.abs(states[0, 4, -1, :3] - [20, -180, 10]).max() < 1e-5
    low, high = states[..., :3].min(axis=(0, 1, 2)), states[..., :3].max(axis=(0, 1, 2))
    assert (low > [-25, -500, -15]).all() and (high < [25, -50, 15]).all()
