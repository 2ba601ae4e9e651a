"""Progress: counts what is done, up to a total that is the work there is."""

import os
import pty
import re
import shutil
import subprocess

import pytest
from short_transfer import PROBLEM
from typer.testing import CliRunner

from cli.jobs.experiments import classical_planners
from cli.main import app
from cli.progress import progress
from pipeline.dataset.making import sample, solve
from pipeline.dataset.samples import Sample
from pipeline.expert import Settings
from pipeline.orbit.problem import Problem
from pipeline.parallel.workers import Workers
from pipeline.scenario import draw
from pipeline.scenario.document import write_scenario

PLANNERS = len(classical_planners()) + 1
"""Experts, baselines, and one network."""


@pytest.fixture
def run(monkeypatch):
    """Run a command in this process, which says after each step where it is."""
    monkeypatch.setattr("cli.progress.LINE_SECONDS", 0.0)
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)

    def command(*arguments):
        result = CliRunner().invoke(app, [str(a) for a in arguments])
        assert result.exit_code == 0, result.output
        return result

    return command


def steps(result, what):
    """Counts and totals of the lines about some work."""
    found = re.findall(rf"^{re.escape(what)}: (\d+)/(\d+) after", result.stderr, re.MULTILINE)
    return [(int(count), int(total)) for count, total in found]


def all_of(total):
    return [(k, total) for k in range(1, total + 1)]


@pytest.fixture
def data(tmp_path, migrated, monkeypatch):
    """A folder with a dataset of two sizes, 2 test scenarios each, beside an empty store."""
    monkeypatch.chdir(tmp_path)
    shutil.copyfile(migrated, "mlflow.db")
    samples = {n: Sample(count=10, shares=(0.6, 0.2, 0.2), shard_rows=5) for n in (2, 3)}
    sample("data", samples, PROBLEM, workers=Workers(1))
    solve("data", Settings(), workers=Workers(jobs=1))
    return tmp_path / "data"


def test_experiments_count_what_is_done_and_nothing_where_they_were_done_before(run, data):
    trained = run("train", "--arch", "ff1", "--data", data, "--n", 2, "--epochs", 2)
    assert steps(trained, "training ff1 (tuned)") == all_of(2)

    evaluate = ("evaluate", "--data", data, "--timed", 0, "--jobs", 1)
    done = run(*evaluate)
    assert steps(done, "evaluating") == all_of(2 * PLANNERS)
    assert re.search(rf" {PLANNERS}/.* n=3$", done.stderr, re.MULTILINE), "a step is a planner"
    assert run(*evaluate, "--resume").stderr == ""

    # more trials are asked for than there are test scenarios
    warmstart = ("warmstart", "--data", data, "--n", "2,3", "--trials", 50)
    assert steps(run(*warmstart), "warm starts") == all_of(4)
    assert run(*warmstart, "--resume").stderr == ""

    times = ("transfer-times", "--data", data, "--n", 2, "--nodes", "6,11", "--time-step", "60")
    times += ("--jobs", 1)
    assert steps(run(*times), "transfer times") == all_of(3 * PLANNERS - 1), "ff1 fits T = 6 alone"
    assert run(*times, "--resume").stderr == ""

    flights = ("flights", "--data", data, "--n", 2, "--flights", 1, "--jobs", 1)
    assert steps(run(*flights), "flying") == all_of(2)
    assert run(*flights, "--resume").stderr == ""


def test_a_training_that_ends_early_ends_its_progress_and_says_why(run, data):
    # large steps, one instance each: the validation loss soon falls no longer
    options = ("--n", 2, "--epochs", 200, "--learning-rate", 0.05, "--batch-size", 1)
    done = run("train", "--arch", "ff1", "--data", data, *options)
    counts = steps(done, "training ff1 (tuned)")
    last, total = counts[-1]
    assert last == total < 200
    assert counts[:-1] == [(k, 200) for k in range(1, last + 1)]
    assert "ended early" in done.stderr.splitlines()[-1]


def test_a_search_that_goes_on_counts_what_was_left_to_do(run, data):
    pytest.importorskip("optuna")
    search = ("tune", "--arch", "ff1", "--data", data, "--n", 2, "--epochs", 1, "--trials")
    assert steps(run(*search, 1), "tuning ff1") == [(1, 1)]
    assert steps(run(*search, 3), "tuning ff1") == [(1, 2), (2, 2)]
    done = run(*search, 3)
    assert done.stderr == "" and "Complete trials: 3, in" in done.stdout


def test_verifying_counts_the_rows_that_are_there(run, data):
    (data / "n=3/part-00001.parquet").unlink()
    result = CliRunner().invoke(app, ["verify", str(data), "--jobs", "1"])
    assert result.exit_code == 1
    assert steps(result, "verifying")[-1] == (15, 15)


@pytest.fixture
def scenarios(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for k in range(3):
        write_scenario(tmp_path / f"{k}.json", draw("rings", 0, 2, k, Problem()))
    return [f"{k}.json" for k in range(3)]


def test_plans_of_several_files_show_how_many_are_done(run, scenarios):
    done = run("plan", *scenarios, "--out", "plans")
    assert steps(done, "planning") == all_of(3)
    assert first_cells(done.stdout) == ["0", "1", "2"]
    assert run("plan", scenarios[0], "--out", "p.json").stderr == ""


def first_cells(table):
    """Of the rows of a table of plans, between its headings and what is said below."""
    lines = table.splitlines()
    assert lines[1].startswith("scenario") and lines[-1] == "The plans are in plans/."
    return [line.split()[0] for line in lines[2:-1]]


def test_with_a_bar_on_the_terminal_the_table_still_goes_where_it_is_sent(scenarios, forked):
    screen, theirs = pty.openpty()
    try:
        done = subprocess.run(
            [*forked.command, "plan", *scenarios, "--out", "plans"],
            stdout=subprocess.PIPE,
            stderr=theirs,
            env=os.environ | {"COLUMNS": "80", "TERM": "xterm"},
            text=True,
            check=True,
        )
        shown = os.read(screen, 100_000).decode()
    finally:
        os.close(theirs)
        os.close(screen)
    assert first_cells(done.stdout) == ["0", "1", "2"]
    assert "planning" in shown and "3/3" in shown and "scenario" not in shown


def test_on_80_columns_no_number_of_a_bar_is_cut(monkeypatch, capsys):
    for name, value in {"COLUMNS": "80", "FORCE_COLOR": "1", "TERM": "xterm"}.items():
        monkeypatch.setenv(name, value)
    with progress("training lstmcol (tuned), seed 12") as shown:
        shown.expect(1000)
        for _ in range(998):
            shown.done(note="validation loss 0.0001234")
    last = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", capsys.readouterr().err).splitlines()[-1].strip()
    assert re.search(r" 998/1000 \S+/s \d:\d\d:\d\d left \d:\d\d:\d\d ", last), last
    assert len(last) <= 80


def test_an_item_counts_when_the_work_on_it_is_over(monkeypatch, capsys):
    monkeypatch.setattr("cli.progress.LINE_SECONDS", 0.0)
    with progress("working") as shown:
        shown.expect(2)
        for k in range(2):
            assert capsys.readouterr().err.count("working") == min(k, 1)
            shown.done()
    assert "working: 2/2" in capsys.readouterr().err


def test_work_that_expects_no_units_shows_nothing(monkeypatch, capsys):
    monkeypatch.setattr("cli.progress.LINE_SECONDS", 0.0)
    with progress("working") as shown:
        shown.expect(0)
        shown.done()
    assert capsys.readouterr().err == ""


def test_high_rates_are_written_out(monkeypatch, capsys):
    monkeypatch.setattr("cli.progress.LINE_SECONDS", 0.0)
    with progress("drawing") as shown:
        shown.expect(2_000_000)
        shown.done(1_000_000)
    assert re.search(r", \d{1,3}(,\d{3})+/s, ", capsys.readouterr().err)
