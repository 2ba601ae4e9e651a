"""prolearn scenario: what is written can be planned, and what is wrong is said with its status."""

import json
import re

import numpy as np

from pipeline.flight.world import Conditions
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import R_EARTH, mean_motion_at
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.scenario import draw
from pipeline.scenario.document import read_scenario, write_scenario


def test_a_draw_is_that_of_the_dataset_with_the_same_arguments(run, tmp_path):
    asked = (
        "--family",
        "tilt-split",
        "--n",
        "4",
        "--seed",
        "3",
        "--index",
        "2",
        "--split",
        "valid",
    )
    done = run("scenario", "new", "s.json", *asked, "--altitude", "600e3", "--nodes", "9")
    assert done.returncode == 0, done.stderr
    problem = Problem(mean_motion=mean_motion_at(600e3), nodes=9)
    wanted, made = draw("tilt-split", 3, 4, 2, problem, "valid"), read_scenario(tmp_path / "s.json")
    assert made.problem == problem
    assert (made.initial == wanted.initial).all() and (made.goal == wanted.goal).all()


def test_rings_of_ones_own_are_written_checked_and_planned(run, tmp_path):
    ends = ("--from", "craft=4,size=200,tilt_deg=20", "--to", "craft=2,size=90")
    ends += ("--to", "craft=2,size=250,first_phase_deg=45")
    where = ("--epoch", "2026-03-01T12:00:00Z", "--inclination", "97.4", "--raan", "40")
    where += ("--argument-of-latitude", "10")
    assert run("scenario", "new", "s.json", *ends, *where).returncode == 0
    checked = run("scenario", "check", "s.json")
    assert checked.returncode == 0, checked.stdout + checked.stderr
    assert checked.stdout.count(" fine ") == 8
    planned = run("plan", "s.json", "--out", "p.json")
    assert planned.returncode == 0, planned.stderr
    kept = json.loads((tmp_path / "p.json").read_text())["scenario"]
    assert np.shape(kept["goal"]) == (4, 6)
    assert kept["reference"]["raan_deg"] == 40.0


def test_the_command_that_checks_a_file_is_one_for_a_shell_whatever_the_name(run):
    done = run("scenario", "new", "my swarm.json", "--n", "2", "--family", "rings")
    assert done.stdout.rstrip().endswith("prolearn scenario check 'my swarm.json'"), done.stderr


def test_rings_about_an_eccentric_orbit_are_written_checked_and_planned(run, tmp_path):
    """By mean elements, as plan's conditions; at an epoch the reference has the same angles."""
    ends = ("--from", "craft=4,size=200,tilt_deg=20", "--to", "craft=4,size=90")
    where = ("--eccentricity", "0.01", "--inclination", "51.6", "--raan", "40")
    epoch = ("--epoch", "2026-03-01T12:00:00Z")
    done = run("scenario", "new", "s.json", *ends, *where, *epoch)
    assert done.returncode == 0, done.stderr
    written = json.loads((tmp_path / "s.json").read_text())
    assert "rings" in written["goal"] and "altitude" not in written
    made = read_scenario(tmp_path / "s.json")
    conditions = Conditions(0.01, 51.6, 40.0).orbit(Problem())
    np.testing.assert_allclose(made.problem.orbit.begin, conditions.begin, rtol=1e-9, atol=1e-6)
    assert made.reference.raan_deg == made.problem.orbit.raan_deg
    checked = run("scenario", "check", "s.json")
    assert checked.returncode == 0, checked.stdout
    assert "no craft drifts along-track by more than 0.000 m" in " ".join(checked.stdout.split())
    planned = run("plan", "s.json", "--world", "--out", "p.json")
    assert planned.returncode == 0, planned.stderr
    assert "mean eccentricity 0.01, inclination 51.6" in planned.stdout


def test_a_draw_about_an_orbit_has_no_epoch_of_its_own(run, tmp_path):
    about = ("--eccentricity", "0", "--inclination", "51.6", "--no-j2")
    assert run("scenario", "new", "s.json", "--family", "dense", *about).returncode == 0
    made = read_scenario(tmp_path / "s.json")
    assert made.reference is None
    wanted = ReferenceOrbit(R_EARTH + 500e3, 0.0, 51.6, 0.0, 90.0, 0.0, j2=False)
    assert made.problem.orbit == wanted
    refused = run("scenario", "new", "t.json", "--argument-of-perigee", "20")
    assert refused.returncode == 2
    assert "--argument-of-perigee is given without --eccentricity" in refused.stderr


def faulty(path):
    """A scenario with something wrong in every respect."""
    drawn = draw("rings", 0, 8, 0, Problem(max_acceleration=1e-5))
    drawn.initial[3, :3] = drawn.initial[1, :3] + [3, 0, 4]
    drawn.goal[2, 4] += 0.02
    write_scenario(path, drawn)


def test_all_that_is_wrong_is_said_on_80_columns_with_status_1(run, tmp_path):
    faulty(tmp_path / "s.json")
    done = run("scenario", "check", "s.json", FORCE_COLOR="1", TERM="dumb")
    assert (done.returncode, done.stderr) == (1, "")
    assert max(map(len, done.stdout.splitlines())) <= 80
    said = " ".join(done.stdout.split())
    assert "initial[1] and initial[3] are 5 m apart" in said
    assert "goal[2] drifts -340.6 m along-track an orbit" in said  # 6π/e · 0.02 m/s
    assert "initial[1] and initial[3] come within" in said
    assert "and 3 more, which --json has" in said
    assert "goal craft apart fine" in said


def test_nothing_is_cut_on_a_narrow_terminal_or_wrapped_off_one(run, tmp_path):
    faulty(tmp_path / "s.json")
    found = json.loads(run("scenario", "check", "s.json", "--json").stdout)["findings"]
    narrow = run("scenario", "check", "s.json", COLUMNS="40", FORCE_COLOR="1", TERM="xterm")
    assert max(map(len, re.sub(r"\x1b\[[\d;]*m", "", narrow.stdout).splitlines()[2:])) <= 40
    assert "…" not in narrow.stdout
    plain = run("scenario", "check", "s.json", COLUMNS="40").stdout.splitlines()
    for finding in found:
        assert [line for line in plain if line.endswith(finding["text"])]
        assert all(f"    {case['text']}" in plain for case in finding["cases"][:5])


def test_the_columns_of_all_rows_line_up(run, tmp_path):
    """The longest rule name, that of waypoints, sets the width of the column."""
    run("scenario", "new", "s.json", "--n", "2")
    document = json.loads((tmp_path / "s.json").read_text())
    places = [[9, 300, 40], [9, -300, 40]]
    document["waypoints"] = [
        {"craft": k, "position": place, "time": 600} for k, place in enumerate(places)
    ]
    box = {"min": [-900] * 3, "max": [900] * 3}
    document["corridors"] = [{"from": 0, "to": 1200, "box": box}]
    (tmp_path / "s.json").write_text(json.dumps(document))
    rows = run("scenario", "check", "s.json").stdout.splitlines()
    verdicts = [row.index(" fine ") for row in rows if " fine " in row]
    assert len(verdicts) > 6 and len(set(verdicts)) == 1
    assert any("waypoints apart" in row for row in rows)
    assert any("inside corridors" in row for row in rows)


def test_json_has_every_fault_with_its_numbers(run, tmp_path):
    faulty(tmp_path / "s.json")
    done = run("scenario", "check", "s.json", "--json")
    assert done.returncode == 1
    told = json.loads(done.stdout)
    assert told["fine"] is False
    (reach,) = [one for one in told["findings"] if one["rule"] == "within reach"]
    assert sorted(case["craft"] for case in reach["cases"]) == [[k] for k in range(8)]
    assert all(case["numbers"]["least_limit"] > 1e-5 for case in reach["cases"])


def test_a_file_that_cannot_be_read_has_status_2_and_all_its_faults_in_one_line(run, tmp_path):
    run("scenario", "new", "s.json", "--n", "2")
    document = json.loads((tmp_path / "s.json").read_text())
    document |= {"nodes": 1, "goal": {"rings": [{"craft": 2, "size": 9, "tilt": 3}]}}
    document |= {"thrust": "gas", "craft": [1, {}]}
    (tmp_path / "s.json").write_text(json.dumps(document))
    done = run("scenario", "check", "s.json")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert "nodes is 1" in done.stderr
    assert "goal.rings[0].tilt is not a field" in done.stderr
    assert "thrust is 'gas': input should be 'components' or 'norm'; thrust is" in done.stderr
    assert "craft[0] is 1: input should be an object, {" in done.stderr


def test_a_file_that_is_there_is_replaced_only_with_force(run, tmp_path):
    (tmp_path / "s.json").write_text("mine")
    refused = run("scenario", "new", "s.json", "--n", "2")
    assert refused.returncode == 2
    assert "--force" in refused.stderr
    assert (tmp_path / "s.json").read_text() == "mine"
    assert run("scenario", "new", "s.json", "--n", "2", "--force").returncode == 0
    assert read_scenario(tmp_path / "s.json").n == 2


def test_options_that_do_not_go_together_are_refused_in_a_sentence(run, tmp_path):
    ring = "craft=2,size=100"
    for options, word in (
        (("--from", ring), "--from or --to alone"),
        (("--from", ring, "--to", ring, "--seed", "0"), "--seed is given"),
        (("--from", ring, "--to", "100"), "--to is '100'"),
        (("--from", ring, "--to", "craft=2,size=9,craft=3"), "fields of a ring, each once"),
        (("--from", ring, "--to", "craft=2,size=9,tilt_deg=x"), "goal.rings[0].tilt_deg is 'x'"),
        (("--n", "0"), "n is 0"),
        (("--altitude", "-1"), "altitude"),
        (("--raan", "3"), "all of --epoch, --inclination, --raan and"),
    ):
        done = run("scenario", "new", "s.json", *options)
        assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
        assert word in done.stderr
        assert not (tmp_path / "s.json").exists()


def test_the_schema_is_printed_as_json(run):
    for options, field in (((), "initial"), (("--plan",), "certificate")):
        done = run("scenario", "schema", *options)
        assert field in json.loads(done.stdout)["properties"]
