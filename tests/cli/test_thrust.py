"""Thrusters, limits of craft and impulse bits at the command line: kept, explained or refused."""

import json

import numpy as np
import pandas as pd
import pytest
from judge import judge_plan

from pipeline.orbit.problem import Problem
from pipeline.orbit.thrust import Thrust
from pipeline.scenario import Scenario, draw
from pipeline.scenario.document import read_scenario, write_scenario
from pipeline.scenario.spacecraft import Spacecraft

NEW = ["scenario", "new", "s.json", "--n", 4]
ALL = [*("--thrust", "norm", "--max-acceleration-norm", 0.01, "--min-delta-v", 0.02)]
ALL += ["--no-burn", "300:500", "--no-burn", "0:50", "--delta-v", 3, "--objective", "fair"]


def told(run, *arguments, status=0):
    done = run(*arguments)
    assert done.returncode == status, done.stderr + done.stdout
    return done.stdout if status == 0 else done.stdout + done.stderr


def in_one_line(text):
    return " ".join(text.split())


def test_what_is_given_stands_in_the_file_and_is_planned_shown_and_explained(run, tmp_path):
    told(run, *NEW, *ALL)
    made = read_scenario(tmp_path / "s.json")
    assert made.problem.thrust == Thrust("norm", 0.01, 0.02, ((300, 500), (0, 50)), "fair")
    assert made.craft == (Spacecraft(delta_v=3.0),) * 4
    checked = in_one_line(told(run, "scenario", "check", "s.json"))
    assert "of its max_acceleration_norm; craft" in checked
    said = told(run, "plan", "s.json", "--out", "p.json")
    plan = json.loads((tmp_path / "p.json").read_text())
    report = judge_plan(json.loads((tmp_path / "s.json").read_text()), plan)
    assert report.wrong == ()
    share, burn = (plan["certificate"][name] for name in ("largest_share", "smallest_burn"))
    assert f"{share['share']:.2%}" in said
    assert f"{1e3 * burn['least']:.3g}" in said
    told(run, "show", "p.json", "--out", "p.html")
    page = (tmp_path / "p.html").read_text()
    assert f"{share['share']:.3%}, of craft {share['craft']}" in page
    assert "Fuel, Σ‖u‖₂" in page and "300 to 500 s, 0 to 50 s" in page and "3 m/s in all" in page
    told(run, "convert", "p.json", "--to", "csv")


def test_directions_of_thrusters_are_shown_by_craft(run, tmp_path):
    corners = [(1, 1, 1), (-1, -1, 1), (-1, 1, -1), (1, -1, -1)]
    given = {"thrust": [[one / 3**0.5 for one in corner] for corner in corners]}
    told(run, *NEW)
    scenario = json.loads((tmp_path / "s.json").read_text()) | given
    (tmp_path / "s.json").write_text(json.dumps(scenario))
    said = told(run, "plan", "s.json", "--out", "p.json", "--json")
    (row,) = json.loads(said)
    assert sum(row["craft_delta_v_thrusters"]) == pytest.approx(row["delta_v"], rel=1e-6)
    assert "Δv by" in told(run, "plan", "s.json", "--out", "p.json")
    told(run, "show", "p.json", "--out", "p.html")
    assert "4 directions" in (tmp_path / "p.html").read_text()


def test_inertial_states_take_thrusters_too(run, tmp_path):
    names = "semi_major_axis,eccentricity,inclination_deg,raan_deg,argument_of_perigee_deg"
    for name, latitude in (("a.csv", 10), ("b.csv", 86)):
        rows = (
            f"6878137,0.001,97.4,40,90,{latitude}\n6878137,0.00101,97.402,40,90,{latitude + 0.001}"
        )
        (tmp_path / name).write_text(f"{names},argument_of_latitude_deg\n{rows}")
    states = ("--initial", "a.csv", "--goal", "b.csv", "--epoch", "2026-03-01T12:00:00Z")
    told(run, "scenario", "new", "s.json", *states, "--thrust", "norm", "--delta-v", 2)
    made = read_scenario(tmp_path / "s.json")
    assert made.problem.thrust == Thrust("norm")
    assert made.craft == (Spacecraft(delta_v=2.0),) * 2
    assert made.reference is not None


@pytest.mark.parametrize(
    "options, sentence",
    [
        (["--objective", "fair"], "not every craft has a delta_v"),
        (["--no-burn", "5"], "--no-burn is '5'; expected start:end"),
        (["--no-burn", "9:5"], "no_burn has 9 to 5 s"),
        (["--min-delta-v", "-1"], "min_delta_v"),
        (["--thrust", "directions"], "--thrust"),
    ],
)
def test_what_makes_no_sense_is_refused_in_a_sentence(run, tmp_path, options, sentence):
    assert sentence in in_one_line(told(run, *NEW, *options, status=2))
    assert not (tmp_path / "s.json").exists()


@pytest.mark.parametrize(
    "options, sentence",
    [
        (["--delta-v", 0.3], "craft 0 needs at least 1.187 m/s and has 0.3 m/s, its delta_v"),
        (["--no-burn", "130:1200"], "may burn in 1 of 10 intervals, too few to reach its goal"),
        (["--thrust", "norm", "--max-acceleration-norm", 1e-4], "its max_acceleration_norm"),
        (
            ["--max-acceleration", 1e-3, "--min-delta-v", 0.2],
            "can make no burn of more than 0.12 m/s, less than min_delta_v, 0.2 m/s",
        ),
    ],
)
def test_check_says_what_craft_are_short_of_and_the_expert_proves_it(run, options, sentence):
    told(run, *NEW, *options)
    assert sentence in in_one_line(told(run, "scenario", "check", "s.json", status=1))
    said = told(run, "plan", "s.json", "--out", "p.json", "--json", status=1)
    (row,) = json.loads(said)
    assert row["status"] == "infeasible"


def test_flights_of_such_plans_are_reported_and_replanning_them_is_refused(run, tmp_path):
    told(run, *NEW, "--thrust", "norm")
    (row,) = json.loads(told(run, "plan", "s.json", "--out", "p.json", "--json"))
    done = run("fly", "p.json", "--json")
    assert json.loads(done.stdout)["delta_v"] == pytest.approx(row["delta_v"], rel=1e-9)
    trials = ("fly", "p.json", "--trials", 2, "--jobs", 1)
    done = run(*trials, "--error", "magnitude=0", "--error", "direction=0", "--json")
    assert done.returncode in (0, 1), done.stderr
    (loop,) = json.loads(done.stdout)["loops"]
    assert loop["delta_v_median"] == pytest.approx(row["delta_v"], rel=0.05)
    assert loop["delta_v_median"] < sum(row["craft_delta_v"])
    refused = told(run, *trials, "--replan", "every-node", status=2)
    assert "or has waypoints, which guidance that plans anew does" in in_one_line(refused)


def test_where_nothing_is_burnt_the_impulse_bit_costs_nothing(run, tmp_path):
    """A craft that rests where it is; rounding leaves a plan without the bit some 1e-42 m/s²."""
    rest = np.zeros((1, 6))
    scenario = Scenario(Problem(thrust=Thrust(min_delta_v=0.1)), rest, rest)
    write_scenario(tmp_path / "s.json", scenario)
    assert "100.00%" not in told(run, "plan", "s.json", "--out", "p.json")


def test_a_tradeoff_keeps_windows_and_budgets_at_every_duration(run, tmp_path):
    scenario = draw("rings", 0, 3, 3, Problem(thrust=Thrust("norm", no_burn=((200.0, 400.0),))))
    write_scenario(tmp_path / "s.json", scenario)
    told(run, "tradeoff", "s.json", "--duration", "10..30min", "--steps", 3)
    table = pd.read_csv(tmp_path / "s-tradeoff" / "tradeoff.csv")
    given = json.loads((tmp_path / "s.json").read_text())
    assert (table["status"] == "solved").all()
    for row in table.itertuples():
        plan = json.loads((tmp_path / row.plan).read_text())
        assert judge_plan(given | {"nodes": round(row.duration / 120) + 1}, plan).wrong == ()
