"""What is installed: four import packages of one distribution, and a light command line."""

import importlib.metadata
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
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


@pytest.mark.parametrize("package", ["prolearn", "pipeline", "registry", "cli"])
def test_the_import_packages_belong_to_prolearn_alone(package):
    assert set(importlib.metadata.packages_distributions()[package]) == {"prolearn"}


def test_the_console_script_is_the_application():
    scripts = importlib.metadata.entry_points(group="console_scripts", name="prolearn")
    assert [script.value for script in scripts] == ["cli.main:app"]


HELP = """
import os, sys
from cli.main import app

for command in sys.argv[1:]:
    if child := os.fork():
        assert os.waitpid(child, 0)[1] == 0, command
        continue
    sys.argv = ["prolearn", *command.split(), "--help"]
    try:
        app()
    except SystemExit as end:
        assert end.code == 0
    heavy = {"torch", "mlflow", "cvxpy", "clarabel", "pandas", "matplotlib", "scipy"}
    found = heavy & set(sys.modules)
    assert not found, found
    sys.stdout.flush()
    os._exit(0)
"""
"""Shows help in a process for each command, all forked from one that has imported the commands."""


def test_help_imports_no_heavy_package():
    commands = ["", "train", "evaluate", "plan", "tradeoff", "show", "convert"]
    commands += ["scenario check", "dataset card", "models list"]
    asked = [sys.executable, "-c", HELP, *commands]
    done = subprocess.run(asked, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("Usage: prolearn") == len(commands)


def heavy_in_a_plan(planner, folder):
    """The heavy packages that a process has imported when it has planned ten craft."""
    write_scenario(folder / "s.json", draw("rings", 0, 10, 0, Problem()))
    code = (
        "import sys\n"
        "from cli.main import app\n"
        f"sys.argv = 'prolearn plan s.json --out p.json --planner {planner}'.split()\n"
        "try:\n    app()\nexcept SystemExit as end:\n    assert end.code == 0\n"
        "heavy = {'torch', 'mlflow', 'cvxpy', 'pandas', 'matplotlib', 'jinja2', 'numba', 'scipy'}\n"
        "heavy |= {'scipy.integrate', 'scipy.optimize', 'scipy.sparse.csgraph', 'scipy.stats'}\n"
        "print(*sorted(heavy & set(sys.modules)), file=sys.stderr)\n"
    )
    home = {**os.environ, "XDG_CACHE_HOME": str(folder)}
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder, env=home)
    assert done.returncode == 0, done.stderr
    return done.stderr.split()


@pytest.mark.parametrize("planner", ["expert", "decoupled-optimum"])
def test_the_first_plan_on_a_time_grid_imports_scipy_and_others_no_heavy_package(planner, tmp_path):
    assert heavy_in_a_plan(planner, tmp_path) == ["scipy"]
    assert heavy_in_a_plan(planner, tmp_path) == []


def test_planning_by_the_refiner_imports_numba_which_imports_scipy(tmp_path):
    assert heavy_in_a_plan("refiner", tmp_path) == ["numba", "scipy"]


def test_workers_import_nothing_that_they_do_not_need():
    """Neither those that verify and fly, nor, thereafter in the same process, those that train."""
    unneeded = {"mlflow", "jinja2", "matplotlib"}
    code = (
        "import sys, pipeline.dataset.verifying, pipeline.experiments.flights\n"
        f"assert not {unneeded | {'torch'}} & set(sys.modules)\n"
        "import cli.jobs.training\n"
        f"assert not {unneeded} & set(sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_lists_of_models_and_reports_import_no_torch():
    code = "import sys, cli.jobs.report\nassert 'torch' not in sys.modules, 'torch is imported'"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
