"""Experiment 3: seeds compared on the same scenarios."""

from dataclasses import dataclass

import pytest

from pipeline.evaluation.warmstart import RULES, run_warmstarts
from pipeline.expert import SEEDS, Expert
from pipeline.orbit.problem import Problem
from pipeline.scenario import draw

SCENARIOS = [draw("rings", 0, 10, k, Problem()) for k in (1, 2, 3, 5)]


@dataclass(frozen=True)
class Oracle:
    """Predicts the expert's own plan."""

    def predict(self, initial, goal):
        plans = Expert().plan([s for s in SCENARIOS if (s.initial == initial[0]).all()])
        return plans[0].states[None]


@pytest.fixture(scope="module")
def table():
    return run_warmstarts({("oracle", 0): Oracle()}, SCENARIOS)


def test_every_seed_and_rule_has_a_row_for_every_scenario(table):
    counts = table.groupby(["seed", "rule"]).trial.nunique()
    assert set(counts) == {len(SCENARIOS)}
    assert len(counts) == (len(SEEDS) + 1) * len(RULES)


def test_every_run_ends_with_a_safe_plan(table):
    assert table.safe.all()
    assert (table.optimality_gap >= 0).all()
    assert (table.seconds > 0).all()


def test_the_experts_own_plan_as_a_seed_is_done_in_one_solve(table):
    own = table[(table.seed == "oracle") & (table.rule == "first safe")]
    assert own.convex_solves.max() <= 1
