"""Scripts for the simulator Basilisk, run there; it is independent of our code."""

import ast
import subprocess
import sys
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import InputError
from pipeline.expert import solve
from pipeline.export.basilisk import write_basilisk
from pipeline.export.messages import thrust_arcs
from pipeline.export.tables import Masses
from pipeline.flight.effects import effects
from pipeline.flight.world import Conditions, conditions_of, in_world
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import Reference
from pipeline.planners.as_flown import AsFlown
from pipeline.planners.classical import Expert
from pipeline.scenario import draw
from pipeline.scenario.document import read_scenario
from pipeline.scenario.spacecraft import Spacecraft

WHERE = Reference(datetime(2026, 3, 1, 23, 55, tzinfo=UTC), 97.4, 40.0, 350.0)
SIMBOL_X = Path(__file__).parents[3] / "examples/simbol-x.json"


def in_arcs(scenario, count):
    """The scenario with so many intervals in the same time."""
    problem = scenario.problem
    step = problem.duration / count
    return replace(scenario, problem=replace(problem, nodes=count + 1, time_step=step))


def rings(conditions=None, n=4, **problem):
    scenario = replace(draw("rings", 0, n, 3, Problem(**problem)), reference=WHERE)
    return scenario if conditions is None else in_world(scenario, conditions)


def as_flown(scenario):
    return AsFlown(Expert()).plan([scenario])[0]


PLANS = {
    "as flown, with J2": lambda: as_flown(rings(Conditions())),
    "as flown, eccentric, with drag": lambda: as_flown(
        rings(Conditions(eccentricity=0.01, ballistic=0.05, spread=0.5))
    ),
    "linear about an orbit with J2": lambda: solve(rings(Conditions(eccentricity=0.01))),
    "linear about a circle": lambda: solve(rings(nodes=6, time_step=1000 / 3)),
    "one craft, e = 0.8": lambda: as_flown(in_arcs(read_scenario(SIMBOL_X), 400)),
}


EACH = """
import os, runpy, sys
import Basilisk.simulation.dragDynamicEffector, Basilisk.utilities.SimulationBaseClass
for name in sys.argv[1:]:
    if os.fork() == 0:
        os.dup2(os.open(f"{name}.out", os.O_WRONLY | os.O_CREAT), 1)
        sys.argv[:] = [name]
        runpy.run_path(name, run_name="__main__")
        sys.stdout.flush()
        os._exit(0)
    assert os.wait()[1] == 0, name
os._exit(0)
"""
"""Runs scripts, each in a process of its own, which has imported Basilisk already.

None takes apart at its end what it has imported, which takes longer than most of the flights.
"""


@pytest.fixture(scope="module")
def plans(tmp_path_factory):
    """Plans, each with the script that has been written for it and run."""
    folder, found = tmp_path_factory.mktemp("basilisk"), {}
    for k, (name, made) in enumerate(PLANS.items()):
        plan, script = made(), folder / f"swarm{k}.py"
        masses = Masses.of(plan.scenario.n, np.linspace(5, 500, plan.scenario.n).tolist())
        write_basilisk(plan, script, masses)
        found[name] = plan, script
    command = [sys.executable, "-W", "error", "-c", EACH]
    command += [script.name for _, script in found.values()]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder)
    assert done.returncode == 0, done.stderr
    return found


@pytest.fixture(scope="module", params=PLANS, ids=str)
def simulated(request, plans):
    """A plan, and what Basilisk makes of it: LVLH and inertial states by craft and node."""
    plan, script = plans[request.param]
    table = np.loadtxt(script.with_suffix(".nodes.csv"), delimiter=",", skiprows=1)
    n, T = plan.scenario.n, plan.scenario.problem.nodes
    assert (table[:, 0] == np.repeat(np.arange(n), T)).all()
    assert table[:, 2] == pytest.approx(np.tile(plan.scenario.problem.time_step * np.arange(T), n))
    said = script.with_name(f"{script.name}.out").read_text()
    return plan, table[:, 3:9].reshape(n, T, 6), table[:, 9:].reshape(n, T, 6), said


def test_craft_are_where_fly_has_them(simulated):
    plan, seen, _, _ = simulated
    circle = plan.scenario.problem.orbit is None
    about = Conditions(eccentricity=0.0, j2=False).about(WHERE) if circle else None
    about = conditions_of(plan.scenario, about)
    flown = effects(plan.scenario, plan.controls, about)[-1].states
    assert np.linalg.norm((seen - flown)[..., :3], axis=-1).max() < 0.005  # asked for is 1 m
    assert np.linalg.norm((seen - flown)[..., 3:], axis=-1).max() < 1e-5


def test_it_says_how_far_from_its_goal_the_worst_craft_ends(simulated):
    plan, seen, _, said = simulated
    missed = np.linalg.norm((seen[:, -1] - plan.scenario.goal)[:, :3], axis=1)
    told = float(said.split(" ends ")[1].split()[0])
    assert told == pytest.approx(missed.max(), rel=0.01, abs=1e-9)
    assert f"craft {missed.argmax()} ends" in said
    if plan.as_flown:
        assert missed.max() < 0.005


def test_inertial_states_are_those_of_ephemerides_where_motion_is_as_flown(simulated):
    plan, _, inertial, _ = simulated
    if plan.as_flown and plan.scenario.reference:
        starts = thrust_arcs(plan)[1][:, :, 0]
        assert np.linalg.norm((inertial[:, :-1] - starts)[..., :3], axis=-1).max() < 0.01


def test_what_a_name_from_a_file_has_in_it_is_no_code(tmp_path):
    planner = '\'"""\nraise SystemExit(7)\n#{{ 7 * 7 }}'
    scenario = replace(rings(n=2), craft=(Spacecraft(name=planner), Spacecraft(mass=3.0)))
    plan = replace(solve(scenario), planner=planner)
    write_basilisk(plan, tmp_path / '\'+exit(7)+\'""".py', Masses.of(plan.scenario.n))
    (script,) = tmp_path.iterdir()
    body = ast.parse(script.read_text(encoding="utf-8")).body
    assigned = {ast.unparse(one.targets[0]): one for one in body if isinstance(one, ast.Assign)}
    said, epoch = ast.literal_eval(assigned["(PLANNED, EPOCH)"].value)
    assert said == "2 craft by " + planner.replace("\n", "\\n") + ": solved"
    assert epoch == "2026-03-01T23:55:00.000000"
    assert ast.literal_eval(assigned["NODES"].value) == '\'+exit(7)+\'""".nodes.csv'
    assert not any(isinstance(one, ast.Raise) for one in body)
    (names,) = (
        ast.literal_eval(one.value)
        for one in ast.walk(ast.Module(body, []))
        if isinstance(one, ast.Assign) and ast.unparse(one.targets[0]) == "names"
    )
    assert names == [planner.replace("\n", "\\n"), "craft-1"]


def test_a_plan_that_is_nowhere_or_damaged_is_no_script(tmp_path):
    plan = solve(rings(n=2))
    nowhere = replace(plan, scenario=replace(plan.scenario, reference=None))
    with pytest.raises(InputError, match=r'"reference": {.*}.*, or an "orbit": add it'):
        write_basilisk(nowhere, tmp_path / "s.py", Masses.of(plan.scenario.n))
    with pytest.raises(InputError, match="off those that its controls lead to"):
        wrong = replace(plan, states=plan.states * 1.001)
        write_basilisk(wrong, tmp_path / "s.py", Masses.of(plan.scenario.n))
    assert list(tmp_path.iterdir()) == []
