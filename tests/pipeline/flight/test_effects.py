"""Which share of an error comes from what: sums, sizes, and drag in closed form."""

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from pipeline.errors import InputError
from pipeline.expert import solve
from pipeline.flight.effects import effects, fly_controls
from pipeline.flight.world import Conditions, in_world, world_of
from pipeline.orbit.dynamics import cw_matrices
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import Reference, radius_at
from pipeline.orbit.rings import pro_states
from pipeline.scenario import Scenario, draw
from pipeline.scenario.document import read_scenario, write_scenario

SCENARIO = draw("rings", 0, 5, 0, Problem())
CONTROLS = solve(SCENARIO).controls

ALL = Conditions(eccentricity=0.004, inclination_deg=60.0, ballistic=0.02)


def test_effects_sum_to_the_error_of_a_flight_with_all_of_them():
    found = effects(SCENARIO, CONTROLS, ALL)
    assert [one.name for one in found] == ["plan", "curvature", "eccentricity", "J2", "drag"]
    world = world_of(SCENARIO, ALL)
    states, _, met = fly_controls(world, SCENARIO, CONTROLS)
    missed = states[:, -1] - SCENARIO.goal
    np.testing.assert_allclose(sum(one.added for one in found), missed, atol=1e-9)
    assert sum(one.share for one in found) == pytest.approx(1.0, abs=1e-9)
    assert np.abs(found[0].errors).max() < 1e-6, "the plan itself ends at its goal"
    assert found[-1].nearest.distance == met.craft.distance[0]


def test_an_effect_that_is_not_there_is_no_row():
    bare = Conditions(eccentricity=0.0, j2=False)
    assert [one.name for one in effects(SCENARIO, CONTROLS, bare)] == ["plan", "curvature"]


def test_what_eccentricity_adds_is_proportional_to_it():
    added = [
        effects(SCENARIO, CONTROLS, replace(ALL, eccentricity=e))[2].added for e in (2e-4, 1e-4)
    ]
    np.testing.assert_allclose(added[0], 2 * added[1], rtol=1e-2, atol=1e-6)


def test_drag_that_differs_moves_craft_as_a_constant_push_does_in_closed_form():
    """Idle craft on a small ring; the one in the middle falls with the reference."""
    problem = Problem()
    e, size, time = problem.mean_motion, radius_at(problem.mean_motion), problem.duration
    ring = pro_states(20.0, 0.0, np.arange(3) * 2.0, 0.0, e)
    idle = np.zeros((3, problem.intervals, 3))
    dragged = replace(ALL, eccentricity=0.0, inclination_deg=90.0, j2=False, spread=0.5)
    *_, found = effects(Scenario(problem, ring, ring), idle, dragged)
    push = 0.5 * 6.967e-13 * 0.5 * 0.02 * (e * size) ** 2
    _, B = cw_matrices(e, time)
    expected = (B @ [0.0, push, 0.0])[:2]
    assert np.abs(expected).max() > 0.05
    np.testing.assert_allclose(found.added[0, :2], expected, rtol=0.01)
    np.testing.assert_allclose(found.added[2, :2], -expected, rtol=0.01)
    assert np.abs(found.added[1]).max() < 0.01 * np.abs(expected).max()
    # Under a polar orbit the air moves sideways, by 1/15 of the orbit's speed at most.
    assert np.abs(found.added[:, 2]).max() < 1 / 15 * push * time**2 / 2


def test_a_reference_orbit_of_the_scenario_is_taken():
    reference = Reference(datetime(2026, 3, 1, tzinfo=UTC), 51.6, -40.0, 370.0)
    there = Conditions(eccentricity=0.002).about(reference)
    assert there == Conditions(0.002, 51.6, 320.0, 90.0, 10.0)
    mean = there.orbit(Problem()).mean_elements
    assert np.degrees(mean.inclination) == pytest.approx(51.6, abs=1e-9)
    assert mean.semi_major_axis == pytest.approx(radius_at(Problem().mean_motion), rel=1e-12)
    bare = replace(there, j2=False).orbit(Problem())
    assert bare.semi_major_axis == radius_at(Problem().mean_motion)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"eccentricity": 0.86}, "eccentricity is 0.86; expected a number from 0 to 0.85."),
        ({"eccentricity": float("nan")}, "eccentricity is nan"),
        ({"inclination_deg": 181.0}, "inclination_deg is 181; expected a number from 0 to 180."),
        ({"argument_of_perigee_deg": float("inf")}, "argument_of_perigee_deg is inf"),
        ({"ballistic": 0.0}, "ballistic is 0; expected a positive"),
        ({"spread": 1.5}, "spread is 1.5"),
    ],
)
def test_conditions_that_no_orbit_has_are_refused(wrong, words):
    with pytest.raises(InputError) as refused:
        Conditions(**wrong)
    assert words in str(refused.value)


def test_controls_that_lead_far_away_are_refused():
    for push in (1.0, 1e300, np.nan):
        controls = CONTROLS.copy()
        controls[3, 0, 1] = push
        with pytest.raises(InputError, match="the controls lead craft 3 "):
            effects(SCENARIO, controls, ALL)


def test_a_scenario_with_a_reference_is_read_again_once_it_is_about_the_orbit_of_conditions(
    tmp_path,
):
    where = Reference(datetime(2026, 3, 1, tzinfo=UTC), 51.6, 40.0, 70.0)
    scenario = replace(draw("rings", 0, 2, 0, Problem()), reference=where)
    world = in_world(scenario, Conditions(eccentricity=0.005).about(where))
    write_scenario(tmp_path / "s.json", world)
    read = read_scenario(tmp_path / "s.json")
    assert read.problem == world.problem
    assert read.reference.epoch == where.epoch
    assert read.reference.inclination_deg == pytest.approx(51.6, abs=0.02)  # osculating
    assert read.reference.raan_deg == read.problem.orbit.raan_deg
