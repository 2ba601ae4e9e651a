"""Experiments 1 and 2: planners that are judged alike, and known by hand."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
import pytest
from judge import Case, least_fuel
from judged import check_rows, document, judged
from threadpoolctl import threadpool_info, threadpool_limits

from pipeline.experiments.trials import Comparison, EvaluatedPlanner, run_trials
from pipeline.experiments.warmstart import run_warmstarts
from pipeline.expert import decoupled_optima
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import fly, minimum_energy, straight_line
from pipeline.parallel.workers import Workers
from pipeline.plan.requirements import AT_ALL_TIMES, Requirements
from pipeline.planners.classical import BASELINES, Expert
from pipeline.scenario import draw

PROBLEM = Problem()
SCENARIOS = [draw("rings", 4, 8, k, PROBLEM) for k in range(12)]
NODES_ONLY = Expert(name="expert (nodes only)", requirements=Requirements("nodes"))
PLANNERS = (Expert(), NODES_ONLY, *BASELINES)
ALONE = Workers(jobs=1)


@dataclass(frozen=True)
class Shifted:
    """Predicts the minimum-energy transfer, moved by a metre in x at the first node."""

    def predict(self, initial, goal):
        states = fly(initial, minimum_energy(initial, goal, PROBLEM), PROBLEM)
        states[..., 0, 0] += 1.0
        return states


@pytest.fixture(scope="module")
def trials():
    energy = next(b for b in BASELINES if b.name == "minimum energy")
    entrants = [
        *(EvaluatedPlanner(planner) for planner in PLANNERS),
        EvaluatedPlanner(energy, recipe="hand-made", predictor=Shifted().predict),
    ]
    (table,) = run_trials([Comparison(entrants, SCENARIOS)], timed=2, workers=ALONE)
    return table


def of(trials, planner, reading="plan"):
    return trials[(trials.planner == planner) & (trials.reading == reading)]


def test_every_planner_has_a_row_for_every_trial(trials):
    counts = trials.groupby(["planner", "recipe", "reading"]).trial.nunique()
    assert set(counts) == {len(SCENARIOS)}
    assert len(counts) == 7


def test_the_expert_is_safe_in_every_trial_and_never_below_the_bound(trials):
    expert = of(trials, "expert")
    assert expert.safe.all()
    assert (expert.pair_conflicts == 0).all()
    assert (expert.fuel >= expert.fuel_lower_bound * (1 - 1e-9)).all()


@pytest.mark.parametrize("planner", PLANNERS, ids=lambda planner: planner.name)
def test_a_row_says_of_a_plan_what_an_independent_judge_finds(trials, planner):
    plans = planner.plan(SCENARIOS)
    reports = [judged(s, plan) for s, plan in zip(SCENARIOS, plans, strict=True)]
    assert not any(report.false_claims for report in reports)
    check_rows(of(trials, planner.name), reports)


def test_plans_apart_at_the_nodes_only_are_not_called_safe_where_pairs_conflict(trials):
    nodes = of(trials, "expert (nodes only)")
    plans = PLANNERS[1].plan(SCENARIOS)
    between = [judged(s, p).pair_conflicts for s, p in zip(SCENARIOS, plans, strict=True)]
    assert (nodes.node_collisions == 0).all()
    assert nodes.safe.tolist() == [conflicts == 0 for conflicts in between]
    assert 0 < nodes.safe.sum() < len(SCENARIOS)


def test_own_optima_burn_the_bound_and_minimum_energy_more(trials):
    own, energy = of(trials, "decoupled optimum"), of(trials, "minimum energy")
    assert own.fuel.to_numpy() == pytest.approx(own.fuel_lower_bound.to_numpy(), rel=1e-6)
    assert (energy.fuel.to_numpy() > 1.05 * own.fuel.to_numpy()).all()


def test_a_prediction_is_judged_raw_with_its_errors_beside(trials):
    predicted = of(trials, "minimum energy", "predicted")
    assert predicted.boundary_error.to_numpy() == pytest.approx(1.0)
    assert not predicted.safe.any()
    assert predicted.min_separation.isna().all()


def test_states_that_no_control_joins_violate_the_dynamics_by_their_velocities(trials):
    # A craft that is moved by 1 m is back at the next node by a constant thrust that gains it
    # 2 m / Δt there, a velocity that the prediction does not have.
    predicted = of(trials, "minimum energy", "predicted")
    velocity = 2.0 / PROBLEM.time_step
    expected = velocity / PROBLEM.mean_motion
    assert predicted.dynamics_error.to_numpy() == pytest.approx(expected, rel=0.02)


def test_only_the_trials_that_were_asked_for_are_timed(trials):
    assert of(trials, "expert").seconds.notna().sum() == 2
    assert (trials.seconds.dropna() > 0).all()


def test_the_straight_line_flown_is_the_flyable_trajectory_nearest_to_it():
    scenario = SCENARIOS[0]
    line = straight_line(scenario.initial, scenario.goal, PROBLEM.nodes)
    plan = next(b for b in BASELINES if b.name == "straight line").plan([scenario])[0]
    weight = np.repeat([1.0, 1 / PROBLEM.mean_motion], 3)
    energy = fly(
        scenario.initial, minimum_energy(scenario.initial, scenario.goal, PROBLEM), PROBLEM
    )
    assert (
        np.square((plan.states - line) * weight).sum() < np.square((energy - line) * weight).sum()
    )
    assert plan.certificate.goal_error < 1e-6


def test_the_bound_is_the_optimum_that_highs_finds_and_proves():
    for scenario in SCENARIOS:
        own = decoupled_optima(scenario.initial, scenario.goal, scenario.problem)
        bound = own.lower_bound.sum()
        problem = Case.of(document(scenario))
        found = least_fuel(problem, scenario.initial, scenario.goal)
        assert found.proven.sum() * (1 - 1e-6) <= bound <= found.attained.sum() * (1 + 1e-9)


def test_rows_are_the_same_for_any_number_of_workers_and_times_are_of_those_that_are_timed():
    entrants = [EvaluatedPlanner(planner) for planner in PLANNERS]
    few, more = SCENARIOS[:3], [draw("rings", 4, 5, k, PROBLEM) for k in range(3)]
    sizes = [Comparison(entrants, more), Comparison(entrants[1:], few)]
    alone, spread = (run_trials(sizes, timed=1, workers=Workers(jobs=k)) for k in (1, 2))
    assert [len(table) for table in alone] == [15, 12]
    for one, other in zip(alone, spread, strict=True):
        assert (one.seconds.notna() == (one.trial == 0)).all()
        assert (other.seconds.notna() == (other.trial == 0)).all()
        pd.testing.assert_frame_equal(one.drop(columns="seconds"), other.drop(columns="seconds"))


@dataclass
class Watched:
    """The expert, and how many threads of linear algebra it had whenever it was asked."""

    threads: list[int]
    name: str = "watched"
    requirements: Requirements = AT_ALL_TIMES

    def plan(self, scenarios):
        self.threads.append(max(pool["num_threads"] for pool in threadpool_info()))
        return Expert().plan(scenarios)


def test_planners_plan_on_one_thread_whatever_they_have_otherwise():
    watched = Watched([])
    with threadpool_limits(2):
        run_trials([Comparison([EvaluatedPlanner(watched)], SCENARIOS[:2])], timed=2)
    assert watched.threads == [1, 1, 1, 1]  # warm-up, two timed, all at once


def test_seeds_are_timed_on_one_thread():
    threads = []

    class Seed:
        def predict(self, initial, goal):
            threads.append(max(pool["num_threads"] for pool in threadpool_info()))
            return fly(initial, minimum_energy(initial, goal, PROBLEM), PROBLEM)

    with threadpool_limits(2):
        run_warmstarts({("seed", 0): Seed().predict}, [SCENARIOS[:1]])
    assert len(threads) > 1
    assert set(threads) == {1}
