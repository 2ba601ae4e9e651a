"""The refiner's rule alone, without its network."""

import numpy as np
import pytest
from judged import judged

from benchmarks.fallback import rule
from pipeline.networks.architecture import find
from pipeline.networks.encoding import Encoding
from pipeline.networks.model import Model
from pipeline.orbit.problem import Problem
from pipeline.planners.classical import BASELINES
from pipeline.planners.network import NetworkPlanner
from pipeline.scenario import draw

PROBLEM = Problem()
REFINER = find("refiner")
SCENARIOS = [draw("dense", 0, 8, k, PROBLEM, "valid") for k in range(4)]


def untrained(rounds):
    """A refiner that has learned nothing yet, so that it goes by the rule."""
    encoding = Encoding(PROBLEM, 10, "line", "offset", (1.0,) * 6, (1.0,) * 6)
    config = {**REFINER.config, "rounds": rounds}
    network = REFINER.network(config, encoding, 0.0)
    return Model("refiner", config, "tuned", encoding, network)


def test_the_judge_finds_of_the_rule_s_plans_what_they_claim():
    plans = rule(8).plan(SCENARIOS)
    for scenario, plan in zip(SCENARIOS, plans, strict=True):
        assert judged(scenario, plan).wrong == ()
    assert {(plan.planner, plan.status) for plan in plans} == {("rule", "solved")}


@pytest.mark.parametrize("rounds", [0, 1, 2, 4])
def test_an_untrained_refiner_burns_what_the_rule_does_after_as_many_rounds(rounds):
    fuels = [
        [plan.certificate.fuel for plan in planner.plan(SCENARIOS)]
        for planner in (rule(rounds), NetworkPlanner(untrained(rounds), "refiner"))
    ]
    np.testing.assert_allclose(*fuels, rtol=1e-7)


def test_without_rounds_the_rule_plans_each_craft_s_own_optimum():
    own = next(planner for planner in BASELINES if planner.name == "decoupled optimum")
    for plan, other in zip(rule(0).plan(SCENARIOS), own.plan(SCENARIOS), strict=True):
        assert plan.certificate.fuel == pytest.approx(other.certificate.fuel, rel=1e-9)
        np.testing.assert_allclose(plan.states, other.states, atol=1e-6)


def test_the_rule_without_scenarios_plans_nothing():
    assert rule(3).plan([]) == []
