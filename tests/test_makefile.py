"""The targets of the Makefile, by the commands that they would run."""

import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def commands(*given):
    """The lines of prolearn's commands that make would run."""
    made = subprocess.run(["make", "--dry-run", *given], capture_output=True, text=True, cwd=ROOT)
    assert made.returncode == 0, made.stderr
    return [line for line in made.stdout.splitlines() if "bin/prolearn " in line]


def test_the_whole_paper_is_of_the_data_that_are_named():
    found = commands("paper", "DATA=elsewhere/paper")
    assert sum("elsewhere/paper" in line for line in found) == 8
    assert not [line for line in found if "data/paper" in line]


@pytest.mark.parametrize("target", ["paper", "demo"])
def test_every_stage_with_workers_has_as_many_as_are_asked_for(target):
    found = commands(target, "JOBS=3")
    for stage in ("dataset", "evaluate", "transfer-times"):
        (line,) = (line for line in found if f"bin/prolearn {stage} " in line)
        assert "--jobs 3" in line, line
