"""- is standard input and output; who stops a plan is told what there is of it."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from forked import LEAD

FULL = Path("/dev/full")  # written to alone, which leaves it as it is


def test_a_pipe_from_scenario_to_plan_to_page_and_table(forked, tmp_path):
    def through(*arguments, given=""):
        done = subprocess.run(
            [*forked.command, *arguments], input=given, capture_output=True, text=True, cwd=tmp_path
        )
        assert done.returncode == 0, done.stderr
        assert "The plan is" not in done.stderr  # it has no name
        assert not done.stderr.startswith("-:")
        return done.stdout

    scenario = through("scenario", "new", "-", "--n", "3")
    assert json.loads(through("scenario", "check", "-", "--json", given=scenario))["fine"]
    plan = through("plan", "-", "--out", "-", given=scenario)
    assert json.loads(plan)["scenario"]["initial"] == json.loads(scenario)["initial"]
    assert through("show", "-", given=plan).startswith("<!doctype html>")
    table = through("convert", "-", "--to", "csv", given=plan)
    assert len(table.splitlines()) == 1 + 3 * 11
    assert through("convert", "-", "--to", "burns", given=plan).startswith("craft,node,time_s,utc,")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("plan", "s.json", "--out", "-", "--json"), "stdout takes one document"),
        (("plan", "s.json", "t.json", "--out", "-"), "a folder for their plans"),
        (("convert", "p.json", "--to", "parquet", "--out", "-"), "parquet is no text"),
        (("fly", "p.json", "--trials", "2", "--out", "-"), "is standard input or output"),
        (("models", "export", "packaged", "--out", "-"), "is standard input or output"),
        (("sample", "--n", "2", "--out", "-"), "is standard input or output"),
        (("solve", "-"), "is standard input or output"),
        (
            ("tradeoff", "s.json", "--duration", "1..1.1h", "--out", "-"),
            "is standard input or output",
        ),
    ],
)
def test_what_standard_output_cannot_take_is_refused(arguments, words, run, prolearn):
    for name in ("s", "t"):
        run("scenario", "new", f"{name}.json", "--n", "2")
    run("plan", "s.json", "--out", "p.json")
    done = prolearn(*arguments)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert words in done.stderr


@pytest.mark.skipif(not FULL.exists(), reason="no device that is always full")
@pytest.mark.parametrize("options", [("--json",), ()])
def test_a_full_disk_behind_stdout_is_named(run, tmp_path, options):
    """Of a document, and of a table."""
    run("scenario", "new", "s.json", "--n", "2")
    code = "from cli.main import app; app()"  # a process whose end is its own
    command = [sys.executable, "-c", code, "plan", "s.json", "--out", "p.json", *options]
    with FULL.open("w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, cwd=tmp_path)
    said = "prolearn: stdout cannot be read or written (No space left on device); expected one that"
    assert done.returncode == 1
    assert done.stderr.startswith(said)
    assert done.stderr.count("\n") == 1


@pytest.mark.skipif(not FULL.exists(), reason="no device that is always full")
@pytest.mark.parametrize("arguments", [(), ("--help",), ("--version",), ("plan", "--help")])
def test_a_full_disk_behind_help_is_named(tmp_path, arguments):
    command = [sys.executable, "-c", "from cli.main import app; app()", *arguments]
    with FULL.open("w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True)
    assert (done.returncode, done.stderr.count("\n")) == (1, 1), done.stderr
    assert "stdout cannot be read or written (No space left on device)" in done.stderr


@pytest.mark.parametrize(
    ("stream", "arguments"),
    [
        ("stdout", ("plan", "s.json", "--out", "-")),
        ("stdout", ("plan", "s.json", "--out", "p.json", "--json")),
        ("stdout", ("convert", "p.json", "--to", "csv", "--out", "-")),
        ("stdout", ("scenario", "check", "s.json", "--json")),
        ("stdout", ("scenario", "new", "-")),
        ("stdin", ("plan", "-", "--out", "p.json")),
        ("stdin", ("scenario", "check", "-")),
    ],
)
def test_a_stream_that_is_closed_is_named(stream, arguments, run, forked, tmp_path):
    run("scenario", "new", "s.json", "--n", "2")
    if arguments[0] == "convert":
        run("plan", "s.json", "--out", "p.json")
    code = (
        "import sys\nfrom cli.main import app\n"
        f"kept, sys.{stream} = sys.{stream}, None\n"  # what Python makes of a closed one
        f"try:\n    app()\nfinally:\n    sys.{stream} = kept\n"
    )
    done = forked.run(arguments, tmp_path, code=code)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert f"{stream} is closed; expected" in done.stderr


def test_where_stdout_is_not_in_utf_8_people_read_on_and_documents_are_as_in_files(
    forked, run, tmp_path
):
    def latin(*arguments):
        environment = os.environ | {"PYTHONIOENCODING": "latin-1", "COLUMNS": "80"}
        command = [*forked.command, *arguments]
        done = subprocess.run(command, capture_output=True, cwd=tmp_path, env=environment)
        assert b"Traceback" not in done.stderr, done.stderr
        assert done.returncode == 0
        return done.stdout

    run("scenario", "new", "s.json", "--n", "2")
    assert "fuel \\u0394v all" in latin("plan", "s.json", "--out", "Δ.json").decode("latin-1")
    (row,) = json.loads(latin("plan", "s.json", "--out", "Δ.json", "--json"))  # bytes: UTF-8
    assert row["plan"] == "Δ.json"
    run("show", "Δ.json", "--out", "page.html")
    assert latin("show", "Δ.json", "--out", "-") == (tmp_path / "page.html").read_bytes()


@pytest.mark.system
def test_who_interrupts_plan_is_told_how_many_plans_there_are(run, forked, tmp_path):
    run("scenario", "new", "short.json", "--n", "2")
    run("scenario", "new", "long.json", "--n", "30", "--nodes", "1000")  # half a minute
    command = ["plan", "short.json", "long.json", "--out", "plans"]
    with (tmp_path / "said").open("w") as said:
        process = forked.start(LEAD, tmp_path, said, command)
    end = time.monotonic() + 60
    while not (tmp_path / "plans/short.plan.json").exists() and time.monotonic() < end:
        time.sleep(0.05)
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    assert process.wait() == 130
    *_, last = (tmp_path / "said").read_text().splitlines()
    assert last == "prolearn: interrupted; 1 of 2 plans was written."
