"""The ladder: a network's plan where it is proven safe, else one solve, else the expert."""

import json
from dataclasses import replace

import numpy as np
import pytest
from judge import judge_plan

from pipeline.networks.architecture import find
from pipeline.networks.encoding import Encoding
from pipeline.networks.model import Model
from pipeline.orbit.problem import Problem
from pipeline.plan import SOLVED
from pipeline.plan.document import write_plan
from pipeline.planners.ladder import Ladder
from pipeline.planners.named import named_planner
from pipeline.planners.network import Flown
from pipeline.scenario import draw
from pipeline.scenario.document import write_scenario

PROBLEM = Problem()


def refiner(rounds, problem=PROBLEM):
    """An untrained one, which goes by the rule for so many rounds."""
    found = find("refiner")
    encoding = Encoding(problem, 10, "line", "offset", (1.0,) * 6, (1.0,) * 6)
    config = {**found.config, "rounds": rounds}
    return Model("refiner", config, "rule", encoding, found.network(config, encoding, 0.0))


def drawn(n, count, problem=PROBLEM, family="rings"):
    return [draw(family, 3, n, k, problem, "valid") for k in range(count)]


@pytest.mark.parametrize(("family", "count", "rounds"), [("rings", 20, 0), ("dense", 15, 1)])
def test_every_plan_is_safe_and_says_which_rung_it_is_from(family, count, rounds, tmp_path):
    scenarios = drawn(10, count, family=family)
    ladder = Ladder(Flown(refiner(rounds), "refiner"))
    plans = ladder.plan(scenarios)
    names = [plan.planner for plan in plans]
    assert set(names) >= {"refiner", "refiner + one solve"}
    assert set(names) <= {"refiner", "refiner + one solve", "expert"}
    for k, (scenario, plan) in enumerate(zip(scenarios, plans, strict=True)):
        assert plan.status == SOLVED
        files = tmp_path / f"{k}.json", tmp_path / f"{k}.plan.json"
        write_scenario(files[0], scenario)
        write_plan(files[1], plan, scenario)
        assert judge_plan(*(json.loads(file.read_text()) for file in files)).wrong == ()


def test_a_plan_of_the_network_that_is_safe_is_left_as_it_is():
    scenarios = drawn(10, 20)
    flown = Flown(refiner(0), "refiner")
    for own, plan in zip(flown.plan(scenarios), Ladder(flown).plan(scenarios), strict=True):
        if own.status == SOLVED:
            assert plan.planner == "refiner"
            assert plan.convex_solves == 0
            assert np.array_equal(plan.controls, own.controls)
        else:
            assert plan.convex_solves >= 1
            assert plan.timing["plan"] > own.timing["plan"] / 2


def test_a_thrust_limit_that_the_network_knows_nothing_of_is_kept():
    problem = replace(PROBLEM, max_acceleration=1e-3)
    scenarios = drawn(6, 12, problem)
    flown = Flown(refiner(8), "refiner")
    plans = Ladder(flown).plan(scenarios)
    solved = [plan for plan in plans if plan.status == SOLVED]
    assert len(solved) >= 6
    assert any(plan.planner != "refiner" for plan in solved)
    assert all(np.abs(plan.controls).max() <= 1e-3 + 1e-9 for plan in solved)


def test_the_packaged_refiner_plans_right_after_installation():
    scenarios = drawn(10, 40)
    plans = named_planner("refiner").plan(scenarios)
    assert all(plan.status == SOLVED for plan in plans)
    assert sum(plan.planner == "refiner" for plan in plans) >= 38
    raw = named_planner("refiner", raw=True).plan(scenarios)
    gaps = [plan.certificate.optimality_gap for plan in raw]
    assert 0 <= np.mean(gaps) < 0.01
