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


@pytest.mark.parametrize(
    "command",
    [
        *([], ["train"], ["evaluate"], ["plan"], ["tradeoff"], ["show"], ["convert"]),
        *(["scenario", "check"], ["dataset", "card"], ["models", "list"]),
    ],
)
def test_help_imports_no_heavy_package(command):
    code = (
        "import sys\n"
        "from cli.main import app\n"
        f"sys.argv = ['prolearn', *{command}, '--help']\n"
        "try:\n    app()\nexcept SystemExit as end:\n    assert end.code == 0\n"
        "heavy = {'torch', 'mlflow', 'cvxpy', 'clarabel', 'pandas', 'matplotlib', 'scipy'}\n"
        "found = heavy & set(sys.modules)\n"
        "assert not found, found\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "Usage: prolearn" in done.stdout


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


@pytest.mark.parametrize(
    ("modules", "heavy"),
    [
        ("pipeline.dataset.verifying, pipeline.experiments.flights", {"torch", "matplotlib"}),
        ("cli.jobs.training", {"matplotlib"}),
    ],
)
def test_workers_import_nothing_that_they_do_not_need(modules, heavy):
    code = f"import sys, {modules}\nassert not {heavy | {'mlflow', 'jinja2'}} & set(sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
