"""prolearn plan: plans that an independent judge agrees with."""

import contextlib
import json
import os
import pty
import re
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from judge import judge_plan

from pipeline.expert import decoupled_optima
from pipeline.orbit.approaches import close_approaches
from pipeline.orbit.corridors import Box, Corridor
from pipeline.orbit.problem import Problem
from pipeline.orbit.separation import node_collisions
from pipeline.orbit.transfer import fly
from pipeline.scenario import draw
from pipeline.scenario.document import write_scenario

CLAIMS = {
    *("fuel", "delta_v", "fuel_lower_bound", "optimality_gap", "node_collisions"),
    *("min_separation", "min_separation_pair", "min_separation_time", "min_separation_bound"),
    *("goal_error", "dynamics_error", "craft_delta_v", "craft_delta_v_2norm"),
}
"""The judge holds a plan to each; it may leave out none."""


def judged(scenario, plan, **options):
    """The judge's report on two files."""
    return judge_plan(json.loads(scenario.read_text()), json.loads(plan.read_text()), **options)


def row_of(name, table):
    """What the table says of a scenario, after its name."""
    (row,) = [line for line in table.splitlines() if line.startswith(f"{name} ")]
    return row.removeprefix(name).strip()


@pytest.mark.parametrize("family", ["rings", "coplanar-split", "rotation"])
def test_the_judge_agrees_with_the_experts_certificate(family, run, tmp_path):
    files = []
    for n in (1, 2, 9):
        files.append(tmp_path / f"{n}.json")
        write_scenario(files[-1], draw(family, 0, n, 0, Problem()))
    done = run("plan", *files, "--planner", "expert", "--out", "plans")
    assert done.returncode == 0, done.stderr
    for file in files:
        plan = tmp_path / "plans" / f"{file.stem}.plan.json"
        report = judged(file, plan)
        assert report.wrong == ()
        said = json.loads(plan.read_text())
        assert said["schema"] == "prolearn.plan/2"
        assert said["status"] == "solved"
        assert said["certificate"].keys() >= CLAIMS
        for name in ("fuel", "delta_v", "fuel_lower_bound"):
            assert said["certificate"][name] == pytest.approx(getattr(report, name), rel=1e-6)


def test_a_thrust_limit_and_another_grid_are_kept(run, tmp_path):
    problem = Problem(time_step=200.0, nodes=9, max_acceleration=2e-3)
    write_scenario(tmp_path / "s.json", draw("rings", 1, 6, 0, problem))
    done = run("plan", "s.json", "--out", "p.json")
    assert done.returncode == 0, done.stderr
    report = judged(tmp_path / "s.json", tmp_path / "p.json")
    assert report.wrong == ()


def test_plans_apart_at_the_nodes_pass_the_papers_criterion(run, tmp_path):
    write_scenario(tmp_path / "s.json", draw("rings", 0, 10, 1, Problem()))
    run("plan", "s.json", "--out", "p.json", "--separation", "nodes")
    report = judged(tmp_path / "s.json", tmp_path / "p.json", at_nodes=True)
    assert report.wrong == ()
    assert report.node_collisions == 0


def test_the_packaged_refiner_plans_several_scenarios_and_says_who_made_each_plan(run, tmp_path):
    files = []
    for k in range(4):
        files.append(tmp_path / f"{k}.json")
        write_scenario(files[-1], draw("dense", 0, 10, k, Problem()))
    done = run("plan", *files, "--planner", "refiner", "--out", "plans")
    assert done.returncode == 0, done.stderr
    for file in files:
        plan = tmp_path / "plans" / f"{file.stem}.plan.json"
        assert judged(file, plan).wrong == ()
        planner = json.loads(plan.read_text())["planner"]
        assert planner in ("refiner", "refiner + one solve", "expert")
        assert re.match(rf"{re.escape(planner)} +0\.", row_of(file.stem, done.stdout))


def test_an_infeasible_scenario_exits_with_1_and_says_why(run, tmp_path):
    write_scenario(tmp_path / "s.json", draw("rings", 0, 2, 0, Problem(max_acceleration=1e-6)))
    done = run("plan", "s.json", "--out", "p.json")
    assert done.returncode == 1
    assert "cannot reach its goal within max_acceleration" in done.stdout
    assert json.loads((tmp_path / "p.json").read_text())["status"] == "infeasible"


def test_a_baseline_plans_by_its_name(run, tmp_path):
    write_scenario(tmp_path / "s.json", draw("rings", 0, 3, 0, Problem()))
    done = run("plan", "s.json", "--out", "p.json", "--planner", "minimum-energy")
    plan = json.loads((tmp_path / "p.json").read_text())
    assert plan["planner"] == "minimum energy"
    gap = plan["certificate"]["optimality_gap"]
    assert gap > 0.01
    assert f" {gap:.2%} " in row_of("s", done.stdout)


def test_a_file_without_a_suffix_is_no_name_of_a_plan(run, tmp_path):
    write_scenario(tmp_path / "s.json", draw("rings", 0, 2, 0, Problem()))
    (tmp_path / "taken").write_text("mine")
    done = run("plan", "s.json", "--out", "taken")
    said = "prolearn: --out is the file taken; expected a folder, or a name with .json.\n"
    assert (done.returncode, done.stderr) == (2, said)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (("--planner", "decoupled-optimum", "--effort", "best"), "effort is best"),
        (("--planner", "lstm1", "--raw", "--effort", "first"), "effort is first"),
        (("--planner", "expert", "--raw"), "raw is given"),
        (("--planner", "straight-line", "--raw"), "raw is given"),
    ],
    ids=" ".join,
)
def test_an_option_that_a_planner_has_no_use_for_is_refused(run, tmp_path, options, word):
    write_scenario(tmp_path / "s.json", draw("rings", 0, 3, 0, Problem()))
    done = run("plan", "s.json", "--out", "p.json", *options)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert word in done.stderr
    assert not (tmp_path / "p.json").exists()


def test_a_baseline_is_judged_by_the_separation_that_was_asked_for(run, tmp_path):
    """Own optima that pass too close between the nodes, and nowhere at one."""
    scenario = next(
        s for s in (draw("rings", 0, 10, k, Problem()) for k in range(100)) if passes_between(s)
    )
    write_scenario(tmp_path / "s.json", scenario)
    asked = ("plan", "s.json", "--out", "p.json", "--planner", "decoupled-optimum")
    strict, lax = run(*asked), run(*asked, "--separation", "nodes")
    assert (strict.returncode, lax.returncode) == (1, 0)
    assert "unsafe by decoupled optimum" in strict.stdout
    assert row_of("s", strict.stdout).startswith("decoupled optimum (unsafe) 0.")
    assert re.match(r"decoupled optimum +0\.", row_of("s", lax.stdout))
    assert "unsafe" not in lax.stdout
    report = judged(tmp_path / "s.json", tmp_path / "p.json")
    assert [fault.endswith("between nodes") for fault in report.faults] == [True]
    assert "apart at the nodes only" in run("convert", "p.json", "--to", "csv").stderr
    assert run("show", "p.json").stdout == "p.html: 10 craft by decoupled optimum.\n"
    assert "<strong>Safe at the nodes</strong>" in (tmp_path / "p.html").read_text()
    exact = ("fly", "p.json", "--eccentricity", "0", "--no-j2")
    assert (done := run(*exact)).returncode == 0
    assert "at a node, and no more was asked: craft" in done.stdout.replace("\n", " ")
    document = json.loads((tmp_path / "p.json").read_text())
    (tmp_path / "p.json").write_text(json.dumps(document | {"separation": "continuous"}))
    assert "come within" in run("show", "p.json").stdout
    assert run(*exact).returncode == 1


def passes_between(scenario):
    problem = scenario.problem
    controls = decoupled_optima(scenario.initial, scenario.goal, problem).controls
    close = close_approaches(fly(scenario.initial, controls, problem), controls, problem, 14.0)
    states = fly(scenario.initial, controls, problem)
    return len(close.first) > 0 and not node_collisions(states, problem.collision_radius)


def test_no_line_shows_a_gap_where_there_is_none(run, tmp_path):
    """No craft can make its transfer, so nothing is known of the least fuel."""
    write_scenario(tmp_path / "s.json", draw("rings", 0, 2, 0, Problem(max_acceleration=1e-6)))
    done = run("plan", "s.json", "--out", "p.json")
    assert "infeasible by expert" in done.stdout
    assert "%" not in done.stdout and " – " in row_of("s", done.stdout)
    told = json.loads(run("plan", "s.json", "--out", "p.json", "--json").stdout)
    assert told[0]["optimality_gap"] is None


def test_the_table_and_its_json_say_what_the_judge_finds(run, tmp_path):
    files = []
    for k in range(3):
        files.append(tmp_path / f"{k}.json")
        write_scenario(files[-1], draw("rings", 5, 10, k, Problem(), "valid"))
    asked = ("plan", *files, "--planner", "decoupled-optimum", "--out", "plans")
    table, told = run(*asked), run(*asked, "--json")
    assert (table.returncode, told.returncode) == (1, 1)
    rows = json.loads(told.stdout)
    assert [row["scenario"] for row in rows] == [str(file) for file in files]
    for file, row in zip(files, rows, strict=True):
        report = judged(file, tmp_path / row["plan"])
        assert row["fuel"] == pytest.approx(report.fuel, rel=1e-9)
        assert row["delta_v"] == pytest.approx(120 * report.fuel, rel=1e-9)
        assert row["optimality_gap"] == pytest.approx(0, abs=1e-6), "the own optima are the bound"
        assert row["min_separation"] == pytest.approx(report.min_separation, abs=1e-4)
        cells = row_of(file.stem, table.stdout).split()
        (i, j), at = row["min_separation_pair"], row["min_separation_time"]
        assert cells[-4:-1] == [f"{i},{j}", f"{at:.0f}", f"{report.min_separation:.2f}"]
        unsafe = report.pair_conflicts > 0
        assert row["status"] == ("unsafe" if unsafe else "solved")
        sentence = f"{file}: unsafe by decoupled optimum: craft {i} and {j} come within "
        assert (sentence in table.stdout) == unsafe
        assert (f" at {at:.6g} s;" in table.stdout) == unsafe
    assert {row["status"] for row in rows} == {"unsafe", "solved"}


def test_interchangeable_craft_take_the_goals_of_each_other(run, tmp_path):
    files = []
    for k, limit in enumerate((None, None, 5e-4)):
        files.append(tmp_path / f"{k}.json")
        problem = Problem(max_acceleration=limit)
        write_scenario(files[-1], draw("rings", 5, 10, 2 * k, problem, "valid"))
    asked = ("plan", *files, "--assignment", "optimal", "--out", "plans")
    done, told = run(*asked), run(*asked, "--json")
    assert done.returncode == 0, done.stderr
    for file, row in zip(files, json.loads(told.stdout), strict=True):
        given = json.loads(file.read_text())
        plan = json.loads((tmp_path / row["plan"]).read_text())
        slots = plan["assignment"]["slots"]
        assert slots != list(range(10))
        assert plan["scenario"]["goal"] == [given["goal"][slot] for slot in slots]
        assert plan["scenario"]["initial"] == given["initial"]
        assert judge_plan(plan["scenario"], plan).wrong == ()
        assert row["assignment"] == plan["assignment"]
        saving = row["assignment"]["saving"]
        shown = row_of(file.stem, done.stdout).split()[-1]
        assert shown == (f"{saving:.1%}" if saving is not None else "–")
    assert "2.json: in the given order some craft cannot reach its goal" in done.stdout


def test_where_a_corridor_forbids_the_given_order_that_is_said(run, tmp_path):
    drawn = draw("rings", 5, 2, 0, Problem(), "valid")
    low, high = (tuple((drawn.goal[1, :3] + side).tolist()) for side in (-20.0, 20.0))
    at_the_end = Corridor(Box(low, high), 1100.0, 1200.0, (0,))
    write_scenario(tmp_path / "s.json", replace(drawn, corridors=(at_the_end,)))
    done = run("plan", "s.json", "--assignment", "optimal", "--out", "p.json")
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "p.json").read_text())["assignment"]["slots"] == [1, 0]
    assert "some craft cannot reach its goal inside its corridors within its limits" in done.stdout


@pytest.mark.parametrize("planner", ["expert", "refiner"])
def test_a_risk_that_was_asked_for_is_in_file_table_and_json(planner, run, tmp_path):
    """The second scenario's goals are so close that no other plan than the first is sought."""
    for k, index in enumerate((4, 90)):
        write_scenario(tmp_path / f"{k}.json", draw("rings", 0, 10, index, Problem(), "valid"))
    sigmas = ("--navigation-sigma", "0.2", "--thrust-sigma", "0.01")
    asked = ("plan", "0.json", "1.json", "--planner", planner, "--risk", "1e-3", *sigmas)
    done, told = run(*asked, "--out", "plans"), run(*asked, "--json", "--out", "plans")
    assert (done.returncode, told.returncode) == (1, 1)
    rows = json.loads(told.stdout)
    assert [row["status"] for row in rows] == ["solved", "unsolved"]
    for k, row in enumerate(rows):
        plan = json.loads((tmp_path / row["plan"]).read_text())
        assert judged(tmp_path / f"{k}.json", tmp_path / row["plan"]).wrong == ()
        risk = plan["certificate"]["risk"]
        assert risk == row["risk"]
        assert (risk["asked"], risk["bound"] <= 1e-3) == (1e-3, k == 0)
        errors = risk["uncertainty"]
        assert errors["position"] == 0.2
        assert errors["velocity"] == pytest.approx(0.2 * plan["scenario"]["mean_motion"])
        assert errors["magnitude"] == errors["direction"] == 0.01
        cost = plan["certificate"]["fuel"] / risk["fuel_without"] - 1
        assert row_of(str(k), done.stdout).endswith(f" {cost:.2%}")
        assert plan["planner"] == planner + " + expert" * (planner == "refiner" and k == 0)
    assert "1.json: unsolved by " in done.stdout
    assert "m apart at the goal" in done.stdout


def test_a_plan_without_a_risk_says_nothing_of_one(run, tmp_path):
    write_scenario(tmp_path / "s.json", draw("rings", 0, 3, 0, Problem()))
    done = run("plan", "s.json", "--out", "p.json")
    assert "risk" not in done.stdout
    assert "risk" not in json.loads((tmp_path / "p.json").read_text())["certificate"]


def test_a_plan_with_passive_safety_says_so_and_the_judge_agrees(run, tmp_path):
    files = []
    for k in range(3):  # plans of which one has it unasked; the ends of another forbid it
        files.append(tmp_path / f"{k}.json")
        write_scenario(files[-1], draw("rings", 0, 10, k, Problem(), "valid"))
    asked = ("plan", *files, "--passive-safety", "0.5", "--out", "plans")
    done, told = run(*asked), run(*asked, "--json")
    assert (done.returncode, told.returncode) == (1, 1)
    statuses = []
    for file, row in zip(files, json.loads(told.stdout), strict=True):
        plan = json.loads((tmp_path / row["plan"]).read_text())
        statuses.append(row["status"])
        claim = plan["certificate"]["passive_safety"]
        assert row["passive_safety"] == claim
        assert claim["orbits"] == 0.5
        report = judged(file, tmp_path / row["plan"])
        assert report.false_claims == ()
        cells = row_of(file.stem, done.stdout).split()
        pair, apart = claim["pair"], claim["min_separation"]
        assert cells[-2:] == [f"{pair[0]}@{claim['node']}", f"{apart:.2f}"]
        if row["status"] == "solved":
            assert report.faults == ()
            assert claim["min_separation_bound"] > 15
        else:
            assert any("adrift from node" in fault for fault in report.faults)
            assert "whatever is planned" in row["message"]
    assert sorted(statuses) == ["infeasible", "solved", "solved"]


def test_a_plan_without_passive_safety_says_nothing_of_it(run, tmp_path):
    write_scenario(tmp_path / "s.json", draw("rings", 0, 3, 0, Problem()))
    done = run("plan", "s.json", "--out", "p.json", "--json")
    assert json.loads(done.stdout)[0]["passive_safety"] is None
    assert "passive_safety" not in (tmp_path / "p.json").read_text()


@pytest.mark.parametrize("planner", ["refiner", "decoupled-optimum"])
def test_other_planners_are_held_to_passive_safety(planner, run, tmp_path):
    """The refiner's own plan is taken only where it has it; a baseline's is unsafe without."""
    write_scenario(tmp_path / "s.json", draw("coplanar-split", 0, 6, 1, Problem(), "valid"))
    asked = ("plan", "s.json", "--out", "p.json", "--planner", planner)
    done = run(*asked, "--passive-safety", "1")
    report = judged(tmp_path / "s.json", tmp_path / "p.json")
    assert report.false_claims == ()
    adrift = [fault for fault in report.faults if "adrift" in fault]
    assert (done.returncode, len(adrift)) == ((0, 0) if planner == "refiner" else (1, 1))


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (("--passive-safety", "0"), "0 orbits; expected a number above 0"),
        (("--passive-safety=-1",), "-1 orbits; expected a number above 0"),
        (("--passive-safety", "nan"), "nan orbits; expected a number above 0"),
        (("--passive-safety", "1e9"), "at most 100"),
        (("--passive-safety", "1", "--separation", "nodes"), "leave one of the two out"),
        (
            ("--passive-safety", "1", "--planner", "decoupled-optimum", "--separation", "nodes"),
            "leave one",
        ),
    ],
    ids=" ".join,
)
def test_passive_safety_that_cannot_be_is_refused(run, tmp_path, options, word):
    write_scenario(tmp_path / "s.json", draw("rings", 0, 3, 0, Problem()))
    done = run("plan", "s.json", "--out", "p.json", *options)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert word in done.stderr
    assert not (tmp_path / "p.json").exists()


def test_on_a_terminal_of_80_columns_thirty_rows_keep_every_number(forked, tmp_path):
    names = [f"a-scenario-of-a-long-name-{k:06d}" for k in range(30)]
    for k, name in enumerate(names):
        write_scenario(tmp_path / f"{name}.json", draw("rings", 0, 3, k, Problem()))
    files = [f"{name}.json" for name in names]
    asked = ("plan", *files, "--planner", "minimum-energy", "--out", "plans")
    screen = on_a_terminal(forked, asked, tmp_path)
    lines = [line.rstrip() for line in screen.splitlines() if "minimum energy" in line]
    rows = [line for line in lines if not line.startswith("a-scenario")]
    assert len(rows) == 30
    for name, row in zip(names, rows, strict=True):
        first, shown = row.split(maxsplit=1)
        assert first[0] == "…" and name.endswith(first[1:]) and len(first) >= 8
        plan = json.loads((tmp_path / "plans" / f"{name}.plan.json").read_text())["certificate"]
        shown = shown.removeprefix("minimum energy").replace("(unsafe)", "").split()
        assert len(row) <= 80
        assert float(shown[0]) == pytest.approx(plan["fuel"], rel=5e-3)
        assert float(shown[1]) == pytest.approx(plan["delta_v"], rel=5e-3)
        assert float(shown[2].rstrip("%")) == pytest.approx(100 * plan["optimality_gap"], abs=6e-3)
        assert shown[3] == ",".join(map(str, plan["min_separation_pair"]))
        assert float(shown[4]) == pytest.approx(plan["min_separation_time"], abs=0.51)
        assert float(shown[5]) == pytest.approx(plan["min_separation"], abs=6e-3)


def on_a_terminal(forked, arguments, folder):
    """What a terminal of 80 columns shows on standard output, without colours."""
    screen, theirs = pty.openpty()
    done = subprocess.Popen(
        [*forked.command, *arguments],
        cwd=folder,
        stdout=theirs,
        stderr=subprocess.DEVNULL,
        env=os.environ | {"COLUMNS": "80", "TERM": "xterm"},
    )
    os.close(theirs)
    shown = b""
    with contextlib.suppress(OSError):  # the other side has gone
        while part := os.read(screen, 4096):
            shown += part
    os.close(screen)
    done.wait(timeout=60)
    return re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", shown.decode())


def test_on_a_terminal_of_80_columns_those_without_room_follow_in_a_table_below(
    forked, run, tmp_path
):
    write_scenario(tmp_path / "s.json", draw("rings", 0, 3, 0, Problem()))
    risk = ("--risk", "0.01", "--errors", "cold-gas", "--closed-loop", "--passive-safety", "0.5")
    asked = ("plan", "s.json", "--out", "p.json", *risk, "--assignment", "optimal")
    elsewhere = run(*asked).stdout.splitlines()
    (whole,) = [line.split() for line in elsewhere if line[:2] == "s "]
    lines = [line.rstrip() for line in on_a_terminal(forked, asked, tmp_path).splitlines()]
    assert max(map(len, lines)) <= 80
    notes = [line for line in elsewhere if line.startswith(("saved: ", "adrift from: ", "safety"))]
    assert len(notes) == 3 and max(map(len, notes)) > 80
    assert all(note in " ".join(lines) for note in notes)
    first, second = [line for line in lines if line[:2] == "s "]
    shown = [*first.split(), *second.split()[1:]]
    time = 8  # that it took, which differs
    assert [*shown[:time], *shown[time + 1 :]] == [*whole[:time], *whole[time + 1 :]]


def test_a_plan_for_which_the_linear_model_is_far_off_says_by_how_much(run, tmp_path):
    ring = "craft=2,size={}"
    for name, size in (("near", 200), ("far", 30_000)):
        rings = ("--from", ring.format(size), "--to", ring.format(size / 2))
        run("scenario", "new", f"{name}.json", *rings)
    done = run("plan", "near.json", "far.json", "--out", "plans")
    (said,) = [line for line in done.stdout.splitlines() if "off their goals" in line]
    assert said.startswith("far.json: outside the linear model craft end some ")
    missed = float(re.search(r"some (\S+) m off", said)[1])
    flown = run("fly", "plans/far.plan.json", "--eccentricity", "0", "--json")
    assert missed / 4 < json.loads(flown.stdout)["goal_error"] < 4 * missed


@pytest.mark.parametrize("limit", [None, 1.2e-3])
def test_coasts_are_zeros_and_table_file_and_page_have_the_delta_v_of_each_craft(
    limit, run, tmp_path
):
    write_scenario(tmp_path / "s.json", draw("rings", 0, 10, 0, Problem(max_acceleration=limit)))
    done = run("plan", "s.json", "--out", "p.json")
    assert judged(tmp_path / "s.json", tmp_path / "p.json").wrong == ()
    controls = np.array(json.loads((tmp_path / "p.json").read_text())["controls"])
    size = np.abs(controls)
    assert (controls == 0).sum() > 200  # of 300: a basic solution has six burns a craft
    assert size[size > 0].min() > 1e-6 * size.max()
    assert run("show", "p.json").returncode == 0
    page = (tmp_path / "p.html").read_text()
    for k, u in enumerate(controls):
        one, two = 120 * np.abs(u).sum(), 120 * np.linalg.norm(u, axis=1).sum()
        assert re.search(rf"^{k} +{one:.3g}0* +{two:.3g}0*$", done.stdout, re.MULTILINE)
        row = rf'<th scope="row">{k}</th><td>{one:#.4g} m/s</td><td>{two:#.4g} m/s</td>'
        assert row in page
