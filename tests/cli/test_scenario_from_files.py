"""prolearn scenario new from inertial states: plans handed over and back by commands alone."""

import json
import subprocess
from datetime import datetime, timedelta, timezone

import numpy as np
import pytest

from pipeline.scenario.document import document_of
from prolearn import scenario_from_files

WHERE = ("--epoch", "2026-03-01T12:00:00Z", "--inclination", "97.4", "--raan", "40")
WHERE += ("--argument-of-latitude", "10")
CHIEF = ("semi_major_axis", "eccentricity", "inclination_deg", "raan_deg")
CHIEF += ("argument_of_perigee_deg", "argument_of_latitude_deg")


@pytest.fixture
def handed_over(run, tmp_path):
    """The scenario of a plan as flown, whose ephemerides are in the folder oem."""
    run("scenario", "new", "s.json", "--n", "3", *WHERE)
    planned = run("plan", "s.json", "--world", "--eccentricity", "0.01", "--out", "p.json")
    assert planned.returncode == 0, planned.stderr
    done = run("convert", "p.json", "--to", "oem", "--out", "oem")
    assert done.returncode == 0, done.stderr
    scenario = json.loads((tmp_path / "p.json").read_text())["scenario"]
    row = ",".join(repr(scenario["orbit"][name]) for name in CHIEF)
    (tmp_path / "chief.csv").write_text(f"{','.join(CHIEF)}\n{row}\n")
    return scenario


def test_a_plan_as_flown_comes_back_and_can_be_planned_again(run, handed_over, tmp_path):
    both = ("--initial", "oem", "--goal", "oem", "--chief", "chief.csv")
    done = run("scenario", "new", "back.json", *both)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("back.json: 3 craft, 20 min in 10 intervals")
    made = json.loads((tmp_path / "back.json").read_text())
    for end in ("initial", "goal"):
        off = np.abs(np.array(made[end]) - handed_over[end])
        assert off[:, :3].max() < 1e-5 and off[:, 3:].max() < 1e-8
    for name in CHIEF:
        assert made["orbit"][name] == pytest.approx(handed_over["orbit"][name], rel=1e-6)
    assert made["reference"]["epoch"] == "2026-03-01T12:00:00Z"
    assert run("plan", "back.json", "--world", "--out", "q.json").returncode == 0
    plans = [json.loads((tmp_path / name).read_text()) for name in ("p.json", "q.json")]
    fuel, again = (plan["certificate"]["fuel"] for plan in plans)
    assert again == pytest.approx(fuel, rel=1e-6)


def test_one_ephemeris_on_standard_input_is_both_ends_and_the_chief(handed_over, forked, tmp_path):
    file = min((tmp_path / "oem").iterdir())
    made = []
    for name in ("-", file):
        files = [part for option in ("--initial", "--goal", "--chief") for part in (option, name)]
        done = subprocess.run(
            [*forked.command, "scenario", "new", "-", *map(str, files)],
            input=file.read_text(),
            capture_output=True,
            text=True,
            cwd=tmp_path,
        )
        assert done.returncode == 0, done.stderr
        made.append(done.stdout)
    assert made[0] == made[1]


def test_other_nodes_and_forces_are_as_they_are_asked_for(run, handed_over, tmp_path):
    both = ("--initial", "oem", "--goal", "oem", "--time-step", "60", "--nodes", "6")
    more = ("--epoch", "2026-03-01T12:02:00Z", "--no-j2", "--drag", "0.01", "--drag-spread", "0.2")
    done = run("scenario", "new", "-", *both, *more)
    assert done.returncode == 0, done.stderr
    made = json.loads(done.stdout)
    called = scenario_from_files(
        tmp_path / "oem",
        str(tmp_path / "oem"),
        epoch=datetime(2026, 3, 1, 13, 2, tzinfo=timezone(timedelta(hours=1))),
        time_step=60.0,
        nodes=6,
        j2=False,
        ballistic=0.01,
        spread=0.2,
    )
    assert document_of(called) == made
    assert (made["time_step"], made["nodes"]) == (60.0, 6)
    orbit = made["orbit"]
    assert (orbit["j2"], orbit["ballistic"], orbit["spread"]) == (False, 0.01, 0.2)
    assert np.mean(made["initial"], axis=0) == pytest.approx(np.zeros(6), abs=1e-6)


def test_what_does_not_go_together_is_refused_in_a_sentence(run, handed_over, tmp_path):
    both = ("--initial", "oem", "--goal", "oem")
    (tmp_path / "bad.oem").write_text("CCSDS_OEM_VERS = 2.0\nTIME\n")
    for options, word in (
        (("--initial", "oem"), "--initial or --goal is missing"),
        (("--chief", "chief.csv"), "--initial or --goal is missing"),
        (("--no-j2",), "without --eccentricity"),
        (("--eccentricity", "0.001", "--drag", "0.01"), "--drag is given without --initial; "),
        (("--drag-spread", "0.1"), "--drag-spread is given without --initial; "),
        ((*both, "--altitude", "5e5"), "--altitude is given with inertial states"),
        ((*both, "--eccentricity", "0.1"), "--eccentricity is given with inertial states"),
        ((*both, "--seed", "1"), "--seed is given with inertial states"),
        ((*both, "--n", "5"), "--n is given with inertial states, which have craft and an orbit"),
        ((*both, "--from", "craft=1,size=9"), "--from is given with inertial states"),
        ((*both, "--drag-spread", "0.1"), "--drag-spread is 0.1 without --drag"),
        ((*both, "--epoch", "noon"), "--epoch is 'noon': give date, time and zone"),
        ((*both, "--nodes", "12"), "expected one at 2026-03-01T12:22:00.000000Z"),
        ((*both, "--initial", "none"), "none cannot be read"),
        ((*both, "--goal", "chief.csv"), "goal reaches 6.69"),
        ((*both, "--chief", "bad.oem"), "bad.oem has the line 'TIME'"),
    ):
        done = run("scenario", "new", "new.json", *options)
        assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
        assert word in done.stderr
        assert not (tmp_path / "new.json").exists()
