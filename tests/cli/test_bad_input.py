"""Bad input: one clear sentence, exit status 2, no traceback, nothing written."""

import json
import shutil
import time

import pytest

from pipeline.dataset.making import sample
from pipeline.dataset.samples import Sample
from pipeline.expert import solve
from pipeline.orbit.problem import Problem
from pipeline.parallel.workers import Workers
from pipeline.plan.document import write_plan
from pipeline.scenario import draw
from pipeline.scenario.document import write_scenario

RISKY = ["plan", "good.json", "--out", "p.json", "--navigation-sigma", "0.2"]

CASES = {
    "no spacecraft": (["sample", "--out", "x", "--n", "0"], "n is 0"),
    "a negative radius": (["sample", "--out", "x", "--collision-radius", "-1"], "-1"),
    "a negative altitude": (["sample", "--out", "x", "--altitude", "-1"], "altitude"),
    "an unknown family": (["sample", "--out", "x", "--family", "spiral"], "coplanar-split"),
    "no scenarios": (["sample", "--out", "x", "--count", "0"], "count is 0"),
    "odd shares": (["sample", "--out", "x", "--shares", "1,1,1"], "add up to 1"),
    "shares that are no numbers": (["sample", "--out", "x", "--shares", "nan,0,1"], "0 or more"),
    "shares in words": (["sample", "--out", "x", "--shares", "most"], "three numbers"),
    "no jobs": (["sample", "--out", "x", "--jobs", "0"], "jobs is 0"),
    "no dataset to solve": (["solve", "none"], "none does not exist"),
    "an empty folder to solve": (["solve", "empty"], "empty is empty"),
    "a foreign folder to sample into": (["sample", "--out", "foreign"], "holds other files"),
    "an unknown separation": (["solve", "none", "--separation", "never"], "never"),
    "no dataset to verify": (["verify", "none"], "none does not exist"),
    "an unknown architecture": (["train", "--arch", "ff9"], "ff9"),
    "an unknown recipe": (["train", "--arch", "ff1", "--recipe", "best"], "best"),
    "no dataset to train on": (["train", "--arch", "ff1", "--data", "none"], "none does not"),
    "no epochs": (["train", "--arch", "ff1", "--epochs", "0", "--data", "none"], "epochs is 0"),
    "no dataset to evaluate on": (["evaluate", "--data", "none"], "none does not exist"),
    "odd sizes": (["evaluate", "--data", "none", "--n", "2..x"], "2..30"),
    "a file for a dataset": (["evaluate", "--data", "foreign/file"], "file is a file; expected"),
    "no dataset to warm-start on": (["warmstart", "--data", "none"], "none does not exist"),
    "no trials to warm-start": (["warmstart", "--data", "none", "--trials", "0"], "trials is 0"),
    "an unknown optimizer": (["warmstart", "--optimizer", "magic"], "magic"),
    "no dataset for other times": (["transfer-times", "--data", "none"], "none does not exist"),
    "odd numbers of nodes": (["transfer-times", "--data", "none", "--nodes", "6..x"], "--nodes is"),
    "odd time steps": (
        ["transfer-times", "--data", "none", "--time-step", "60,,90"],
        "60,72.5,240",
    ),
    "no dataset to fly on": (["flights", "--data", "none"], "none does not exist"),
    "no scenarios to fly": (["flights", "--data", "none", "--trials", "0"], "trials is 0"),
    "crowded scenarios for a network that needs plans": (
        ["train", "--arch", "refiner,ff1", "--crowded", "30", "--data", "none"],
        "crowded is given and has no effect on the training of ff1",
    ),
    "no flights": (["flights", "--data", "none", "--flights", "0"], "flights is 0"),
    "no seed to fly with": (["flights", "--data", "none", "--seed", "-1"], "seed is -1"),
    "no processes to fly with": (["flights", "--data", "none", "--jobs", "0"], "jobs is 0"),
    "less than no timing": (
        ["evaluate", "--data", "none", "--n", "2", "--timed", "-1"],
        "timed is -1",
    ),
    "a device that is not there": (
        ["evaluate", "--data", "none", "--device", "cuda:9"],
        "'cuda:9'",
    ),
    "no architecture": (["train", "--arch", ",", "--data", "none"], "such as lstm2"),
    "less than no memory": (
        ["train", "--arch", "ff1", "--memory", "-1", "--data", "none"],
        "memory in GB is -1",
    ),
    "a penalty that the loss has not": (
        ["train", "--arch", "ff1", "--collision-weight", "5", "--data", "none"],
        "has no effect on the training of ff1",
    ),
    "a penalty that one loss has not": (
        ["train", "--arch", "ffcol,lstm2", "--collision-weight", "5", "--data", "none"],
        "has no effect on the training of lstm2",
    ),
    "dropout without hidden layers that drop": (
        ["train", "--arch", "refiner", "--dropout", "0.1", "--data", "none"],
        "leave --dropout out",
    ),
    "an input that is not read": (
        ["train", "--arch", "refiner", "--interior", "zeros", "--data", "none"],
        "leave --interior out",
    ),
    "data of a comparison that is not made": (
        ["models", "promote", "ff1", "--version", "1", "--force", "--data", "none"],
        "expected one of the two",
    ),
    "nothing to report": (["report"], "prolearn"),
    "no scenario file": (["plan", "none.json", "--out", "p.json"], "none.json"),
    "a plan over its scenario": (["plan", "good.json", "--out", "good.json"], "overwritten"),
    "an unknown planner": (["plan", "good.json", "--out", "p.json", "--planner", "hal"], "hal"),
    "a duration without a unit": (["tradeoff", "good.json", "--duration", "10..60"], "10..60min"),
    "a duration that goes backwards": (["tradeoff", "good.json", "--duration", "9..3h"], "9..3h"),
    "a duration that is no range": (["tradeoff", "good.json", "--duration", "0..9s"], "from less"),
    "a transfer of one arc": (["tradeoff", "good.json", "--duration", "2..9min"], "at least 240 s"),
    "no arc in the range": (["tradeoff", "good.json", "--duration", "250..300s"], "multiple of"),
    "no durations": (
        ["tradeoff", "good.json", "--duration", "10..60min", "--steps", "0"],
        "steps is 0",
    ),
    "a file for a folder": (
        ["tradeoff", "good.json", "--duration", "10..60min", "--out", "foreign/file"],
        "expected a folder",
    ),
    **{
        f"a file for a folder, by {command[0]}": (command, "foreign/file is a file; expected a")
        for command in (
            ["scenario", "new", "foreign/file/s.json"],
            ["plan", "good.json", "--out", "foreign/file/p.json"],
            ["tradeoff", "good.json", "--duration", "20..22min", "--out", "foreign/file/x"],
            ["convert", "plan.json", "--to", "csv", "--out", "foreign/file/p.csv"],
            ["show", "plan.json", "--out", "foreign/file/p.html"],
        )
    },
    **{
        f"a URL, by {command[0]} {command[1]}": (command, f"prolearn: {command[-1]}")
        for command in (
            ["scenario", "new", "memory://x/s.json"],
            ["plan", "good.json", "--out", "s3://bucket/p.json"],
            ["plan", "--out", "p.json", "s3://bucket/s.json"],
            ["tradeoff", "good.json", "--duration", "20..22min", "--out", "gs://b"],
            ["fly", "plan.json", "--trials", "2", "--out", "s3://b/flown"],
            ["models", "export", "packaged", "--out", "s3://b/model"],
            ["convert", "plan.json", "--to", "csv", "--out", "s3://b/p.csv"],
            ["show", "plan.json", "--out", "https://x.org/p.html"],
        )
    },
    "a folder for a plan": (["show", "."], ". cannot be read"),
    "no scenario to trade off": (["tradeoff", "none.json", "--duration", "1..2h"], "none.json"),
    "an unknown assignment": (
        ["plan", "good.json", "--out", "p.json", "--assignment", "best"],
        "best",
    ),
    "a risk that is none": ([*RISKY, "--risk", "2"], "risk is 2"),
    "a risk of 0": ([*RISKY, "--risk", "0"], "risk is 0; expected a probability"),
    "no errors and a sigma": ([*RISKY, "--risk", "0.1", "--errors", "none"], "one of the two"),
    "errors of a preset without a risk": (
        ["plan", "good.json", "--out", "p.json", "--errors", "none"],
        "--errors is given without --risk",
    ),
    "a risk of nothing": (["plan", "good.json", "--out", "p.json", "--risk", "0.1"], "no error is"),
    "errors without a risk": (RISKY, "without --risk"),
    "errors that are none": (
        [*RISKY, "--risk", "0.1", "--thrust-sigma", "-1"],
        "thrust_sigma is -1",
    ),
    "a risk at the nodes": (
        [*RISKY, "--risk", "0.1", "--separation", "nodes"],
        "with separation at the nodes only",
    ),
    "nodes without measure": (["sample", "--out", "x", "--nodes", "100000"], "at most 1250"),
    "craft without measure": (["sample", "--out", "x", "--n", "1000000000"], "1 to 10000"),
    "scenarios without measure": (["sample", "--out", "x", "--count", f"{10**9}"], "shards"),
    "an altitude in km": (["sample", "--out", "x", "--altitude", "500"], "in km, give 500000"),
    "an altitude without measure": (["sample", "--out", "x", "--altitude", "1e308"], "altitude"),
    "steps of time without measure": (
        ["sample", "--out", "x", "--time-step", "1e308"],
        "time_step is 1e+308; expected a number from 0.001 to 1e+06",
    ),
    "a transfer without measure": (["sample", "--out", "x", "--time-step", "1e6"], "revolutions"),
    "processes without measure": (["sample", "--out", "x", "--jobs", f"{10**9}"], "up to 1024"),
    "sizes without measure": (["evaluate", "--n", f"2..{10**9}"], "at most 10000 numbers"),
    "durations without measure": (
        ["tradeoff", "good.json", "--duration", "1..9999h"],
        "which is 1250 thrust arcs",
    ),
    "errors without measure": (
        ["plan", "good.json", "--out", "p.json", "--risk", "0.1", "--navigation-sigma", "1e9"],
        "expected a number from 0 to 1000",
    ),
    "a dataset that is a file": (["sample", "--out", "good.json"], "good.json is a file; expected"),
    **{
        f"memory that ends with the command, by {command[0]} {command[-1]}": (
            command,
            f"--out is {command[-1].replace('me:pw@', '')}, memory that is gone when the command",
        )
        for command in (
            ["sample", "--n", "2", "--out", "memory://x"],
            ["sample", "--n", "2", "--out", "simplecache::Memory://x"],
            ["dataset", "--preset", "demo", "--out", "memory://me:pw@x/y"],
        )
    },
    "a model where there is no store": (["models", "show", "hal"], "no tracking store"),
}


@pytest.mark.parametrize("case", CASES)
def test_bad_input_is_one_sentence_and_exit_status_2(case, run, tmp_path):
    arguments, words = CASES[case]
    (tmp_path / "empty").mkdir()
    (tmp_path / "foreign").mkdir()
    (tmp_path / "foreign" / "file").touch()
    scenario = draw("rings", 0, 2, 0, Problem())
    write_scenario(tmp_path / "good.json", scenario)
    write_plan(tmp_path / "plan.json", solve(scenario))
    before = sorted(tmp_path.rglob("*"))
    done = run(*arguments)
    assert done.returncode == 2, done.stderr
    assert words in done.stderr.replace("\n", " ")
    assert "Traceback" not in done.stderr
    assert sorted(tmp_path.rglob("*")) == before


def scenario_file(path, **fields):
    write_scenario(path, draw("rings", 0, 3, 0, Problem()))
    path.write_text(json.dumps(json.loads(path.read_text()) | fields))


HOSTILE = {
    "nodes that ask for gigabytes": ({"nodes": 100_000}, "nodes is 100000; expected at most"),
    "nodes that ask for ever": ({"nodes": 10_000_000}, "nodes is 10000000; expected at most"),
    "craft and nodes together": (
        {
            "nodes": 1000,
            "initial": {"rings": [{"craft": 1001, "size": 2e5}]},
            "goal": {"rings": [{"craft": 1001, "size": 3e5}]},
        },
        "1001 spacecraft and 1000 nodes",
    ),
    "rings that add up": (
        {end: {"rings": [{"craft": 6000, "size": 2e5}] * 2} for end in ("initial", "goal")},
        "at most 10000 craft together",
    ),
    "steps of 1e308 s": ({"time_step": 1e308}, "time_step is 1e+308; expected"),
    "a mean motion in deg/s": ({"mean_motion": 0.0634}, "in deg/s, give 0.0011065387"),
    "a mean motion in rev/day": ({"mean_motion": 15.2}, "revolutions a day, give 0.00110537"),
    "a ring of 3000 km": (
        {end: {"rings": [{"craft": 3, "size": 3e6}]} for end in ("initial", "goal")},
        "10% of the reference orbit's radius",
    ),
    "an orbit of no length": ({"mean_motion": 1e-308}, "mean_motion is 1e-308; expected"),
    "positions that overflow": ({"initial": [[1e308, 0, 0, 0, 0, 0]] * 3}, "within 687814 m"),
    "an integer of 400 digits": ({"collision_radius": 10**400}, "more than 40 digits"),
}


@pytest.mark.parametrize("case", HOSTILE)
@pytest.mark.parametrize("command", [("scenario", "check"), ("plan", "--out", "p.json")])
def test_numbers_without_measure_are_refused_before_they_take_memory(case, command, run, tmp_path):
    fields, words = HOSTILE[case]
    scenario_file(tmp_path / "hostile.json", **fields)
    started = time.monotonic()
    done = run(*command, "hostile.json")
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith("prolearn: hostile.json")
    assert words in done.stderr
    assert done.stderr.count("\n") == 1
    assert time.monotonic() - started < 30  # a second or two where nobody else works


SCENARIO_FAULTS = {
    "a value that is not a number": {"initial": [[float("nan")] * 6] * 3},
    "unequal numbers of states": {"goal": [[0.0] * 6]},
    "a negative radius": {"collision_radius": -15},
    "formations too close from the start": {"initial": [[0.0] * 6] * 3},
    "states that drift": {"goal": [[50.0 * k, 100, 0, 0, 0, 0] for k in range(3)]},
}


@pytest.mark.parametrize("fault", SCENARIO_FAULTS)
def test_a_bad_scenario_among_good_ones_stops_all_before_anything_is_written(fault, run, tmp_path):
    scenario_file(tmp_path / "good.json")
    scenario_file(tmp_path / "bad.json", **SCENARIO_FAULTS[fault])
    done = run("plan", "good.json", "bad.json", "--out", "plans")
    assert done.returncode == 2
    assert done.stderr.startswith("prolearn: bad.json")
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "plans").exists()


def test_a_scenario_among_others_that_cannot_be_planned_as_asked_is_named(run, tmp_path):
    scenario_file(tmp_path / "a.json")
    scenario_file(tmp_path / "b.json", craft=[{"radius": 1.0}] * 3)
    risk = ("--risk", "0.1", "--navigation-sigma", "0.1")
    done = run("plan", "a.json", "b.json", "--out", "plans", *risk)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    told = "prolearn: 1 of 2 plans was written; b.json: a risk is asked for, and craft have radii"
    assert done.stderr.startswith(told)
    assert [path.name for path in (tmp_path / "plans").iterdir()] == ["a.plan.json"]
    alone = run("plan", "b.json", "--out", "plans", *risk)
    assert alone.stderr.startswith("prolearn: b.json: a risk is asked for")


def test_drift_is_accepted_where_it_is_allowed(run, tmp_path):
    scenario_file(tmp_path / "drift.json", **SCENARIO_FAULTS["states that drift"])
    done = run("plan", "drift.json", "--out", "p.json", "--allow-drift")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "p.json").exists()


def test_a_file_that_cannot_be_made_is_said_by_its_own_name(run, tmp_path):
    name = 240 * "x" + ".json"  # with what our temporary file's has besides, too long
    done = run("scenario", "new", name, "--n", "2")
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    said = "cannot be read or written (File name too long); expected one that can: name another"
    assert done.stderr.startswith(f"prolearn: {name} {said}")
    assert list(tmp_path.iterdir()) == []


IN_A_READ_ONLY_FOLDER = """
from pathlib import Path
from cli.main import app
from pipeline.planners.classical import Expert
from rights import read_only

Expert.plan = None  # whoever plans gets a traceback
with read_only(Path.cwd()):
    app()
"""


@pytest.mark.parametrize(
    ("command", "file"),
    [
        (("plan", "a.json", "--out", "p.json"), "p.json"),
        (("plan", "a.json", "b.json", "--out", "plans"), "plans/a.plan.json"),
        (("tradeoff", "a.json", "--duration", "20..40min"), "a-tradeoff/tradeoff.csv"),
        (("tradeoff", "a.json", "--duration", "20..40min", "--out", "there"), "there/tradeoff.csv"),
    ],
)
def test_a_place_that_cannot_be_written_to_is_refused_before_anything_is_planned(
    command, file, forked, tmp_path
):
    (tmp_path / "there").mkdir()
    for name in ("a", "b"):
        scenario_file(tmp_path / f"{name}.json")
    before = sorted(tmp_path.rglob("*"))
    done = forked.run(command, tmp_path, code=IN_A_READ_ONLY_FOLDER)
    said = f"prolearn: {file} cannot be read or written (Permission denied); expected one that can"
    assert (done.returncode, done.stderr.count("\n")) == (1, 1), done.stderr
    assert done.stderr.startswith(said)
    assert sorted(tmp_path.rglob("*")) == before


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sampled")
    sample(folder, {2: Sample("rings", 0, 2)}, Problem(), workers=Workers(1))
    write_scenario(folder.parent / "s.json", scenario := draw("rings", 0, 2, 0, Problem()))
    write_plan(folder.parent / "p.json", solve(scenario))
    return folder


@pytest.mark.parametrize(
    "command",
    [
        ("scenario", "new", "data/new.json"),
        ("plan", "s.json", "--out", "data/new.json"),
        ("plan", "s.json", "s2.json", "--out", "data/plans"),
        ("tradeoff", "s.json", "--duration", "20..40min", "--out", "data"),
        *(("convert", "p.json", "--to", to, "--out", "data/new") for to in ("oem", "csv")),
        ("show", "p.json", "--out", "link/new.html"),
        ("fly", "p.json", "--trials", "1", "--out", "data/n=2/new"),
        ("models", "export", "packaged", "--out", "data/new"),
        ("report", "--out", "data"),
        ("report", "--out", "data/reports/new"),
        ("sample", "--out", "data/new"),
        ("sample", "--out", "file:///proc/self/cwd/data/new"),
        ("dataset", "--out", "data/new"),
    ],
)
def test_no_command_writes_into_a_datasets_folder(command, run, dataset, tmp_path):
    """There ``verify`` would call the files foreign, and ``verify --repair`` set them aside."""
    shutil.copytree(dataset, tmp_path / "data")
    (tmp_path / "link").symlink_to("data")
    for source, copy in (("s.json", "s.json"), ("s.json", "s2.json"), ("p.json", "p.json")):
        shutil.copyfile(dataset.parent / source, tmp_path / copy)
    before = sorted(tmp_path.rglob("*"))
    done = run(*command)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert f"inside {tmp_path / 'data'}, which is a dataset's folder; expected" in done.stderr
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize(("one", "other"), [("a", "a"), ("a", "A"), ("\u00e9", "E\u0301")])
def test_scenarios_whose_plans_some_file_system_would_take_for_one_are_refused(
    one, other, run, tmp_path
):
    for folder, name in (("1", one), ("2", other)):
        (tmp_path / folder).mkdir()
        scenario_file(tmp_path / folder / f"{name}.json")
    done = run("plan", f"1/{one}.json", f"2/{other}.json", "--out", "plans")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert "differ in case alone; expected different names" in done.stderr
    assert not (tmp_path / "plans").exists()
