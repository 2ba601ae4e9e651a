"""The whole line at the smallest scale: sample, solve, train, evaluate, warm start, report."""

import json
import shutil

from short_transfer import OPTIONS

from pipeline.orbit.problem import Problem
from pipeline.scenario import draw
from pipeline.scenario.document import write_scenario


def test_the_line_runs_from_scenarios_to_report_and_a_plan(prolearn, migrated, tmp_path):
    shutil.copy(migrated, tmp_path)

    def run(*arguments):
        done = prolearn(*arguments, OMP_NUM_THREADS="1")
        assert done.returncode == 0, done.stderr
        return done.stdout

    run("sample", "--n", 4, "--count", 40, *OPTIONS, "--out", "data")
    run("solve", "data", "--jobs", 2)
    assert "sound: 40 rows" in run("verify", "data")
    trained = run("train", "--arch", "ff1,lstm1", "--data", "data", "--n", 4, "--epochs", 2)
    assert "prolearn-ff1 version 1" in trained
    assert "prolearn-lstm1 version 1" in trained
    evaluate = ("evaluate", "--data", "data", "--trials", 2, "--timed", 1, "--resume")
    warmstart = ("warmstart", "--data", "data", "--n", "4", "--trials", 1, "--resume")
    assert "Evaluated; " in run(*evaluate)
    assert "Warm starts done; " in run(*warmstart)
    again = ("--data", "data", "--n", 4, "--epochs", 2, "--seed", "0,1", "--resume")
    resumed = run("train", "--arch", "ff1", *again)
    assert "Trained before: prolearn-ff1 version 1" in resumed
    assert "Trained before: prolearn-ff1 version 2" not in resumed
    assert "prolearn-ff1 version 2" in resumed
    assert "Evaluated; " in run(*evaluate)  # there is another model now
    assert "Evaluated before; " in run(*evaluate)
    assert "Warm starts done; " in run(*warmstart)
    assert "Warm starts done; " in run(*warmstart, "--optimizer", "plain")
    assert "Warm starts done before; " in run(*warmstart)
    times = ("transfer-times", "--data", "data", "--n", 4, "--nodes", "6,11", "--trials", 1)
    assert "Transfer times done; " in run(*times)
    assert "Transfer times done before; " in run(*times, "--resume")
    run("report", "--out", "report")
    page = (tmp_path / "report" / "report.html").read_text()
    for words in ("Experiment 1", "Experiment 2", "Experiment 3", "FF1", "LSTM1", "Expert"):
        assert words in page
    for question in (
        "plan safely and cheaply",
        "speed up the optimizer",
        "work with other nodes T",
    ):
        assert question in page
    # Of twenty craft some are in conflict on their own optima; the grid is not the training's.
    write_scenario(tmp_path / "s.json", draw("rings", 0, 20, 5, Problem(nodes=14, time_step=90.0)))
    said = run("plan", "s.json", "--planner", "lstm1", "--effort", "best", "--out", "p.json")
    plan = json.loads((tmp_path / "p.json").read_text())
    assert plan["status"] == "solved"
    assert plan["planner"] == "lstm1/1 + expert"
    certificate = plan["certificate"]
    assert certificate["min_separation"] > 15
    i, j = certificate["min_separation_pair"]
    (row,) = [line for line in said.splitlines() if line.startswith("s ")]
    assert row.removeprefix("s").strip().startswith("lstm1/1 + expert 0.")
    at, apart = certificate["min_separation_time"], certificate["min_separation"]
    assert row.split()[-4:-1] == [f"{i},{j}", f"{at:.0f}", f"{apart:.2f}"]
    assert said.endswith("The plan is p.json.\n")
    assert "prolearn-lstm1" in run("models", "list")
