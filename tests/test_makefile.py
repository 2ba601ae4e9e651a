"""The targets of the Makefile, by the commands that they would run."""

import os
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
# Without what a make that runs the tests tells those below it, and with nothing of a store
ENVIRONMENT = {
    name: value
    for name, value in os.environ.items()
    if name not in {"MAKEFLAGS", "MAKELEVEL", "MFLAGS", "MLFLOW_TRACKING_URI"}
}


def make(*given, **variables):
    """The lines that make prints."""
    made = subprocess.run(
        ["make", *given], capture_output=True, text=True, cwd=ROOT, env=ENVIRONMENT | variables
    )
    assert made.returncode == 0, made.stderr
    return made.stdout.splitlines()


def dry_run(*given):
    """The lines that make would run."""
    return make("--dry-run", *given)


def commands(*given):
    """Those that run a command of prolearn."""
    return [line for line in dry_run(*given) if "bin/prolearn " in line]


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


def test_the_make_of_macos_which_cannot_keep_lines_of_parallel_targets_apart_makes_the_demo():
    option = "--output-sync"
    assert any(option in line for line in dry_run("demo"))
    assert not any(option in line for line in dry_run("demo", ".FEATURES=archives"))


def test_seeds_are_counted_from_0():
    found = "\n".join(dry_run("paper", "SEEDS=3", "LSTM_SEEDS=1"))
    assert "ff1,ff2,ffcol --seed 0,1,2" in found
    assert 'lstm1,lstm2,lstmcol --seed 0"' in found
    assert "refiner --seed 0,1,2" in found


def test_the_ui_of_a_tracking_server_is_at_its_address(tmp_path):
    """The store is connected to and the UI begun by programs that only say so."""
    programs = tmp_path / "bin"
    programs.mkdir()
    for name in ("prolearn", "python", "mlflow"):
        (programs / name).write_text(f'#!/bin/sh\necho {name} "$@"\n')
        (programs / name).chmod(0o755)
    asked = ["ui", f"BIN={programs}", "PORT=5001", f"--old-file={programs}/prolearn"]
    said = {
        uri: make(*asked, MLFLOW_TRACKING_URI=uri)[-1]
        for uri in ("https://mlflow.example", "sqlite:////tmp/a b.db", "")
    }
    own = "mlflow ui --backend-store-uri {} --port 5001"
    assert said.pop("https://mlflow.example").endswith("has the UI: open its address.")
    assert said == {
        "sqlite:////tmp/a b.db": own.format("sqlite:////tmp/a b.db"),
        "": own.format("sqlite:///mlflow.db"),
    }
