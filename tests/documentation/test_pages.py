"""The pages that show how to work are run from top to bottom, and the site is built."""

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from sybil import Sybil
from sybil.parsers.markdown import CodeBlockParser, PythonCodeBlockParser
from typer.testing import CliRunner

from cli.main import app

ROOT = Path(__file__).parents[2]
PAGES = ("tutorial", "engineer", "flight", "researcher", "programmer", "api")
PATIENCE = 300.0
"""Seconds after which a block is given up."""


@pytest.fixture
def shell(forked):
    """Run the lines of a block in the folder of the test; each must succeed.

    As on a machine with one core, where no command waits for worker processes to start.
    """
    prolearn = f'prolearn() {{ {shlex.join(forked.command)} "$@"; }}'

    def run(example):
        script = f"set -e\n{prolearn}\n{example.parsed}"
        done = subprocess.run(
            ["bash", "-c", script],
            env=os.environ | {"LOKY_MAX_CPU_COUNT": "1"},
            capture_output=True,
            text=True,
            timeout=PATIENCE,
        )
        assert done.returncode == 0, f"{example.parsed}\n{done.stdout}\n{done.stderr}"

    return run


@pytest.mark.parametrize("page", PAGES)
def test_what_a_page_shows_works_in_its_order(page, shell, migrated, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if page != "tutorial":  # which begins without a store
        shutil.copy(migrated, "mlflow.db")
    parsers = [PythonCodeBlockParser(), CodeBlockParser("bash", shell)]
    document = Sybil(parsers, path=str(ROOT / "docs")).parse(ROOT / "docs" / f"{page}.md")
    examples = list(document.examples())
    assert examples
    for example in examples:
        example.evaluate()


def test_what_the_readme_shows_in_python_works(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    document = Sybil([PythonCodeBlockParser()], path=str(ROOT)).parse(ROOT / "README.md")
    examples = list(document.examples())
    assert examples
    for example in examples:
        example.evaluate()


def test_the_swarm_of_the_readme_is_planned_and_flown_line_by_line(tmp_path, monkeypatch):
    """With a few trials; exit status 1 is that of plans and flights that are not safe."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LOKY_MAX_CPU_COUNT", "1")
    page = (ROOT / "README.md").read_text(encoding="utf-8").replace("\\\n", " ")
    section = page.partition("## A swarm of your own")[2].partition("\n## ")[0]
    lines = [line for line in section.splitlines() if line.startswith("prolearn ")]
    assert len(lines) > 15
    for line in lines:
        words = shlex.split(line.replace("--trials 1000", "--trials 2"), comments=True)
        done = CliRunner().invoke(app, words[1:])
        assert isinstance(done.exception, SystemExit | None), f"{line}: {done.exception!r}"
        assert done.exit_code in (0, 1), f"{line}: {done.output}"


def test_the_site_is_built_without_a_warning():
    """As by `make docs`, after which pages that have not changed are not made again."""
    name = ("--name", "prolearn", "--title", "Commands", "--output", "docs/commands.md")
    commands = ("typer", "cli.main", "utils", "docs", *name)
    build = ("sphinx", "--quiet", "--fail-on-warning", "--keep-going", "docs", "build/docs")
    for module in (commands, build):
        done = subprocess.run(
            [sys.executable, "-m", *module],
            capture_output=True,
            text=True,
            cwd=ROOT,
            env=os.environ | {"PYTHONPATH": str(ROOT)},
        )
        assert done.returncode == 0, done.stderr
    page = (ROOT / "build/docs/mathematics.html").read_text(encoding="utf-8")
    assert "<math" in page
    assert '<mo scriptlevel="0">&#x002D9;</mo></mover>' in page  # dots of full size
    assert "http" not in "".join(part.partition(">")[0] for part in page.split("<script")[1:])
    assert "Safe" in (ROOT / "build/docs/notebook.html").read_text(encoding="utf-8")
    commands_page = (ROOT / "build/docs/commands.html").read_text(encoding="utf-8")
    assert "by mean elements; --altitude is then" in commands_page
    assert ": Scenario files: write one, check one, describe their fields." in commands_page
