"""- is standard input and output; who stops a plan is told what there is of it."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest
from forked import LEAD


def test_a_pipe_from_scenario_to_plan_to_page_and_table(forked, tmp_path):
    def through(*arguments, given=""):
        done = subprocess.run(
            [*forked.command, *arguments], input=given, capture_output=True, text=True, cwd=tmp_path
        )
        assert done.returncode == 0, done.stderr
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


def test_characters_that_the_locale_lacks_are_escapes_for_people_and_whole_in_documents(
    prolearn, tmp_path
):
    def said(*arguments):
        command = [sys.executable, "-c", "from cli.main import app; app()", *arguments]
        locale = os.environ | {"PYTHONIOENCODING": "iso-8859-1"}
        done = subprocess.run(command, capture_output=True, cwd=tmp_path, env=locale)
        assert done.returncode == 0, done.stderr
        return done.stdout

    prolearn("scenario", "new", "\u20ac.json", "--n", "2")
    assert b"\\u0394v" in said("plan", "\u20ac.json", "--out", "plan.json")
    (found,) = json.loads(said("plan", "\u20ac.json", "--out", "plan.json", "--json"))
    assert found["scenario"] == "\u20ac.json"
    assert "\u0394v" in said("show", "plan.json", "--out", "-").decode()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("plan", "s.json", "--out", "-", "--json"), "stdout takes one document"),
        (("plan", "s.json", "t.json", "--out", "-"), "a folder for their plans"),
        (("convert", "p.json", "--to", "parquet", "--out", "-"), "parquet is no text"),
    ],
)
def test_what_standard_output_cannot_take_is_refused(arguments, words, prolearn, tmp_path):
    for name in ("s", "t"):
        prolearn("scenario", "new", f"{name}.json", "--n", "2")
    prolearn("plan", "s.json", "--out", "p.json")
    done = prolearn(*arguments)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert words in done.stderr


@pytest.mark.system
def test_who_interrupts_plan_is_told_how_many_plans_there_are(prolearn, forked, tmp_path):
    prolearn("scenario", "new", "short.json", "--n", "2")
    prolearn("scenario", "new", "long.json", "--n", "4", "--nodes", "1000")  # a minute and more
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
