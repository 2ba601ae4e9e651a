"""Every scenario file of examples/ is planned, flown and shown, and has its story on the page."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cli.main import app
from pipeline.expert import solve
from pipeline.scenario.document import read_scenario

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples").glob("*.json"))


@pytest.mark.parametrize("file", EXAMPLES, ids=lambda file: file.stem)
def test_an_example_is_planned_flown_and_shown(file, tmp_path, monkeypatch):
    """As flown, where it names the orbit and its perturbations; exit status 0 of `fly` says that no
    pair comes too close in the nonlinear flight, nor a craft to an obstacle."""
    monkeypatch.chdir(tmp_path)
    scenario = json.loads(file.read_text())
    world = ["--world"] if "orbit" in scenario else []
    plan = ["plan", file, "--out", "plan.json", *world]
    for command in [plan, ["fly", "plan.json"], ["show", "plan.json", "--out", "plan.html"]]:
        done = CliRunner().invoke(app, [str(word) for word in command])
        assert done.exit_code == 0, f"{command}: {done.output}"
    assert "<h1>Transfer of" in Path("plan.html").read_text(encoding="utf-8")


def test_simbol_x_has_a_bound_within_a_thousandth_of_what_is_published():
    """1.7913 m/s: Arzelier and others 2011, and Benedikter and others 2019, by impulses."""
    plan = solve(read_scenario(ROOT / "examples/simbol-x.json"))
    step = plan.scenario.problem.time_step
    assert plan.certificate.fuel_lower_bound * step == pytest.approx(1.7913, rel=1e-3)
    assert plan.certificate.delta_v == pytest.approx(1.7913, rel=1e-3)


@pytest.mark.parametrize("file", EXAMPLES, ids=lambda file: file.stem)
def test_an_example_has_its_story(file):
    page = (ROOT / "docs/examples.md").read_text(encoding="utf-8")
    assert f"`{file.name}`" in page
