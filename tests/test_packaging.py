"""What is installed: four import packages of one distribution, and a light command line."""

import importlib.metadata
import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import yaml

from pipeline.orbit.problem import Problem
from pipeline.scenario import draw
from pipeline.scenario.document import write_scenario

ROOT = Path(__file__).parents[1]


def test_the_citation_and_the_newest_entry_of_the_changelog_have_the_version_of_the_project():
    names = ("pyproject.toml", "CITATION.cff", "CHANGELOG.md")
    project, citation, changelog = ((ROOT / name).read_text(encoding="utf-8") for name in names)
    version = tomllib.loads(project)["project"]["version"]
    released = re.findall(r"^## \[(\d.*?)\] - ", changelog, re.MULTILINE)
    assert yaml.safe_load(citation)["version"] == released[0] == version


def test_the_import_packages_belong_to_prolearn_alone():
    distributions = importlib.metadata.packages_distributions()
    for package in ("prolearn", "pipeline", "registry", "cli"):
        assert set(distributions[package]) == {"prolearn"}, package


def test_the_console_script_is_the_application():
    scripts = importlib.metadata.entry_points(group="console_scripts", name="prolearn")
    assert [script.value for script in scripts] == ["cli.main:app"]


COMMANDS = """
import json, os, sys
from cli.main import app

asked = json.loads(sys.argv[1])
for folder, line in asked["commands"]:
    if child := os.fork():
        assert os.waitpid(child, 0)[1] == 0, line
        continue
    os.chdir(folder)
    os.environ["XDG_CACHE_HOME"] = folder
    sys.argv = ["prolearn", *line.split()]
    try:
        app()
    except SystemExit as end:
        assert end.code == 0
    sys.stdout.flush()
    print(json.dumps(sorted({*asked["packages"]} & {*sys.modules})), file=sys.stderr, flush=True)
    os._exit(0)
"""


def imported(packages, *commands):
    """Those of some packages that each command has imported, and all that the commands say.

    Each, of a folder and a line, is run by a process forked from one with the commands alone.
    """
    asked = json.dumps({"packages": packages, "commands": commands})
    done = subprocess.run([sys.executable, "-c", COMMANDS, asked], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stderr.splitlines()], done.stdout


def test_help_imports_no_heavy_package(tmp_path):
    names = ["", "train", "evaluate", "plan", "tradeoff", "show", "convert"]
    names += ["scenario check", "dataset card", "models list"]
    heavy = ["torch", "mlflow", "cvxpy", "clarabel", "pandas", "matplotlib", "scipy"]
    found, said = imported(heavy, *((str(tmp_path), f"{name} --help") for name in names))
    assert found == [[]] * len(names), dict(zip(names, found, strict=True))
    assert said.count("Usage: prolearn") == len(names)


def test_plans_import_scipy_the_first_time_on_a_grid(tmp_path):
    """Plans of ten craft."""
    heavy = ["torch", "mlflow", "cvxpy", "pandas", "matplotlib", "jinja2", "scipy"]
    heavy += ["scipy.integrate", "scipy.optimize", "scipy.sparse.csgraph", "scipy.stats"]
    planners = [one for one in ("expert", "decoupled-optimum", "refiner") for _ in range(2)]
    for planner in {*planners}:
        (tmp_path / planner).mkdir()
        write_scenario(tmp_path / planner / "s.json", draw("rings", 0, 10, 0, Problem()))
    line = "plan s.json --out p.json --planner {}"
    found, _ = imported(heavy, *((str(tmp_path / one), line.format(one)) for one in planners))
    first, again = ["scipy"], []
    assert found == [first, again] * 3


APART = """
import os, sys

def without(unneeded):
    assert not unneeded & {*sys.modules}, unneeded & {*sys.modules}

import prolearn
without({"matplotlib", "scipy", "jinja2", "pandas", "torch", "mlflow"})
import pipeline.dataset.verifying, pipeline.experiments.flights
unneeded = {"mlflow", "jinja2", "matplotlib"}
without(unneeded | {"torch"})
if child := os.fork():
    import cli.jobs.training
    without(unneeded)
    import torch
    from pipeline.networks.recipes import RECIPES
    from pipeline.training.loop import Descent

    network = torch.nn.Linear(1, 1)
    Descent(network, RECIPES["tuned"], steps=1).step(network(torch.ones(1, 1)).sum())
    without({"torch._dynamo"})
    assert os.waitpid(child, 0)[1] == 0
else:
    import cli.jobs.report
    without({"torch"})
os._exit(0)  # to take apart all that was imported takes as long as half of it
"""


def test_prolearn_and_workers_import_nothing_that_they_do_not_need_and_reports_no_torch():
    """Of MLflow, Jinja2 and Matplotlib no worker needs any, and PyTorch only those that train."""
    done = subprocess.run([sys.executable, "-c", APART], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
