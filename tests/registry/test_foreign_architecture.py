"""Architectures of another distribution: the documented examples, installed on the spot."""

import json
import os
import re
from collections.abc import Callable
from pathlib import Path

import documented
import pytest
from forked import Forked
from short_transfer import PROBLEM

from pipeline.scenario import draw
from pipeline.scenario.document import write_scenario

PREDICT = """
import mlflow, numpy as np
model = mlflow.pyfunc.load_model(f"models:/prolearn-{sys.argv[1]}@champion")
for n in (1, 7):
    ends = np.ones((2, n, 6))
    states = model.predict({"initial": ends, "goal": 2 * ends})
    assert states.shape == (2, n, 6, 6) and np.isfinite(states).all()
print("predicted")
"""

PLACES = """
import sys
sys.path.insert(0, {site!r})
sys.argv[1:] = {arguments!r}
"""

COMMANDS = """
import json
from cli.main import app
for command in json.loads(sys.argv[1]):
    app(command, standalone_mode=False)
"""

BLANK = """
from blank import leave_blank
leave_blank()
"""

Python = Callable[..., str]


@pytest.fixture
def python(forked: Forked, folder: Path, tmp_path: Path) -> Python:
    """Runs code where they are installed, and gives what it prints."""
    documented.install(tmp_path / "site")
    site = str(tmp_path / "site")

    def run(code: str, *arguments: str) -> str:
        places = PLACES.format(site=site, arguments=list(arguments))
        environment = os.environ | {"MLFLOW_TRACKING_URI": f"sqlite:///{folder / 'mlflow.db'}"}
        done = forked.run((), folder, environment, code=places + code)
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


def test_one_that_learns_the_expert_s_plans_is_trained_and_loaded_like_the_built_in_ones(
    folder: Path, python: Python, solved: Path
) -> None:
    command = ["train", "--arch", "shared", "--data", str(solved), "--n", "3", "--epochs", "3"]
    assert "prolearn-shared version 1 (tuned)" in python(COMMANDS, json.dumps([command]))

    (needed,) = (folder / "mlruns").rglob("requirements.txt")
    assert "their-networks==1.2" in needed.read_text().split()
    (document,) = (folder / "mlruns").rglob("model.json")
    assert re.search('"architecture": "shared"', document.read_text())
    assert python(PREDICT, "shared").split() == ["predicted"]


def test_what_other_code_or_another_version_of_one_has_made_is_made_again(
    folder: Path, python: Python, solved: Path, tmp_path: Path
) -> None:
    data = ["--data", str(solved), "--n", "3"]
    commands = json.dumps(
        [
            ["train", "--arch", "shared", "--epochs", "1", "--resume", *data],
            ["evaluate", "--models", "shared/1", "--trials", "1", "--jobs", "1", "--resume", *data],
            ["tune", "--arch", "shared", "--trials", "1", "--epochs", "1", *data],
            ["train", "--arch", "ff1", "--epochs", "1", "--resume", *data],
        ]
    )

    def before() -> tuple[bool, bool, bool, bool]:
        said = python(BLANK + COMMANDS, commands)
        (search,) = re.findall(r"best .* on validation data; MLflow run (\w+)", said)
        known = search in searches
        searches.add(search)
        words = ("before: prolearn-shared", "Evaluated before", "before: prolearn-ff1")
        trained, evaluated, ours = (word in said for word in words)
        return trained, evaluated, known, ours

    def change(name: str, old: str, new: str) -> None:
        path = tmp_path / "site" / name
        text = path.read_text(encoding="utf-8")
        assert old in text
        path.write_text(text.replace(old, new), encoding="utf-8")

    searches: set[str] = set()
    assert before() == (False, False, False, False)
    change("my_networks.py", "return network(", "return 2 * network(")
    assert before() == (False, False, False, True)
    change("their_networks-1.2.dist-info/METADATA", "Version: 1.2", "Version: 1.3")
    assert before() == (False, False, False, True)
    change("my_networks.py", "class Shared(Supervised):", "class Shared(Supervised):  # as before")
    change("my_controls.py", "1000 * (depth > 0)", "2000 * (depth > 0)")
    assert before() == (True, True, True, True)


def test_one_that_learns_without_plans_is_trained_searched_promoted_and_planned_with(
    folder: Path, python: Python, solved: Path
) -> None:
    scenario = draw("rings", seed=5, n=4, index=0, problem=PROBLEM)
    write_scenario(folder / "scenario.json", scenario)
    data = ["--data", str(solved), "--n", "3", "--epochs", "1"]
    said = python(
        COMMANDS,
        json.dumps(
            [
                ["train", "--arch", "gentle", "--seed", "0..1", *data],
                ["train", "--arch", "gentle", "--resume", *data],
                ["models", "promote", "gentle", "--version", "1", "--force"],
                ["tune", "--arch", "gentle", "--trials", "2", *data],
                ["evaluate", "--models", "gentle", *data[:4], "--trials", "3"],
                ["plan", "scenario.json", "--planner", "gentle", "--raw", "--out", "raw.json"],
                ["plan", "scenario.json", "--planner", "gentle", "--out", "safe.json"],
            ]
        ),
    )
    assert "prolearn-gentle version 2 (tuned)" in said
    assert re.search(r"version [12]; of 6 validation scenarios .* are safe with version 2", said)
    assert "Trained before: prolearn-gentle version 1" in said
    assert "Evaluated; MLflow run" in said
    best = r"best \d\S* of best_valid_loss on validation data"
    assert re.search(rf"Complete trials: 2, .*; {best}", said)
    raw, safe = (json.loads((folder / f"{name}.json").read_text()) for name in ("raw", "safe"))
    assert raw["planner"] == "gentle/1"
    assert safe["status"] == "solved"
    assert python(PREDICT, "gentle").split() == ["predicted"]
