"""prolearn tradeoff: a curve with certified plans behind it."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from judge import Case, judge_plan, least_fuel

from pipeline.orbit.corridors import Box, Corridor
from pipeline.orbit.participants import Obstacle
from pipeline.orbit.problem import Problem
from pipeline.scenario import draw
from pipeline.scenario.document import write_scenario


@pytest.fixture
def scenario(tmp_path):
    """A file of ten craft with a thrust limit that fast transfers break."""
    problem = Problem(max_acceleration=1.2e-3)
    write_scenario(tmp_path / "s.json", draw("rings", 5, 10, 0, problem, "valid"))
    return tmp_path / "s.json"


def test_every_point_has_a_plan_that_the_judge_finds_sound_or_cannot_be_flown(
    run, scenario, tmp_path
):
    done = run("tradeoff", scenario, "--duration", "10..60min", "--steps", 6)
    assert done.returncode == 0, done.stderr
    folder = tmp_path / "s-tradeoff"
    table = pd.read_csv(folder / "tradeoff.csv")
    assert table["duration"].tolist() == [600, 1200, 1800, 2400, 3000, 3600]
    given = json.loads(scenario.read_text())
    for row in table.itertuples():
        asked = given | {"nodes": round(row.duration / 120) + 1}
        if row.status == "solved":
            plan = json.loads((tmp_path / row.plan).read_text())
            report = judge_plan(asked, plan)
            assert report.wrong == ()
            assert plan["scenario"]["goal"] == given["goal"]
            assert row.delta_v == pytest.approx(report.delta_v, rel=1e-6)
            assert row.delta_v_lower_bound == pytest.approx(120 * report.fuel_lower_bound, rel=1e-6)
        else:
            assert row.status == "infeasible"
            assert pd.isna(row.plan) and pd.isna(row.delta_v_lower_bound)
            assert out_of_reach(asked)
    assert {"solved", "infeasible"} == set(table["status"])
    assert table["knee"].sum() == 1
    assert f"knee is at {table.loc[table['knee'], 'duration'].item() / 60:.4g} min" in done.stdout
    assert "10 min: infeasible: craft" in done.stdout
    assert (folder / "tradeoff.svg").stat().st_size > 5000
    assert (folder / "tradeoff.png").read_bytes().startswith(b"\x89PNG")


def out_of_reach(asked):
    """Whether some craft has no transfer within the limit, by HiGHS."""
    ends = (np.array(asked[end]) for end in ("initial", "goal"))
    return np.isinf(least_fuel(Case.of(asked), *ends).attained).any()


def test_json_is_all_there_is_on_standard_output(prolearn, scenario):
    asked = ("tradeoff", scenario, "--duration", "1200..3600s", "--steps", 4, "--goal", "moving")
    done = prolearn(*asked, "--json", "--assignment", "optimal", "--out", "here")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert (told["scenario"], told["goal"]) == (str(scenario), "moving")
    assert [point["duration"] for point in told["points"]] == [1200, 2040, 2760, 3600]
    for point in told["points"]:
        assert sorted(point["assignment"]["slots"]) == list(range(10))
        assert 0 <= point["optimality_gap"] < 0.05


def test_points_have_what_the_page_says_and_plan_has(run, tmp_path):
    write_scenario(tmp_path / "s.json", draw("rings", 0, 2, 0, Problem()))
    (planned,) = json.loads(run("plan", "s.json", "--out", "p.json", "--json").stdout)
    traded = json.loads(run("tradeoff", "s.json", "--duration", "20..22min", "--json").stdout)
    page = (Path(__file__).parents[2] / "docs/cli.md").read_text(encoding="utf-8")
    row = page.split("| `prolearn tradeoff` | ")[1].split(" |\n")[0].split("of each ")[1]
    own, besides = (re.findall(r"`(\w+)`", part) for part in row.split("what else `plan` has but"))
    assert set(traded["points"][0]) == {*own, *planned} - {*besides}


def test_only_safe_plans_are_files_and_those_of_an_earlier_range_go(run, tmp_path):
    write_scenario(tmp_path / "s.json", draw("rings", 5, 10, 0, Problem(), "valid"))
    asked = ("tradeoff", "s.json", "--planner", "decoupled-optimum", "--out", "trade")
    plans = tmp_path / "trade" / "plans"
    for durations in ("42..46min", "44..60min"):
        done = run(*asked, "--duration", durations)
        assert done.returncode == 0
        table = pd.read_csv(tmp_path / "trade" / "tradeoff.csv")
        assert {"solved", "unsafe"} == set(table["status"])
        assert {f"trade/plans/{file.name}" for file in plans.iterdir()} == set(
            table["plan"].dropna()
        )
        for row in table[table["status"] == "unsafe"].itertuples():
            pair = f"craft {row.first_craft} and {row.second_craft} come within"
            assert f"{row.duration / 60:.4g} min: unsafe: {pair}" in done.stdout


def test_the_tables_columns_are_numbers_and_words_and_those_of_the_page(run, tmp_path):
    """Also of a scenario whose plans have margins of obstacles and corridors."""
    scenario = draw("rings", 0, 2, 0, Problem())
    debris = Obstacle("debris", (0.0, 2000.0, 0.0, 0.0, 0.0, 0.0), radius=5.0)
    inside = Corridor(Box((-900.0,) * 3, (900.0,) * 3), 0.0, 1200.0)
    more = replace(scenario, obstacles=(debris,), corridors=(inside,))
    write_scenario(tmp_path / "s.json", more)
    done = run("tradeoff", "s.json", "--duration", "20..22min", "--steps", 2)
    assert done.returncode == 0, done.stderr
    text = (tmp_path / "s-tradeoff" / "tradeoff.csv").read_text()
    assert "{" not in text
    page = (Path(__file__).parents[2] / "docs/files.md").read_text(encoding="utf-8")
    section = page.split("## Trade-offs: tradeoff.csv")[1].split("\n## ")[0]
    first = "".join(re.findall(r"^\| (`.*?) \|", section, re.MULTILINE))
    assert set(re.findall(r"`(\w+)`", first)) == set(text.splitlines()[0].split(","))


def test_where_no_duration_has_a_safe_plan_the_status_is_1(run, tmp_path):
    problem = Problem(max_acceleration=1e-6)
    write_scenario(tmp_path / "s.json", draw("rings", 5, 3, 0, problem, "valid"))
    done = run("tradeoff", "s.json", "--duration", "10..20min", "--steps", 2)
    assert done.returncode == 1, done.stderr
    assert "There is no knee" in done.stdout
    assert (tmp_path / "s-tradeoff" / "tradeoff.svg").exists()


def test_a_curve_that_is_straight_but_for_its_first_step_has_no_knee(run):
    rings = ("--from", "craft=6,size=200", "--to", "craft=6,size=90,tilt_deg=30")  # README's
    assert run("scenario", "new", "s.json", *rings).returncode == 0
    done = run("tradeoff", "s.json", "--duration", "15..40min")
    assert done.returncode == 0, done.stderr
    assert "There is no knee" in done.stdout
