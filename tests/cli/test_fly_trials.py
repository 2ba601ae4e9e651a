"""prolearn fly --trials: a plan flown many times with errors, as a person meets it."""

import json
import re
import signal
import time
from dataclasses import MISSING, fields, replace

import numpy as np
import pandas as pd
import pyarrow.dataset
import pytest
import torch
from forked import LEAD
from scipy.stats import binom

from cli.fly import QUANTITIES, print_trials
from pipeline.expert import solve, within_risk
from pipeline.flight.summary import Summary
from pipeline.orbit.corridors import Box, Corridor
from pipeline.orbit.participants import Obstacle
from pipeline.orbit.problem import Problem
from pipeline.plan.document import write_plan
from pipeline.plan.requirements import Requirements, RiskLimit
from pipeline.scenario import draw
from pipeline.scenario.document import write_scenario

TRIALS = ("--trials", "60", "--jobs", "1")
LOOPS = ["open loop", "replanned", "with margin"]


@pytest.fixture(scope="module")
def made():
    """A plan with a pair at the collision radius."""
    return solve(draw("rings", 0, 6, 5, Problem(nodes=7, collision_radius=25.0), "test"))


@pytest.fixture
def plan(made, tmp_path):
    """That, in a file."""
    write_plan(tmp_path / "plan.json", made)
    return made


@pytest.fixture(scope="module")
def flown(forked, made, tmp_path_factory):
    """Folder with Monte Carlo trials of a plan, flown in three ways, and the command's JSON."""
    folder = tmp_path_factory.mktemp("flown")
    write_plan(folder / "plan.json", made)
    done = forked.run(["fly", "plan.json", *TRIALS, "--replan", "every-node", "--json"], folder)
    assert done.returncode == 0, done.stderr
    return folder, json.loads(done.stdout)


def rows(folder, loop):
    found = pyarrow.dataset.dataset(folder / f"loop={loop.replace(' ', '-')}")
    return found.to_table().to_pandas()


def test_three_ways_to_fly_are_in_one_table_that_the_trials_bear_out(flown):
    folder, told = flown
    assert (told["plan"], told["folder"]) == ("plan.json", "plan-flown")
    folder /= "plan-flown"
    assert [one["loop"] for one in told["loops"]] == LOOPS
    table = pd.read_csv(folder / "trials.csv")
    for k, one in enumerate(told["loops"]):
        trials = rows(folder, one["loop"])
        assert len(trials) == one["trials"] == 60
        count = (trials["min_separation"] <= 25.0).sum()
        assert one["within_radius"] == pytest.approx(count / 60)
        low, high = one["within_radius_interval"]
        assert low <= one["within_radius"] <= high
        if 0 < count < 60:  # no share outside the interval makes so many likely
            assert binom.sf(count - 1, 60, low - 0.03) < 0.025
            assert binom.cdf(count, 60, high + 0.03) < 0.025
        assert one["goal_error_median"] == pytest.approx(np.median(trials["goal_error"]))
        assert one["delta_v_high"] == pytest.approx(np.quantile(trials["delta_v"], 0.95))
        assert table.loc[k, "within_radius_low"] == pytest.approx(low)
    open_loop, replanned, margin = told["loops"]
    assert open_loop["sigmas"] is open_loop["unsafe_replans"] is None
    assert replanned["goal_error_median"] < open_loop["goal_error_median"] / 3
    assert replanned["replan_seconds"] > 0
    assert margin["sigmas"] == 3
    assert margin["within_radius"] <= replanned["within_radius"]
    assert (folder / "trials.png").read_bytes().startswith(b"\x89PNG")
    assert (folder / "trials.svg").stat().st_size > 5000


def test_without_errors_in_the_linear_world_the_table_has_the_plans_own_numbers(
    run, plan, tmp_path
):
    exact = ("--errors", "none", "--world", "linear", "--out", "here", "--jobs", "1")
    done = run("fly", "plan.json", "--trials", "3", *exact)
    assert done.returncode == 0, done.stderr
    trials = rows(tmp_path / "here", "open loop")
    assert trials["min_separation"].to_numpy() == pytest.approx(
        plan.certificate.min_separation, abs=2e-4
    )
    assert trials["delta_v"].to_numpy() == pytest.approx(plan.certificate.delta_v, rel=1e-12)
    assert trials["goal_error"].max() < 1e-6
    assert max(map(len, done.stdout.splitlines())) <= 80
    assert "within r_col, 25 m" in done.stdout
    assert "here/" in done.stdout


def test_on_a_terminal_of_80_columns_labels_are_whole(monkeypatch, capsys):
    interval = dict.fromkeys(("within_radius_interval", "within_size_interval"), (0.996, 1.0))
    numbers = {one.name: 1.0 for one in fields(Summary) if one.default is MISSING}
    flown = [Summary(**numbers | interval | {"loop": name, "trials": 900}) for name in LOOPS]
    monkeypatch.setenv("FORCE_COLOR", "1")  # as on a terminal
    monkeypatch.setenv("COLUMNS", "80")
    print_trials(flown, 15.0, 5.0)
    lines = re.sub(r"\x1b\[[0-9;]*m", "", capsys.readouterr().out).splitlines()
    assert max(map(len, lines)) <= 80
    labels = " ".join(" ".join(line[:19] for line in lines).split())
    for label, name, _ in QUANTITIES:
        assert name not in numbers or label.strip() in labels


def test_of_one_trial_the_table_says_so(run, plan):
    done = run("fly", "plan.json", "--trials", "1", "--jobs", "1", "--world", "linear")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("1 trial ")


def test_the_nonlinear_world_leads_elsewhere_and_one_error_can_be_changed(run, plan, tmp_path):
    few = ("fly", "plan.json", "--trials", "3", "--jobs", "1", "--errors", "none")
    assert run(*few, "--out", "a").returncode == 0
    assert run(*few, "--error", "missed=1", "--out", "b").returncode == 0
    miss = rows(tmp_path / "a", "open loop")["goal_error"]
    assert miss.between(1e-3, 10).all()
    assert (rows(tmp_path / "b", "open loop")["delta_v"] < 1e-12).all()


def test_a_craft_is_lost_in_every_trial_where_that_is_asked_for(run, plan, tmp_path):
    lost = ("--replan", "every-node", "--error", "lost=1", "--jobs", "1", "--out", "here")
    done = run("fly", "plan.json", "--trials", "8", *lost)
    assert done.returncode == 0, done.stderr
    assert "A craft is lost with probability 1; errors at goals are of others." in done.stdout
    trials = [rows(tmp_path / "here", loop) for loop in LOOPS]
    assert trials[0]["lost_craft"].between(0, 5).all()
    assert trials[0]["lost_time"].between(0, 6 * 120).all()
    assert (trials[1]["goal_error"] < 10).all()  # that of a craft adrift is a hundred
    for column in ("lost_craft", "lost_time"):
        assert trials[0][column].equals(trials[2][column])
    write_plan(tmp_path / "one.json", solve(draw("rings", 0, 1, 0, Problem(), "test")))
    done = run("fly", "one.json", "--trials", "8", *lost)
    assert done.returncode == 2
    assert "lost is 1 and there is one craft; expected 0" in " ".join(done.stderr.split())


@pytest.mark.system
def test_a_killed_command_goes_on_to_the_same_bytes(run, plan, flown, forked, tmp_path):
    asked = ["fly", "plan.json", *TRIALS, "--replan", "every-node", "--out", "killed"]
    with (tmp_path / "said").open("w") as said:
        process = forked.start(LEAD, tmp_path, said, asked)
    killed = tmp_path / "killed"
    end = time.monotonic() + 60
    while not list(killed.glob("loop=*/part-*.parquet")) and time.monotonic() < end:
        time.sleep(0.005)
    process.kill()
    assert process.wait() == -signal.SIGKILL
    done = run(*asked)
    assert done.returncode == 0, done.stderr
    files = sorted(path.relative_to(killed) for path in killed.glob("loop=*/*"))
    assert len(files) == 3 * 2
    for name in [*files, "trials.svg", "trials.png"]:
        assert (killed / name).read_bytes() == (flown[0] / "plan-flown" / name).read_bytes()


REPLANNED = ("--trials", "1", "--jobs", "1", "--replan", "every-node", "--json")


def test_a_plan_is_planned_anew_for_what_it_was_asked_for(run, tmp_path):
    """The plan for r_col alone is the cheaper one, and found on the way where no more is asked."""
    scenario = draw("coplanar-split", 0, 5, 3, Problem(), "valid")
    exact, used = (*REPLANNED, "--errors", "none", "--world", "linear", "--sigmas", "0"), []
    for orbits in (0.5, None):
        safe = solve(scenario, requirements=Requirements(passive_safety=0.5))
        if orbits is None:  # the same controls, of which nothing is said
            safe = replace(safe, certificate=replace(safe.certificate, passive_safety=None))
        write_plan(tmp_path / "plan.json", safe)
        done = run("fly", "plan.json", *exact, "--out", f"{orbits}")
        assert done.returncode == 0, done.stderr
        told = json.loads(done.stdout)
        assert told["requirements"]["passive_safety"] == orbits
        used.append(told["loops"][1]["delta_v_median"])
    assert used[0] > used[1] + 1e-3


def test_a_plan_for_a_risk_is_not_planned_anew(run, tmp_path):
    scenario = draw("rings", 0, 3, 0, Problem(), "valid")
    made = within_risk(solve(scenario), Requirements(risk=RiskLimit(0.1, 0.1)))
    write_plan(tmp_path / "plan.json", made)
    done = run("fly", "plan.json", *REPLANNED)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "risk of at most 0.1 in open loop, which planning anew does not keep" in done.stderr


def test_a_plan_made_for_feedback_is_flown_with_it_and_not_planned_anew(run, tmp_path):
    """Asked for on the command line: the table says what corrections add."""
    scenario = draw("rings", 0, 10, 8, Problem(), "test")
    write_scenario(tmp_path / "s.json", scenario)
    for wrong, words in (
        (("--closed-loop",), "--closed-loop is given without --risk"),
        (("--risk", "0.01", "--closed-loop"), "no error is given"),
        (
            ("--risk", "0.01", "--errors", "electric", "--thrust-sigma", "1"),
            "a sigma is given besi",
        ),
    ):
        done = run("plan", "s.json", "--out", "plan.json", *wrong)
        assert (done.returncode, done.stderr.count("\n")) == (2, 1)
        assert words in done.stderr
    asked = "--risk", "0.01", "--errors", "cold-gas", "--closed-loop", "--json"
    (told,) = json.loads(run("plan", "s.json", "--out", "plan.json", *asked).stdout)
    assert told["risk"]["bound"] <= 0.01
    assert told["risk"]["feedback"]["delta_v"] > 0
    refused = run("fly", "plan.json", *REPLANNED)
    assert refused.returncode == 2
    assert "expected feedback as replan" in refused.stderr
    flown = run("fly", "plan.json", "--trials", "100", "--replan", "feedback", "--json")
    open_loop, feedback = json.loads(flown.stdout)["loops"]
    assert (open_loop["loop"], feedback["loop"]) == ("open loop", "feedback")
    assert open_loop["within_radius"] > 0.15
    assert feedback["within_radius"] < 0.1
    assert feedback["goal_error_median"] < open_loop["goal_error_median"] / 5


def test_on_a_device_the_table_is_the_same_and_a_folder_is_of_one_device(run, plan, tmp_path):
    linear = "fly", "plan.json", *TRIALS, "--world", "linear", "--replan", "feedback", "--json"
    told = run(*linear), run(*linear, "--device", "cpu", "--out", "there")
    one, other = (json.loads(done.stdout)["loops"] for done in told)
    for here, there in zip(one, other, strict=True):
        assert here.keys() == there.keys()
        for name, value in here.items():
            number = value is not None and not isinstance(value, str)
            expected = pytest.approx(value, rel=1e-9, abs=1e-12) if number else value
            assert there[name] == expected, name
    refused = run(*linear, "--out", "there")
    assert refused.returncode == 2
    assert "was begun with world.device = cpu, now it is None" in refused.stderr


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--seed", "3"], "--seed is given without --trials"),
        (["--trials", "9", "--sigmas", "1"], "--sigmas is given and nobody plans anew"),
        (["--trials", "9", "--error", "speed=1"], "--error is 'speed=1'; expected NAME=VALUE"),
        (["--trials", "9", "--world", "linear", "--no-j2"], "--no-j2 is given and the linear"),
        (["--device", "cpu"], "--device is given without --trials"),
        (["--trials", "9", "--device", "cpu"], "--device is given and the nonlinear world has"),
        (["--trials", "9", "--world", "linear", "--device", "cuda"], "expected cpu, or cuda"),
        (["--trials", "9", "--size", "nan"], "--size is nan; expected a number from 0 to"),
        (["--trials", "9", "--out", "plan.json"], "--out is the file plan.json; expected a folder"),
        (["--trials", "9", "--replan", "every-node", "--planner", "me"], "planner is 'me'"),
    ],
)
def test_bad_input_is_one_sentence_and_nothing_is_written(run, plan, tmp_path, arguments, sentence):
    if "cuda" in arguments and torch.cuda.is_available():
        pytest.skip("the device is there")
    done = run("fly", "plan.json", *arguments)
    assert done.returncode == 2
    assert sentence in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["plan.json"]


def test_the_folder_of_a_dataset_is_refused_and_its_manifest_stays(run, plan, tmp_path):
    assert run("sample", "--n", "2", "--count", "2", "--out", "data").returncode == 0
    kept = {path: path.read_bytes() for path in tmp_path.rglob("data/*.json")}
    done = run("fly", "plan.json", "--trials", "1", "--jobs", "1", "--out", "data")
    assert done.returncode == 2
    assert "in data has the schema 'prolearn.dataset/" in done.stderr
    assert "expected 'prolearn.flight/2', or no file of that name" in done.stderr
    assert {path: path.read_bytes() for path in tmp_path.rglob("data/*.json")} == kept
    assert run("sample", "--n", "2", "--count", "2", "--out", "data").returncode == 0


def test_the_folder_of_trials_is_not_one_for_a_dataset(run, flown):
    folder = str(flown[0] / "plan-flown")
    done = run("sample", "--n", "2", "--count", "2", "--out", folder)
    assert done.returncode == 2
    assert "is no dataset's (its schema is prolearn.flight/2); expected one" in done.stderr
    assert "delete" not in done.stderr


def test_radii_obstacles_and_corridors_have_their_rows_and_columns(run, tmp_path):
    scenario = draw("rings", 1, 6, 0, Problem())
    debris = Obstacle("debris", (30.0, -80.0, 20.0, 0.0, -0.0664, 0.01), radius=10.0)
    room = Corridor(Box((-500.0,) * 3, (500.0,) * 3), 0.0, 1200.0)
    made = solve(replace(scenario, obstacles=(debris,), corridors=(room,)))
    write_plan(tmp_path / "plan.json", made)
    told = run("fly", "plan.json", *TRIALS, "--json")
    assert told.returncode == 0, told.stderr
    (found,), table = json.loads(told.stdout)["loops"], run("fly", "plan.json", *TRIALS)
    trials = rows(tmp_path / "plan-flown", "open loop")
    assert found["within_radius"] == pytest.approx((trials["min_clearance"] <= 0).mean())
    assert found["least_clearance"] == trials["min_clearance"].min()
    assert found["outside_corridor"] == pytest.approx((trials["min_margin"] <= 0).mean())
    assert set(trials["clearance_other"]) <= set(range(7))
    assert "too close by sizes" in table.stdout and "outside a corridor" in table.stdout
    assert max(map(len, table.stdout.splitlines())) <= 80
    csv = pd.read_csv(tmp_path / "plan-flown/trials.csv")
    assert csv["least_clearance"][0] == pytest.approx(found["least_clearance"])
    assert csv["outside_corridor_high"][0] == pytest.approx(found["outside_corridor_interval"][1])
    done = run("fly", "plan.json", *REPLANNED)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "obstacles or corridors, which guidance that plans anew does not know" in done.stderr
