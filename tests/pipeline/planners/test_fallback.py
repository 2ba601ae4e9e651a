"""The fallback planner: a network's plan if proven safe, else one solve, else the expert."""

import json
from dataclasses import replace

import numpy as np
import pytest
from judge import judge_plan
from judged import judged

from pipeline.expert import FIRST_SAFE, solve_many
from pipeline.networks.architecture import find
from pipeline.networks.encoding import Encoding
from pipeline.networks.model import Model
from pipeline.orbit.problem import Problem
from pipeline.plan.document import write_plan
from pipeline.plan.plan import SOLVED, UNSAFE
from pipeline.planners import network
from pipeline.planners.named import named_planner
from pipeline.planners.network import FallbackPlanner, NetworkPlanner
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
def test_every_plan_is_safe_and_says_who_made_it(family, count, rounds, tmp_path):
    scenarios = drawn(10, count, family=family)
    plans = FallbackPlanner(NetworkPlanner(refiner(rounds), "refiner")).plan(scenarios)
    names = [plan.planner for plan in plans]
    assert set(names) >= {"refiner", "refiner + one solve"}
    assert set(names) <= {"refiner", "refiner + one solve", "expert"}
    for k, (scenario, plan) in enumerate(zip(scenarios, plans, strict=True)):
        assert plan.status == SOLVED
        files = tmp_path / f"{k}.json", tmp_path / f"{k}.plan.json"
        write_scenario(files[0], scenario)
        write_plan(files[1], plan)
        assert judge_plan(*(json.loads(file.read_text()) for file in files)).wrong == ()


def test_a_plan_of_the_network_that_is_safe_is_left_as_it_is():
    scenarios = drawn(10, 20)
    flown = NetworkPlanner(refiner(0), "refiner")
    for own, plan in zip(
        flown.plan(scenarios), FallbackPlanner(flown).plan(scenarios), strict=True
    ):
        if own.status == SOLVED:
            assert plan.planner == "refiner"
            assert plan.convex_solves == 0
            assert np.array_equal(plan.controls, own.controls)
        else:
            assert plan.convex_solves >= 1
            assert plan.timing["plan"] > own.timing["plan"] / 2


class Unproven(NetworkPlanner):
    """A network none of whose plans is proven safe, and that takes a second for each."""

    def plan(self, scenarios):
        plans = super().plan(scenarios)
        return [replace(plan, status=UNSAFE, timing={"plan": 1.0}) for plan in plans]


def test_where_one_solve_does_not_do_the_expert_plans_and_all_that_it_took_counts(monkeypatch):
    """One solve that may solve nothing: no network's plan is safe then, nor what comes of it."""
    scenarios = drawn(10, 3)
    nothing = replace(network.ONE_SOLVE, max_rounds=0)
    monkeypatch.setattr(network, "ONE_SOLVE", nothing)
    plans = FallbackPlanner(Unproven(refiner(0), "refiner")).plan(scenarios)
    expert = solve_many(scenarios, settings=FIRST_SAFE)
    for plan, wanted in zip(plans, expert, strict=True):
        assert (plan.planner, plan.status) == ("expert", SOLVED)
        assert np.array_equal(plan.controls, wanted.controls)
        assert plan.timing["plan"] > 1


def test_a_plan_that_no_solve_was_needed_for_does_not_claim_one():
    """A craft alone that may not burn what its optimum needs: the expert sees so at once."""
    problem = replace(PROBLEM, max_acceleration=1e-6)
    (plan,) = FallbackPlanner(NetworkPlanner(refiner(0), "refiner")).plan(drawn(1, 1, problem))
    assert plan.status != SOLVED
    assert (plan.planner, plan.convex_solves) == ("expert", 0)


def test_a_thrust_limit_that_the_network_knows_nothing_of_is_kept():
    problem = replace(PROBLEM, max_acceleration=1e-3)
    scenarios = drawn(6, 12, problem)
    flown = NetworkPlanner(refiner(8), "refiner")
    plans = FallbackPlanner(flown).plan(scenarios)
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


def test_an_effort_beyond_the_first_betters_the_refiners_plans():
    """By the judge's account of fuel, and no plan that the expert had to better is dearer."""
    scenarios = drawn(8, 2, family="dense")
    taken = named_planner("refiner").plan(scenarios)
    for effort in ("default", "best"):
        plans = named_planner("refiner", effort=effort).plan(scenarios)
        reports = [judged(*pair) for pair in zip(scenarios, plans, strict=True)]
        assert all(report.wrong == () for report in reports)
        fuel = np.array([report.fuel for report in reports])
        before = np.array([np.abs(plan.controls).sum() for plan in taken])
        assert all(plan.status == SOLVED for plan in (*taken, *plans))
        assert (fuel <= before * (1 + 1e-9)).all()
        assert (fuel < before * (1 - 1e-4)).any()
        assert {plan.planner for plan in plans} <= {"refiner + expert", "expert"}
