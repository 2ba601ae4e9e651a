"""prolearn convert: a plan in the formats of others, or a sentence that says why not."""

import csv
import json
import os
import subprocess
import sys
from io import BytesIO

import numpy as np
import pyarrow.parquet as pq
import pytest
from hostile import HOSTILE, SEEN
from oem import OrbitEphemerisMessage

from pipeline.orbit.problem import Problem
from pipeline.scenario import draw
from pipeline.scenario.document import write_scenario

WHERE = {
    "epoch": "2026-03-01T12:00:00Z",
    "inclination_deg": 97.4,
    "raan_deg": 40,
    "argument_of_latitude_deg": 0,
}

MASSES = ("--mass", 12, "--specific-impulse", 220)


@pytest.fixture
def planned(run, tmp_path):
    """Plan a draw, with a reference orbit or without, and perhaps unsafely."""

    def plan(reference=None, planner="expert", index=0):
        write_scenario(tmp_path / "s.json", draw("dense", 0, 11, index, Problem()))
        document = json.loads((tmp_path / "s.json").read_text()) | {"reference": reference}
        (tmp_path / "s.json").write_text(json.dumps(document))
        return run("plan", "s.json", "--out", "p.json", "--planner", planner)

    return plan


def test_each_craft_has_a_file_that_another_reader_reads(run, planned, tmp_path):
    assert planned(WHERE).returncode == 0
    done = run("convert", "p.json", "--to", "oem", "--out", "ephemerides")
    assert done.returncode == 0, done.stderr
    files = sorted((tmp_path / "ephemerides").iterdir())
    assert [file.name for file in files] == [f"craft-{k:02d}.oem" for k in range(11)]
    message = OrbitEphemerisMessage.open(files[3])
    assert len(list(message.segments)) == 10


def test_tables_are_named_after_the_plan(run, planned, tmp_path):
    planned()
    assert run("convert", "p.json", "--to", "csv").returncode == 0
    assert run("convert", "p.json", "--to", "parquet").returncode == 0
    assert len((tmp_path / "p.csv").read_text().splitlines()) == 1 + 11 * 11
    assert pq.read_table(tmp_path / "p.parquet").num_rows == 11 * 11


def test_a_plan_whose_name_is_not_utf_8_is_converted_all_the_same(run, planned, tmp_path):
    planned()
    name = os.fsdecode(b"sw\xe9rm")
    (tmp_path / "p.json").rename(tmp_path / f"{name}.json")
    done = run("convert", f"{name}.json", "--to", "parquet")
    assert done.returncode == 0, done.stderr
    assert pq.read_table(BytesIO((tmp_path / f"{name}.parquet").read_bytes())).num_rows == 11 * 11


@pytest.mark.parametrize("world", [(), ("--world",)])
def test_without_a_reference_orbit_the_sentence_says_what_to_add_and_that_helps(
    run, planned, tmp_path, world
):
    planned()
    run("plan", "s.json", "--out", "p.json", *world)
    done = run("convert", "p.json", "--to", "oem")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert not (tmp_path / "p").exists()
    assert '"orbit"' not in done.stderr, "which would not say when"
    added = done.stderr[done.stderr.index('"reference"') :].split("} ")[0] + "}"
    document = json.loads((tmp_path / "p.json").read_text())
    document["scenario"] |= json.loads("{" + added + "}")
    (tmp_path / "p.json").write_text(json.dumps(document))
    assert run("convert", "p.json", "--to", "oem").returncode == 0


def test_an_unsafe_plan_is_handed_over_with_status_1_and_the_pair_and_time_named(
    run, planned, tmp_path
):
    assert planned(WHERE, planner="decoupled-optimum").returncode == 1
    done = run("convert", "p.json", "--to", "oem", "--out", "o")
    assert done.returncode == 1
    pair = json.loads((tmp_path / "p.json").read_text())["certificate"]["min_separation_pair"]
    assert f"craft {pair[0]} and {pair[1]} come within" in done.stderr
    assert "decoupled optimum: unsafe." in (tmp_path / "o" / "craft-00.oem").read_text()


def test_an_ephemeris_has_the_name_of_the_planner_in_comments_alone(run, planned, tmp_path):
    planned(WHERE)
    document = json.loads((tmp_path / "p.json").read_text()) | {"planner": HOSTILE}
    (tmp_path / "p.json").write_text(json.dumps(document))
    assert run("convert", "p.json", "--to", "oem", "--out", "o").returncode == 0
    path = tmp_path / "o/craft-00.oem"
    lines = path.read_text(encoding="ascii").splitlines()
    assert max(map(len, lines)) <= 254, "as CCSDS 502.0-B has it"
    head = lines[1 : next(k for k, line in enumerate(lines) if line.startswith("CREATION_DATE"))]
    assert all(line.startswith("COMMENT ") for line in head)
    told = " ".join(line.removeprefix("COMMENT ") for line in head)
    assert told.startswith(f"Craft 0 of 11, planned by {SEEN}: solved. Relative motion")
    assert len(list(OrbitEphemerisMessage.open(path).segments)) == 10


def test_what_is_there_already_and_of_the_other_kind_is_left_alone(run, planned, tmp_path):
    planned(WHERE)
    (tmp_path / "taken").write_text("mine")
    done = run("convert", "p.json", "--to", "oem", "--out", "taken")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "taken is a file; expected a folder for oem" in done.stderr
    assert (tmp_path / "taken").read_text() == "mine"
    (tmp_path / "folder").mkdir()
    done = run("convert", "p.json", "--to", "csv", "--out", "folder")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "folder is a folder; expected a file for csv" in done.stderr
    before = (tmp_path / "p.json").read_bytes()
    done = run("convert", "p.json", "--to", "csv", "--out", "p.json")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert (tmp_path / "p.json").read_bytes() == before


def test_of_a_link_the_file_that_it_names_is_replaced(run, planned, tmp_path):
    planned()
    (tmp_path / "real.csv").write_text("old")
    (tmp_path / "link.csv").symlink_to("real.csv")
    assert run("convert", "p.json", "--to", "csv", "--out", "link.csv").returncode == 0
    assert (tmp_path / "link.csv").readlink().name == "real.csv"
    assert len((tmp_path / "real.csv").read_text().splitlines()) == 1 + 11 * 11


def test_a_link_that_leads_to_itself_is_refused(run, planned, tmp_path):
    planned()
    (tmp_path / "link.csv").symlink_to("link.csv")
    done = run("convert", "p.json", "--to", "csv", "--out", "link.csv")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "link.csv is a link that leads to itself; expected the name of a file" in done.stderr


@pytest.mark.parametrize(
    "command",
    [
        ("convert", "p.json", "--to", "csv", "--out", "pipe"),
        ("show", "p.json", "--out", "pipe"),
        ("plan", "s.json", "--out", "pipe"),
        ("scenario", "new", "pipe", "--force"),
    ],
    ids=lambda command: command[0],
)
def test_no_file_takes_the_place_of_a_pipe(run, planned, tmp_path, command):
    planned()
    os.mkfifo(tmp_path / "pipe")
    done = run(*command)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "pipe is a pipe, a socket or a device; expected" in done.stderr
    assert (tmp_path / "pipe").is_fifo()


def test_a_plan_without_its_scenario_is_refused_in_a_sentence(run, planned, tmp_path):
    planned(WHERE)
    document = json.loads((tmp_path / "p.json").read_text()) | {"schema": "prolearn.plan/1"}
    del document["scenario"]
    (tmp_path / "p.json").write_text(json.dumps(document))
    done = run("convert", "p.json", "--to", "csv")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "prolearn.plan/1, which leaves out the scenario" in done.stderr


@pytest.mark.parametrize("form", ["csv", "parquet", "oem", "opm", "burns", "basilisk"])
@pytest.mark.parametrize("node", [0, 5])
def test_a_plan_whose_states_are_not_its_controls_is_no_file(run, planned, tmp_path, form, node):
    """As where a digit of a file was damaged."""
    planned(WHERE)
    document = json.loads((tmp_path / "p.json").read_text())
    document["states"][2][node][1] += 0.1
    (tmp_path / "p.json").write_text(json.dumps(document))
    masses = MASSES if form == "opm" else ()
    done = run("convert", "p.json", "--to", form, "--out", "o", *masses)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("prolearn: p.json: the plan's states are up to 0.1 m off")
    assert not (tmp_path / "o").exists()


@pytest.mark.parametrize("form", ["oem", "opm"])
def test_files_of_craft_that_an_earlier_plan_had_do_not_stay_beside_a_new_one(run, tmp_path, form):
    (tmp_path / "out").mkdir()
    others = {"craft-7.oem", "craft-7.opm"}
    for name in others:
        (tmp_path / "out" / name).write_text("of somebody else")
    where = ("--epoch", WHERE["epoch"], "--inclination", "97", "--raan", "4")
    masses = MASSES if form == "opm" else ()
    for n in (12, 5):
        name, place = f"{n}.json", ("--argument-of-latitude", "0")
        run("scenario", "new", name, "--n", n, *where, *place)
        run("plan", name, "--out", "p.json")
        done = run("convert", "p.json", "--to", form, "--out", "out", *masses)
        assert done.returncode == 0
    kept = {file.name for file in (tmp_path / "out").iterdir()}
    assert kept == {*(f"craft-{k}.{form}" for k in range(5)), *others}


def test_a_script_for_basilisk_ends_where_fly_says(run, tmp_path):
    wide = ("--from", "craft=3,size=2000", "--to", "craft=3,size=1500,tilt_deg=20")
    run("scenario", "new", "s.json", *wide, "--eccentricity", 0.01)
    assert run("plan", "s.json", "--out", "p.json").returncode == 0
    done = run("convert", "p.json", "--to", "basilisk", "--mass", "4,8,12")
    assert (done.returncode, done.stdout) == (0, "p.basilisk.py: 3 craft at 11 nodes.\n")
    command = [sys.executable, "p.basilisk.py", "nodes.csv"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    with (tmp_path / "nodes.csv").open(newline="") as file:
        last = [row for row in csv.DictReader(file) if row["node"] == "10"]
    ends = [[float(row[name]) for name in ("x", "y", "z", "vx", "vy", "vz")] for row in last]
    goal = json.loads((tmp_path / "p.json").read_text())["scenario"]["goal"]
    flown = json.loads(run("fly", "p.json", "--json").stdout)
    assert np.array(ends) - goal == pytest.approx(np.array(flown["goal_errors"]), abs=0.005)
    assert flown["goal_error"] > 0.05, "or this would be the plan's own motion"


def test_an_unsafe_plan_is_a_list_of_burns_too_with_status_1(run, planned, tmp_path):
    planned(planner="decoupled-optimum")
    done = run("convert", "p.json", "--to", "burns", "--mass", 12)
    assert (done.returncode, done.stdout) == (1, "p.burns.csv: 11 craft at 11 nodes.\n")
    burns = json.loads((tmp_path / "p.json").read_text())["controls"]
    thrusting = sum(any(control) for craft in burns for control in craft)
    assert len((tmp_path / "p.burns.csv").read_text().splitlines()) == 1 + thrusting


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("opm",), "expected mass (kg) and specific_impulse (s)"),
        (("opm", "--mass", "12"), "the specific impulse is not known"),
        (("opm", "--mass", "1,2", "--specific-impulse", "220"), "mass is 1, 2; expected a numb"),
        (("burns", "--specific-impulse", "220"), "specific_impulse is given without mass"),
        (("burns", "--mass", "heavy"), "--mass is 'heavy'; expected numbers"),
        (("basilisk", *MASSES), "specific_impulse is given, and basilisk has no place for it"),
        (("oem", "--mass", "12"), "mass is given, and oem has no place for it"),
        (("opm", "--out", "-", *MASSES), "opm is no text for standard output"),
    ],
)
def test_masses_that_are_missing_or_not_used_are_refused_in_a_sentence(
    run, planned, tmp_path, arguments, words
):
    planned(WHERE)
    before = sorted(tmp_path.iterdir())
    done = run("convert", "p.json", "--to", *arguments)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert words in done.stderr
    assert sorted(tmp_path.iterdir()) == before
