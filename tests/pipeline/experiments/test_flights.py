"""Experiment 5: real planners, flown in real worlds."""

import numpy as np
import pandas as pd
import pytest
from judged import judged

from pipeline.errors import InputError
from pipeline.experiments.flights import run_flights, worlds_of
from pipeline.experiments.records import (
    LINEAR,
    LOOPS,
    MARGIN,
    NO_ERRORS,
    OPEN,
    REPLANNED,
    TYPICAL,
    WITH_ERRORS,
    WORLDS,
)
from pipeline.experiments.trials import EvaluatedPlanner
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import MU_EARTH, radius_at
from pipeline.parallel.workers import Workers
from pipeline.planners.classical import BASELINES, Expert
from pipeline.scenario import draw

PROBLEM = Problem(nodes=5, time_step=300.0)
"""Few nodes, since each takes an integration."""

SCENARIOS = [draw("rings", 3, 5, 1, PROBLEM)]
OWN = next(planner for planner in BASELINES if planner.name == "decoupled optimum")
PLANNERS = {"expert": Expert(), "decoupled optimum": OWN}
FLIGHTS = 3
ALONE = Workers(jobs=1)

SHORT = draw("rings", 0, 2, 0, Problem(nodes=4, time_step=200.0))
"""Over in three intervals."""


@pytest.fixture(scope="module")
def table():
    entrants = [EvaluatedPlanner(planner) for planner in PLANNERS.values()]
    return run_flights(entrants, SCENARIOS, flights=FLIGHTS, workers=ALONE)


def of(table, **keys):
    """Rows with some values, in order of scenario and flight."""
    for name, value in keys.items():
        table = table[table[name] == value]
    return table.sort_values(["trial", "flight"])


def test_everyone_flies_in_every_world_and_baselines_know_no_margin(table):
    counts = table.groupby(["planner", "world", "errors", "loop"]).size()
    wanted = {
        (name, world, errors, loop): len(SCENARIOS) * (1 if errors == NO_ERRORS else FLIGHTS)
        for name in PLANNERS
        for world in WORLDS
        for errors in (NO_ERRORS, WITH_ERRORS)
        for loop in LOOPS
        if loop != MARGIN or (errors == WITH_ERRORS and name != "decoupled optimum")
    }
    assert counts.to_dict() == wanted


def test_in_the_world_of_the_plan_without_errors_a_flight_is_what_the_judge_finds(table):
    """The judge's motion, separation and bound have no code in common with ours."""
    for name, planner in PLANNERS.items():
        reports = [
            judged(scenario, plan)
            for scenario, plan in zip(SCENARIOS, planner.plan(SCENARIOS), strict=True)
        ]
        rows = of(table, planner=name, world=LINEAR, errors=NO_ERRORS, loop=OPEN)
        apart = [report.min_separation for report in reports]
        np.testing.assert_allclose(rows.min_separation, apart, atol=2e-3)
        assert list(rows.within_radius) == [distance <= 15.0 for distance in apart]
        bounds = [report.fuel_lower_bound * PROBLEM.time_step for report in reports]
        np.testing.assert_allclose(rows.delta_v_bound, bounds, rtol=1e-6)
        np.testing.assert_allclose(rows.delta_v, [r.delta_v for r in reports], rtol=1e-6)
        assert rows.goal_error.max() < 1e-6
        assert rows.unsafe_replans.isna().all()


def test_the_decoupled_optimum_comes_too_close_and_replanning_for_itself_does_not_help_it(table):
    rows = of(table, planner="decoupled optimum", world=LINEAR, errors=NO_ERRORS)
    assert rows.within_radius.all()
    assert (rows.loc[rows.loop == REPLANNED, "unsafe_replans"] > 0).all()
    expert = of(table, planner="expert", world=LINEAR, errors=NO_ERRORS)
    assert not expert.within_radius.any()


def test_errors_lead_off_the_goal_and_replanning_brings_back(table):
    for world in WORLDS:
        median = {
            (errors, loop): rows.goal_error.median()
            for (errors, loop), rows in of(table, planner="expert", world=world).groupby(
                ["errors", "loop"]
            )
        }
        assert median[NO_ERRORS, OPEN] < 0.6 * median[WITH_ERRORS, OPEN]
        assert median[WITH_ERRORS, REPLANNED] < 0.3 * median[WITH_ERRORS, OPEN]
        assert median[NO_ERRORS, REPLANNED] <= max(0.3 * median[NO_ERRORS, OPEN], 1e-6)


def test_the_more_eccentric_the_reference_the_further_off_the_linear_model_is(table):
    open_loop = of(table, planner="expert", errors=NO_ERRORS, loop=OPEN)
    off = open_loop.pivot(index="trial", columns="world", values="goal_error")
    assert (off[LINEAR] < 1e-6).all()
    assert (off[TYPICAL] > 0.01).all()
    assert (off[TYPICAL] < off["e = 0.01"]).all()


def test_with_margin_more_separation_is_asked_for_where_there_is_room(table):
    rows = of(table, planner="expert", loop=MARGIN)
    assert (rows.margin > 0).all()
    assert (of(table, planner="expert", loop=REPLANNED).margin == 0).all()
    least = rows.groupby("trial").min_separation.min()
    assert (least > 15.0).all()


def test_the_same_plan_meets_the_same_errors_whoever_made_it_and_every_flight_others():
    twins = [EvaluatedPlanner(OWN, training_seed=k) for k in (0, 1)]
    twice = [SHORT, SHORT]
    table = run_flights(twins, twice, flights=2, workers=ALONE)
    first, second = (
        of(table, training_seed=k).drop(columns="training_seed").reset_index(drop=True)
        for k in (0, 1)
    )
    pd.testing.assert_frame_equal(first, second)
    rows = of(first, world=LINEAR, errors=WITH_ERRORS, loop=OPEN)
    assert rows.goal_error.nunique() == 4, "two flights of each of two scenarios"


def test_the_seed_decides_and_the_number_of_workers_does_not():
    def flown(seed, jobs):
        entrants = [EvaluatedPlanner(OWN)]
        workers = Workers(jobs=jobs)
        return run_flights(entrants, [SHORT, SHORT], flights=2, seed=seed, workers=workers)

    alone = flown(1, 1)
    pd.testing.assert_frame_equal(alone, flown(1, 2))
    assert not np.allclose(alone.goal_error, flown(2, 1).goal_error)


def test_references_begin_anywhere_on_orbits_of_the_size_of_the_problem_s():
    found = [worlds_of(SCENARIOS[0], 0, trial) for trial in range(40)]
    size = radius_at(PROBLEM.mean_motion)
    states = np.array(
        [[w[name].orbit.states(np.zeros(1))[0] for name in WORLDS[1:]] for w in found]
    )
    position, velocity = np.linalg.norm(states.reshape(40, 2, 2, 3), axis=-1).transpose(2, 0, 1)
    # vis-viva: all are as large as the circle, whatever their shape and wherever they are
    np.testing.assert_allclose(1 / (2 / position - velocity**2 / MU_EARTH), size, rtol=1e-9)
    radial = (position / size - 1) / [0.001, 0.01]
    assert (np.abs(radial) <= 1.01).all()
    assert radial.min() < -0.8 and radial.max() > 0.8, "near perigee, and near apogee"
    latitude = np.degrees(np.arcsin(states[:, 0, 2] / position[:, 0]))
    assert latitude.min() < -60 and latitude.max() > 60


@pytest.mark.parametrize(
    ("asked", "told"),
    [({"flights": 0}, "flights is 0"), ({"flights": 1, "seed": -1}, "seed is -1")],
)
def test_no_flights_and_no_seed_are_refused(asked, told):
    with pytest.raises(InputError, match=told):
        run_flights([EvaluatedPlanner(OWN)], SCENARIOS, workers=ALONE, **asked)
