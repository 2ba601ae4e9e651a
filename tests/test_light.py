"""A light installation plans, checks, flies and shows; what needs more says which extra has it."""

import json
import shutil
import subprocess
import sys
import tomllib
from importlib.metadata import distribution, requires
from importlib.util import cache_from_source
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from pipeline.errors import EXTRAS

ROOT = Path(__file__).parents[1]
PACKAGES = ("prolearn", "pipeline", "registry", "cli")
RINGS = ("--from", "craft=3,size=150,tilt_deg=20", "--to", "craft=3,size=100,tilt_deg=-20")

pytestmark = pytest.mark.system


def run(*command, folder):
    return subprocess.run(
        [str(word) for word in command], capture_output=True, text=True, cwd=folder, timeout=600
    )


@pytest.fixture(scope="module")
def light(tmp_path_factory):
    """An environment with the wheel and what it needs at least; its folder.

    The lock has one version of each distribution, so those are linked that the tests have.
    """
    folder = tmp_path_factory.mktemp("light")
    source, venv = folder / "source", folder / "venv"
    for name in PACKAGES:
        made = shutil.ignore_patterns("__pycache__", "*.so")
        shutil.copytree(ROOT / name, source / name, ignore=made)
    for name in ("pyproject.toml", "setup.py", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source / name)
    wheel = ("wheel", "--quiet", "--no-deps", "--wheel-dir", folder)
    install = ("install", "--quiet", "--no-deps", "--no-index", "--find-links", folder)
    for command in (
        (sys.executable, "-m", "venv", "--without-pip", venv),
        (sys.executable, "-m", "pip", *wheel, source),
        (sys.executable, "-m", "pip", "--python", venv / "bin/python", *install, "prolearn"),
    ):
        done = run(*command, folder=folder)
        assert done.returncode == 0, done.stderr
    (packages,) = venv.glob("lib/python*/site-packages")
    for line in (ROOT / "requirements/light.txt").read_text().splitlines():
        asked = Requirement(line) if line.strip() and line.strip()[0] != "#" else None
        if asked and (asked.marker is None or asked.marker.evaluate()):
            found = distribution(asked.name)
            assert asked.specifier.contains(found.version), (line, found.version)
            link(found, packages)
    return folder


def link(found, packages):
    """Put the files of a distribution, and what is compiled of them, into other packages."""
    for file in found.files:
        for path in {
            Path(found.locate_file(file)),
            Path(cache_from_source(found.locate_file(file))),
        }:
            place = packages / Path(file).parent / path.relative_to(found.locate_file(file).parent)
            if ".." not in Path(file).parts and path.is_file() and not place.exists():
                place.parent.mkdir(parents=True, exist_ok=True)
                place.symlink_to(path)  # the tests may lie on another file system


@pytest.fixture
def mypy(tmp_path_factory, tmp_path, monkeypatch):
    """Function that runs mypy in a new environment without packages; and its site-packages folder.

    The cache of mypy serves all environments of the tests.
    """
    monkeypatch.delenv("PYTHONPATH", raising=False)  # by which mypy would find these files
    made = run(sys.executable, "-m", "venv", "--without-pip", "venv", folder=tmp_path)
    assert made.returncode == 0, made.stderr
    (packages,) = tmp_path.glob("venv/lib/python*/site-packages")
    cache = tmp_path_factory.getbasetemp() / "mypy"

    def check(text):
        (tmp_path / "typed.py").write_text(text)
        options = ("--strict", "--python-executable", "venv/bin/python", "--cache-dir", cache)
        return run(sys.executable, "-m", "mypy", *options, "typed.py", folder=tmp_path).stdout

    return check, packages


def test_types_are_seen_where_it_is_installed_in_place(light, mypy):
    check, packages = mypy
    install = ("install", "--quiet", "--no-deps", "--target", packages)
    editable = ("--editable", light / "source")
    done = run(sys.executable, "-m", "pip", *install, *editable, folder=light)
    assert done.returncode == 0, done.stderr
    said = check("import prolearn\nasked: int = prolearn.read_plan('p.json')\n")
    (fault, _) = said.splitlines()
    assert 'expression has type "Plan", variable has type "int"' in fault, said


TYPED = """
import prolearn
plan = prolearn.plan(prolearn.scenario([prolearn.Ring(size=1.0, craft=2)], [[0.0] * 6]))
reveal_type(plan)
reveal_type(plan.certificate.min_separation)
prolearn.plan("swarm.json")
prolearn.Ring(siez=1.0)
"""


def test_mypy_sees_the_types_of_an_installed_package(light, mypy):
    """Its dependencies are left out, since mypy would check them, too."""
    check, packages = mypy
    (installed,) = light.glob("venv/lib/python*/site-packages")
    for folder in (*installed.glob("prolearn-*.dist-info"), *map(installed.joinpath, PACKAGES)):
        shutil.copytree(folder, packages / folder.name)
    said = check(TYPED)
    assert 'Revealed type is "pipeline.plan.plan.Plan"' in said
    assert 'Revealed type is "float | None"' in said
    assert 'typed.py:6: error: Argument 1 to "plan"' in said
    assert "typed.py:7: error" in said and "typed.py:3" not in said


@pytest.fixture(scope="module")
def rings(light):
    """A scenario that it made."""
    made = run(light / "venv/bin/prolearn", "scenario", "new", "s.json", *RINGS, folder=light)
    assert made.returncode == 0, made.stderr
    return light / "s.json"


SEVERAL = """
import json, os, sys
import clarabel, highspy, jinja2, pydantic, scipy.optimize, scipy.sparse
from cli.main import app

for k, arguments in enumerate(json.loads(sys.argv[1])):
    if child := os.fork():
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
        continue
    said = os.open(f"{k}.txt", os.O_WRONLY | os.O_CREAT)
    for stream in (1, 2):
        os.dup2(said, stream)
    sys.argv = ["prolearn", *arguments]
    app()
"""
"""Code that runs several commands, each in a fork of a process that has imported the libraries.

Their imports would take most of each command's time.
"""


@pytest.fixture
def prolearn(light, rings, tmp_path):
    """Run commands in a folder with a scenario; the exit status of each, and what it said."""
    shutil.copy(rings, tmp_path)

    def several(commands):
        asked = ("-u", "-c", SEVERAL, json.dumps(commands))
        done = run(light / "venv/bin/python", *asked, folder=tmp_path)
        assert done.returncode == 0, done.stderr
        statuses = map(int, done.stdout.split())
        return [(status, (tmp_path / f"{k}.txt").read_text()) for k, status in enumerate(statuses)]

    return several


def test_it_has_ten_direct_dependencies_and_at_most_450_mb(light):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert len(project["dependencies"]) <= 10
    files = [path for path in (light / "venv/lib").rglob("*") if path.suffix != ".pyc"]
    sizes = [path.stat().st_size for path in files if path.is_file()]
    assert 250e6 < sum(sizes) < 350e6  # less pip and what is compiled, which take at most 100 MB
    checked = ("--python", light / "venv/bin/python", "check")
    done = run(sys.executable, "-m", "pip", *checked, folder=light)
    assert done.returncode == 0, done.stdout


def test_it_checks_plans_trades_off_flies_shows_and_converts(prolearn, tmp_path):
    plan = ("plan", "s.json", "--out", "p.json")
    commands = [
        ("scenario", "check", "s.json"),
        (*plan, "--passive-safety", "0.5"),
        (*plan, "--assignment", "optimal", "--json"),
        (*plan, "--risk", "0.01", "--navigation-sigma", "0.1"),
        ("tradeoff", "s.json", "--duration", "20..24min", "--steps", "2"),
        plan,
        ("fly", "p.json"),
        ("show", "p.json"),
        ("convert", "p.json", "--to", "csv"),
    ]
    for command, (status, said) in zip(commands, prolearn(commands), strict=True):
        assert status == 0, (command, said)
    assert (tmp_path / "p.html").stat().st_size > 100_000
    assert (tmp_path / "p.csv").read_text().startswith("craft,node,time_s,x,y,z")


def test_what_needs_more_says_which_extra_in_a_sentence(prolearn):
    extras = {
        ("plan", "s.json", "--out", "p.json", "--planner", "refiner"): "refiner",
        ("plan", "s.json", "--out", "p.json", "--planner", "lstm2"): "learn",
        ("sample", "--n", "3", "--count", "2", "--out", "d"): "learn",
        ("train", "--arch", "ff1"): "learn",
        ("models", "list"): "learn",
        ("models", "export", "packaged"): "onnx",
        ("report",): "learn",
    }
    for command, (status, said) in zip(extras, prolearn([*extras]), strict=True):
        assert status == 2, command
        assert f"pip install 'prolearn[{extras[command]}]'" in said, command
        assert said.count("\n") == 1 and "Traceback" not in said, command


SCRIPT = """
import prolearn
swarm = prolearn.draw("rings", seed=0, n=4, index=0, problem=prolearn.Problem())
plan = prolearn.plan(swarm)
flown = prolearn.monte_carlo(plan, 4, replan="expert")
assert flown.summaries[0].trials == 4
assert prolearn.plot(plan)._repr_png_() and prolearn.show(plan).html
asked = prolearn.models, lambda: prolearn.load_model("ff1"), lambda: prolearn.plan(swarm, "ff1")
for ask in asked:
    try:
        ask()
    except prolearn.InputError as error:
        assert "prolearn[learn]" in str(error)
    else:
        raise AssertionError
"""


def test_it_works_from_python(light, tmp_path):
    done = run(light / "venv/bin/python", "-c", SCRIPT, folder=tmp_path)
    assert done.returncode == 0, done.stderr


def test_the_extras_that_messages_name_are_those_that_bring_the_packages():
    names = {"markdown_it": "markdown-it-py", "yaml": "pyyaml"}
    for extra, packages in EXTRAS.items():
        asked = [one for one in requires("prolearn") if f'extra == "{extra}"' in one]
        for package in packages:
            assert any(one.startswith(names.get(package, package)) for one in asked), package
