"""The whole line at the smallest scale, for people and with --json.

With it stdout is one strict JSON document and nothing else, whatever a command has to say.
"""

import json
import math
import os
import re
import shutil
from dataclasses import dataclass
from pathlib import Path

import mlflow
import numpy as np
import pandas as pd
import pytest
from short_transfer import OPTIONS
from typer.main import get_command

from cli.main import app
from cli.output import print_json
from pipeline.orbit.problem import Problem
from pipeline.scenario import draw
from pipeline.scenario.document import write_scenario

CRAFT = ["--data", "data", "--n", "3"]
TRAIN = ["train", *CRAFT, "--epochs", "2"]
EVALUATE = ["evaluate", *CRAFT, "--trials", "2", "--timed", "1", "--jobs", "1", "--resume"]
WARMSTART = ["warmstart", *CRAFT, "--trials", "1", "--resume"]
TIMES = ["transfer-times", *CRAFT, "--nodes", "6,11", "--trials", "1", "--jobs", "1", "--resume"]

COMMANDS = {
    "sample": [
        *("sample", "--n", "3", "--count", "24", "--shares", "0.5,0.25,0.25", "--out", "data"),
        *OPTIONS,
    ],
    "solve": ["solve", "data", "--jobs", "1"],
    "verify": ["verify", "data", "--jobs", "1"],
    "train": [*TRAIN, "--arch", "ff1,lstm1", "--json"],
    "evaluate": EVALUATE,
    "warmstart": WARMSTART,
    "train another": [*TRAIN, "--arch", "ff1", "--seed", "0,1", "--resume"],
    "train again": [*TRAIN, "--arch", "ff1", "--seed", "0,1", "--resume", "--json"],
    "evaluate another": [*EVALUATE, "--json"],
    "evaluate again": [*EVALUATE, "--json"],
    "evaluate once more": EVALUATE,
    "warmstart another": [*WARMSTART, "--json"],
    "warmstart plain": [*WARMSTART, "--optimizer", "plain"],
    "warmstart again": WARMSTART,
    "transfer-times": [*TIMES, "--json"],
    "transfer-times again": TIMES,
    "flights": ["flights", *CRAFT, *["--trials", "1", "--flights", "1", "--jobs", "1", "--json"]],
    "report": ["report", "--out", "reports", "--json"],
    "plan": ["plan", "s.json", "--planner", "lstm1", "--effort", "best", "--out", "p.json"],
    "list": ["models", "list", "--json"],
    "list as a table": ["models", "list"],
    "show": ["models", "show", "prolearn-ff1/2", "--json"],
    "show as a table": ["models", "show", "prolearn-ff1/2"],
    "tune": ["tune", "--arch", "ff1", "--trials", "1", "--epochs", "1", *CRAFT, "--json"],
    "refiner": ["train", "--arch", "refiner", *CRAFT, "--epochs", "1", "--crowded", "4", "--json"],
    "no dataset": ["verify", "nowhere", "--json"],
    "no model": ["models", "show", "ff9", "--json"],
    "no run": ["report", "--evaluation", "x", "--json"],
}
"""By name, in the order in which they are given."""

GIVE = """
import json, os, sys
from cli.main import app
for name, command in COMMANDS.items():
    for number, kind in ((1, "out"), (2, "err")):
        os.dup2(os.open(f"{name}.{kind}", os.O_CREAT | os.O_WRONLY), number)
    try:
        app(command)
    except SystemExit as end:
        sys.stdout.flush()
        open(f"{name}.status", "w").write(str(end.code))
"""
"""Each command has files of its own for what the process writes, by whatever library."""


@dataclass(frozen=True)
class Given:
    """What came of a command."""

    returncode: int
    stdout: str
    stderr: str


@pytest.fixture(scope="module")
def folder(forked, migrated, tmp_path_factory):
    """Where the commands were given, one after another in one process."""
    here = tmp_path_factory.mktemp("line")
    shutil.copy(migrated, here)
    # Of twenty craft some are in conflict on their own optima; the grid is not the training's.
    write_scenario(here / "s.json", draw("rings", 0, 20, 5, Problem(nodes=14, time_step=90.0)))
    environment = {k: v for k, v in os.environ.items() if k != "MLFLOW_TRACKING_URI"}
    code = f"COMMANDS = {COMMANDS!r}\n{GIVE}"
    forked.run((), here, environment, code=code).check_returncode()
    return here


@pytest.fixture(scope="module")
def given(folder):
    """What came of a command, by its name."""

    def of(name):
        files = (folder / f"{name}.{kind}" for kind in ("status", "out", "err"))
        status, out, err = (file.read_text(encoding="utf-8") for file in files)
        return Given(int(status), out, err)

    return of


def strict(done, status=0):
    """The document on stdout; NaN and infinities, which are no JSON, are refused."""
    assert done.returncode == status, done.stderr

    def refuse(word):
        raise AssertionError(f"{word} is no JSON")

    return json.loads(done.stdout, parse_constant=refuse)


def trials_of(folder, told):
    """The trials of a run, from its artifacts."""
    (path,) = folder.rglob(f"{told['run_id']}/artifacts/tables/table.parquet")
    return pd.read_parquet(path)


def test_the_line_runs_from_scenarios_to_report_and_a_plan(given, folder):
    def said(name):
        done = given(name)
        assert done.returncode == 0, done.stderr
        return done.stdout

    assert "sound: 24 rows" in said("verify")
    assert "Trained before: prolearn-ff1 version 1" in said("train another")
    assert "Trained before: prolearn-ff1 version 2" not in said("train another")
    assert "prolearn-ff1 version 2" in said("train another")
    assert said("evaluate").startswith("Evaluated; ")
    assert not strict(given("evaluate another"))["earlier"], "there is another model now"
    assert said("evaluate once more").startswith("Evaluated before; ")
    assert said("warmstart").startswith("Warm starts done; ")
    assert not strict(given("warmstart another"))["earlier"]
    assert said("warmstart plain").startswith("Warm starts done; ")
    assert said("warmstart again").startswith("Warm starts done before; ")
    assert not strict(given("transfer-times"))["earlier"]
    assert said("transfer-times again").startswith("Transfer times done before; ")
    page = (folder / strict(given("report"))["html"]).read_text()
    for words in ("Experiment 1", "Experiment 2", "Experiment 3", "FF1", "LSTM1", "Expert"):
        assert words in page
    for question in (
        "plan safely and cheaply",
        "speed up the optimizer",
        "work with other nodes T",
    ):
        assert question in page
    plan = json.loads((folder / "p.json").read_text())
    assert plan["status"] == "solved"
    assert plan["planner"] == "lstm1/1 + expert"
    certificate = plan["certificate"]
    assert certificate["min_separation"] > 15
    i, j = certificate["min_separation_pair"]
    (row,) = [line for line in said("plan").splitlines() if line.startswith("s ")]
    assert row.removeprefix("s").strip().startswith("lstm1/1 + expert 0.")
    at, apart = certificate["min_separation_time"], certificate["min_separation"]
    assert row.split()[-4:-1] == [f"{i},{j}", f"{at:.0f}", f"{apart:.2f}"]
    assert said("plan").endswith("The plan is p.json.\n")
    assert "prolearn-lstm1" in said("list as a table")


def test_train_tells_each_model_and_says_the_rest_on_stderr(given):
    first, second = strict(given("train"))
    assert [one["uri"] for one in (first, second)] == [
        "models:/prolearn-ff1/1",
        "models:/prolearn-lstm1/1",
    ]
    assert first["champion"] == 1 and not first["earlier"]
    assert first["contest"] == "the first version of its model"
    for version in ("prolearn-ff1 version 1", "prolearn-lstm1 version 1"):
        assert f"{version} (tuned): best epoch" in given("train").stderr
    again = strict(given("train again"))
    assert [(one["uri"], one["params"]["seed"], one["earlier"]) for one in again] == [
        ("models:/prolearn-ff1/1", "0", True),
        ("models:/prolearn-ff1/2", "1", True),
    ]


def test_models_list_and_show_tell_what_mlflow_has(given, folder):
    listed, shown = strict(given("list")), strict(given("show"))
    assert shown == listed[1]
    client = mlflow.MlflowClient(f"sqlite:///{folder / 'mlflow.db'}")
    run = client.get_run(client.get_model_version("prolearn-ff1", "2").run_id)
    assert shown["run_id"] == run.info.run_id
    assert shown["metrics"] == run.data.metrics
    assert shown["params"] == run.data.params


def test_a_table_of_a_version_has_no_metric_by_swarm_size_as_of_all_of_them(given):
    assert "exp2_flown_fuel" in strict(given("show"))["metrics"], "of the last size"
    table = given("show as a table").stdout
    assert "exp1_flown_fuel" in table
    assert "exp2_" not in table


def test_evaluate_tells_the_averages_of_the_trials_in_its_run(given, folder):
    told = strict(given("evaluate another"))
    assert "evaluating" in given("evaluate another").stderr
    by = ["planner", "reading", "n"]
    means = trials_of(folder, told).groupby(by)["fuel"].mean()
    found = {tuple(row[name] for name in by): row["fuel_mean"] for row in told["averages"]}
    assert found == {key: pytest.approx(mean) for key, mean in means.items()}
    predicted = [row for row in told["averages"] if row["reading"] == "predicted"]
    assert [row["safe_share"] for row in predicted] == [None, None], "not a number is null"
    assert strict(given("evaluate again")) == {**told, "earlier": True}


@pytest.mark.parametrize(
    ("command", "by"),
    [
        ("warmstart another", ["seed", "rule"]),
        ("transfer-times", ["planner", "reading", "nodes", "time_step", "varied"]),
    ],
)
def test_other_experiments_tell_their_averages(given, folder, command, by):
    told = strict(given(command))
    means = trials_of(folder, told).groupby(by)["fuel"].mean()
    found = {tuple(row[name] for name in by): row["fuel_mean"] for row in told["averages"]}
    assert found == {key: pytest.approx(mean) for key, mean in means.items()}


def test_flights_tell_theirs(given, folder):
    told = strict(given("flights"))
    by = ["planner", "n", "planned", "world", "errors", "loop"]
    means = trials_of(folder, told).groupby(by)["goal_error"].median()
    found = {tuple(row[name] for name in by): row["goal_error_median"] for row in told["averages"]}
    assert found == {key: pytest.approx(value) for key, value in means.items()}


def test_the_refiner_and_tune_tell_theirs(given):
    assert strict(given("refiner"))[0]["arch"] == "refiner"
    told = strict(given("tune"))
    assert told["trials"] == 1 and Path(told["storage"]).name == "optuna.db"
    assert math.isfinite(told["value"]) and told["best"]


def test_report_tells_its_files(given, folder):
    files = strict(given("report"))
    assert files["html"] == "reports/report.html"
    for path in (files["html"], files["markdown"], *files["tables"], *files["figures"]):
        assert (folder / path).is_file()


@pytest.mark.parametrize("name", ["no dataset", "no model", "no run"])
def test_bad_input_leaves_stdout_empty(given, name):
    done = given(name)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("prolearn: ")


def test_verify_tells_rows_and_faults(prolearn, tmp_path):
    prolearn(*COMMANDS["sample"], "--jobs", 1)
    done = prolearn("verify", "data", "--jobs", 1, "--json")
    assert strict(done) == {"folder": "data", "repaired": False, "faults": [], "rows": 24}
    assert "verifying: 24/24" in done.stderr
    (tmp_path / "data/notes.txt").write_text("mine")
    what = "does not belong to this dataset"
    fault = {"path": "notes.txt", "what": what, "foreign": True, "sound": False}
    told = strict(prolearn("verify", "data", "--jobs", 1, "--json"), status=1)
    assert told["faults"] == [fault]
    told = strict(prolearn("verify", "data", "--jobs", 1, "--repair", "--json"))
    assert told == {"folder": "data", "repaired": True, "faults": [fault]}


def test_numbers_that_json_has_not_are_null(capsys):
    print_json(
        {
            "a": float("nan"),
            "b": [np.inf, np.float64(0.1), np.int64(3)],
            "c": np.array([1.0, np.nan]),
        }
    )
    assert json.loads(capsys.readouterr().out) == {"a": None, "b": [None, 0.1, 3], "c": [1.0, None]}


def test_the_documentation_names_exactly_the_commands_that_have_it():
    page = (Path(__file__).parents[2] / "docs/cli.md").read_text(encoding="utf-8")
    section = page.partition("## For programs")[2].partition("\n## ")[0]
    said = set(re.findall(r"^\| `prolearn ([a-z -]+)` \|", section, re.MULTILINE))

    def walk(command, path=()):
        if any("--json" in parameter.opts for parameter in command.params):
            yield " ".join(path)
        for name, one in getattr(command, "commands", {}).items():
            yield from walk(one, (*path, name))

    assert said == set(walk(get_command(app)))
