"""Experiment 4: the same ends at other transfer times."""

from dataclasses import replace

import numpy as np
import pytest
from judge import Case, exact_step, least_fuel
from judged import check_rows, judged

from pipeline.errors import InputError
from pipeline.experiments.records import NODES, TIME_STEP
from pipeline.experiments.trials import EvaluatedPlanner, run_transfer_times, variations
from pipeline.orbit.problem import Problem
from pipeline.parallel.workers import Workers
from pipeline.planners.classical import BASELINES, Expert
from pipeline.scenario import draw

PROBLEM = Problem()
SCENARIOS = [draw("rings", 6, 4, k, PROBLEM) for k in range(3)]
ENTRANTS = [EvaluatedPlanner(Expert()), *(EvaluatedPlanner(baseline) for baseline in BASELINES)]
GRIDS = (6, 11, 21)


def only_at_11_nodes(problem):
    """All entrants, of which the straight line fits one T alone, as feed-forward networks do."""
    return [e for e in ENTRANTS if e.planner.name != "straight line" or problem.nodes == 11]


@pytest.fixture(scope="module")
def table():
    varied = variations(PROBLEM, GRIDS)
    return run_transfer_times(only_at_11_nodes, SCENARIOS, varied, workers=Workers(jobs=1))


def test_either_way_has_the_same_transfer_times_unless_steps_are_given():
    found = variations(PROBLEM, GRIDS)
    assert [(varied, one.nodes, one.time_step) for varied, one in found] == [
        (NODES, 6, 120.0),
        (NODES, 11, 120.0),
        (NODES, 21, 120.0),
        (TIME_STEP, 11, 60.0),
        (TIME_STEP, 11, 120.0),
        (TIME_STEP, 11, 240.0),
    ]
    assert [one.duration for _, one in found] == [600.0, 1200.0, 2400.0] * 2
    given = variations(PROBLEM, (5,), (30.0,))
    assert [(one.nodes, one.time_step) for _, one in given] == [(5, 120.0), (11, 30.0)]


@pytest.mark.parametrize(
    ("nodes", "step", "told"), [(2, 60.0, "nodes is 2"), (6, -1.0, "time_step is -1;")]
)
def test_times_that_no_transfer_has_are_refused(nodes, step, told):
    with pytest.raises(InputError, match=told):
        variations(PROBLEM, (nodes,), (step,))


def test_who_fits_has_a_row_for_every_trial_of_every_transfer_time(table):
    counts = table.groupby(["planner", "varied", "nodes", "time_step"]).trial.nunique()
    assert set(counts) == {len(SCENARIOS)}
    assert counts.groupby("planner").size().to_dict() == {
        "expert": 6,
        "straight line": 4,
        "minimum energy": 6,
        "decoupled optimum": 6,
    }


def rows_of(table, planner):
    """Every transfer time that a planner has rows of, with those rows in order of trial."""
    found = table[table.planner == planner]
    for (_, nodes, step), rows in found.groupby(["varied", "nodes", "time_step"]):
        yield Problem(nodes=nodes, time_step=step), rows.sort_values("trial")


def least_squares(problem, scenario):
    """Controls of least energy, as the least-norm solution of where constant pushes lead."""
    free, forced = exact_step(problem.mean_motion, problem.time_step)
    power = np.linalg.matrix_power
    reach = np.hstack([power(free, k) @ forced for k in range(problem.nodes - 1)][::-1])
    miss = scenario.goal - scenario.initial @ power(free, problem.nodes - 1).T
    scale = np.repeat([1.0, 1e3], 3)
    return np.linalg.lstsq(scale[:, None] * reach, (scale * miss).T, rcond=None)[0]


def test_every_row_has_the_bound_that_highs_finds_between_the_same_ends_in_its_own_time(table):
    """Where T and Δt are those of the training, and where either differs from them."""
    for planner in table.planner.unique():
        for problem, rows in rows_of(table, planner):
            known = Case(problem.mean_motion, problem.time_step, problem.nodes, 15.0)
            bounds = [least_fuel(known, s.initial, s.goal).proven.sum() for s in SCENARIOS]
            np.testing.assert_allclose(rows.fuel_lower_bound, bounds, rtol=1e-6)
            if planner == "decoupled optimum":
                np.testing.assert_allclose(rows.fuel, bounds, rtol=1e-6)


def test_minimum_energy_burns_what_least_squares_says_at_every_transfer_time(table):
    for problem, rows in rows_of(table, "minimum energy"):
        burnt = [np.abs(least_squares(problem, s)).sum() for s in SCENARIOS]
        np.testing.assert_allclose(rows.fuel, burnt, rtol=1e-6)


def test_every_transfer_meets_the_same_ends_within_its_own_time(table):
    """The judge flies what each planner plans for the ends, and finds what the rows say."""
    assert (table.boundary_error < 1e-6).all()
    for entrant in ENTRANTS:
        for problem, rows in rows_of(table, entrant.planner.name):
            moved = [replace(s, problem=problem) for s in SCENARIOS]
            plans = entrant.planner.plan(moved)
            reports = [judged(s, plan) for s, plan in zip(moved, plans, strict=True)]
            assert not any("misses" in fault for r in reports for fault in r.faults)
            check_rows(rows, reports)


def test_a_finer_grid_of_the_same_duration_needs_no_more_velocity(table):
    """Controls held for 240 s can be held for twice 120 s as well, so the bound can only fall."""
    coarse = table[(table.varied == TIME_STEP) & (table.time_step == 240.0)]
    fine = table[(table.varied == NODES) & (table.nodes == 21)]
    bound = {
        name: rows[rows.planner == "decoupled optimum"].fuel_lower_bound.to_numpy() * step
        for name, rows, step in (("coarse", coarse, 240.0), ("fine", fine, 120.0))
    }
    assert (bound["fine"] <= bound["coarse"] * (1 + 1e-9)).all()
