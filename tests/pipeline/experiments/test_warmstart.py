"""Experiment 3: seeds compared on the same scenarios."""

from dataclasses import dataclass

import pytest
from one_swarm import least_separation

from pipeline.experiments.warmstart import RULES, run_warmstarts
from pipeline.expert import SEEDS
from pipeline.expert.plain import PlainScp
from pipeline.expert.seeds import decoupled_seed
from pipeline.orbit.problem import Problem
from pipeline.planners.classical import Expert
from pipeline.scenario import draw

SCENARIOS = [draw("rings", 0, 6, k, Problem()) for k in (2, 0, 6, 7)]
FEW = SCENARIOS[1:3]
"""Scenarios for the plain SCP, which is slow: one of its two plans is safe between nodes."""


@dataclass(frozen=True)
class Oracle:
    """Predicts the expert's own plan."""

    def predict(self, initial, goal):
        plans = Expert().plan([s for s in SCENARIOS if (s.initial == initial[0]).all()])
        return plans[0].states[None]


@pytest.fixture(scope="module")
def table():
    return run_warmstarts({("oracle", 0): Oracle().predict}, [SCENARIOS])


@pytest.fixture(scope="module")
def plain():
    return run_warmstarts({("oracle", 0): Oracle().predict}, [FEW], "plain")


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


def test_the_plain_scp_starts_from_every_seed_and_from_the_decoupled_optima(plain, table):
    counts = plain.groupby(["seed", "rule"]).trial.nunique()
    assert set(counts) == {len(FEW)}
    seeds = {*SEEDS, "decoupled optimum", "oracle"}
    assert {(str(seed), str(rule)) for seed, rule in counts.index} == {
        (seed, "converged") for seed in seeds
    }
    assert list(plain.columns) == list(table.columns)
    assert set(plain.optimizer) == {"plain"}
    assert set(table.optimizer) == {"expert"}


def test_the_plain_scps_plans_are_solved_at_the_nodes_and_called_safe_only_where_they_are(plain):
    assert set(plain.status) == {"solved"}
    scp = PlainScp(6, Problem())
    plans = [scp.solve(s, decoupled_seed(s)) for s in FEW]
    between = [bool(least_separation(p.states, p.controls, Problem()).distance > 15) for p in plans]
    assert plain[plain.seed == "decoupled optimum"].sort_values("trial").safe.tolist() == between
    assert sorted(between) == [False, True]


def test_a_blank_start_costs_the_plain_scp_more_solves_than_a_good_seed(plain):
    solves = plain.groupby("seed").convex_solves.mean()
    assert solves["none"] > solves["straight line"] > solves["decoupled optimum"]
    assert solves["oracle"] < solves["straight line"]
