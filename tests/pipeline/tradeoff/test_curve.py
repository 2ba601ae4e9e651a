"""Transfers of other durations: what varies, what the goal is, and that plans are sound."""

from dataclasses import asdict, replace

import numpy as np
import pytest
from judge import exact_step, judge_plan
from judged import document

from pipeline.errors import InputError
from pipeline.orbit.corridors import Box, Corridor
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.orbit.rings import energy_mismatch
from pipeline.orbit.thrust import Thrust
from pipeline.planners.classical import Expert
from pipeline.planners.goal_assignment import GoalAssignment
from pipeline.scenario import draw
from pipeline.scenario.validation import drifts
from pipeline.scenario.waypoint import Waypoint
from pipeline.tradeoff import arcs_between, tradeoff, tradeoff_figure, with_arcs

SCENARIO = draw("rings", 5, 6, 0, Problem(), "valid")


def test_durations_are_whole_arcs_within_the_range_and_as_many_as_asked_for():
    assert arcs_between(600.0, 3600.0, 120.0, 6) == [5, 10, 15, 20, 25, 30]
    assert arcs_between(600.0, 3600.0, 120.0, 100) == [*range(5, 31)]
    assert arcs_between(601.0, 3599.0, 120.0, 100) == [*range(6, 30)]
    assert arcs_between(0.3, 0.9, 0.1, 100) == [*range(3, 10)], "rounding loses no end"
    assert len(arcs_between(600.0, 3600.0, 120.0, 20)) == 20


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ((100.0, 900.0, 120.0, 5), "at least 240 s"),
        ((250.0, 300.0, 120.0, 5), "multiple of time_step"),
        ((600.0, 900.0, 120.0, 0), "steps is 0"),
        ((600.0, 1e308, 0.1, 5), "finite numbers"),
    ],
)
def test_a_range_that_no_transfer_has_is_refused(asked, words):
    with pytest.raises(InputError, match=words):
        arcs_between(*asked)


PLACE = Waypoint(0, (50.0, 0.0, 0.0), None, 600.0)
ROOM = Corridor(Box((-900.0,) * 3, (900.0,) * 3), 0.0, 720.0)


@pytest.mark.parametrize("own", [{"waypoints": (PLACE,)}, {"corridors": (ROOM,)}])
def test_durations_too_short_for_waypoints_and_corridors_are_refused(own):
    scenario = replace(draw("rings", 0, 2, 0, Problem(time_step=120.0)), **own)
    with pytest.raises(InputError, match=r"transfer of 600 s is asked for.*take 720 s"):
        with_arcs(scenario, 5)
    assert with_arcs(scenario, 6).problem.duration == 720.0


@pytest.mark.parametrize("arcs", [5, 10, 23])
def test_a_moving_goal_is_where_free_drift_takes_it(arcs):
    """By matrix exponentials, backwards too; it stays on passive orbits."""
    moved = with_arcs(SCENARIO, arcs, "moving")
    free, _ = exact_step(SCENARIO.problem.mean_motion, (arcs - 10) * 120.0)
    assert np.allclose(moved.goal, SCENARIO.goal @ free.T, rtol=1e-9, atol=1e-9)
    assert np.abs(energy_mismatch(moved.goal, moved.problem.mean_motion)).max() < 1e-9
    assert (moved.problem.duration, moved.problem.time_step) == (arcs * 120.0, 120.0)
    assert np.array_equal(with_arcs(SCENARIO, arcs).goal, SCENARIO.goal)
    assert np.array_equal(moved.initial, SCENARIO.initial)


def test_about_an_orbit_goals_that_drift_at_another_time_are_refused_unless_they_may():
    """States that do not drift depend there on the position of the formation on its orbit."""
    about = Problem().about(ReferenceOrbit(7e6, 0.05, 50.0))
    scenario = draw("rings", 5, 4, 0, about, "valid")
    assert not drifts(with_arcs(scenario, 10))
    for arcs in (5, 15):
        assert not drifts(with_arcs(scenario, arcs, "moving"))
        with pytest.raises(InputError, match="about this orbit craft at the goals drift then"):
            with_arcs(scenario, arcs)
        assert drifts(with_arcs(scenario, arcs, allow_drift=True))
        assert drifts(with_arcs(replace(scenario, ends="any"), arcs))


@pytest.mark.parametrize("planner", [Expert(), GoalAssignment(Expert())], ids=["given", "optimal"])
@pytest.mark.parametrize("goal", ["fixed", "moving"])
def test_every_plan_is_sound_for_its_own_duration(planner, goal):
    for point in tradeoff(SCENARIO, [4, 10, 21], planner, goal):
        assert point.safe
        plan = {"states": point.plan.states, "controls": point.plan.controls}
        claims = {
            "certificate": asdict(point.plan.certificate),
            "assignment": point.plan.assignment,
        }
        report = judge_plan(document(point.plan.scenario), plan | claims)
        assert report.wrong == ()
        assert point.delta_v == pytest.approx(report.delta_v, rel=1e-9)
        assert point.delta_v_lower_bound <= point.delta_v * (1 + 1e-9)


def test_more_arcs_of_one_length_never_need_more_for_a_goal_that_waits():
    """A craft may idle at the end where its goal moves on as it does itself."""
    points = tradeoff(SCENARIO, range(3, 20), Expert(), "moving")
    bounds = [point.delta_v_lower_bound for point in points]
    assert all(np.diff(bounds) <= 1e-9 * bounds[0])


@pytest.mark.parametrize(
    ("model", "words"),
    [
        ("components", "Δv, Σ‖u‖₁ · Δt (m/s)"),
        ("norm", "Δv, Σ‖u‖₂ · Δt (m/s)"),
        (
            (
                (1.0, 0.0, 0.0),
                (-0.8, 0.6, 0.0),
                (-0.8, -0.6, 0.0),
                (0.0, 0.0, 1.0),
                (0.0, 0.0, -1.0),
            ),
            "Δv, sum of all thrusts · Δt (m/s)",
        ),
    ],
)
def test_a_figure_names_the_sum_that_it_shows_and_no_limit_that_is_none(model, words):
    problem = Problem(thrust=Thrust(model))
    box = Box((-50.0, -50.0, -50.0), (50.0, 50.0, 50.0))
    scenario = draw("rings", 5, 2, 0, problem, "valid")
    points = tradeoff(scenario, [10, 12], Expert())
    ax = tradeoff_figure(points, None, "fine").axes[0]
    assert ax.get_ylabel() == words
    scenario = replace(scenario, corridors=[Corridor(box, 0.0, 120.0)])
    points = tradeoff(scenario, [10, 12], Expert())
    assert [point.plan.status for point in points] == ["infeasible"] * 2
    legend = tradeoff_figure(points, None, "outside a corridor").axes[0].get_legend()
    assert "proven infeasible" in [text.get_text() for text in legend.get_texts()]
