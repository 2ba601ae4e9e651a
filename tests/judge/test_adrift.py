"""The judge of losses of thrust: truth by hand in free space, where nothing bends a path."""

import numpy as np
import pytest
from judge import Case, closest_adrift, fly, judge_plan
from judge.adrift import distance_adrift

FREE = {"mean_motion": 1e-9, "time_step": 10.0, "nodes": 5, "collision_radius": 15.0}
ORBITS = 100.0 * 1e-9 / (2 * np.pi)
"""A hundred seconds of drift."""


def approach(miss=5.0):
    """One craft flies at 2 m/s towards another, comes to rest 40 m before it, and stays there.

    It brakes over the third interval, at 0.2 m/s², from 50 m away; at the nodes it is 90, 70, 50,
    40 and 40 m away, and without thrust at one of the first three it passes at the miss distance.
    """
    initial = np.array([[-90.0, 0, 0, 2, 0, 0], [0, miss, 0, 0, 0, 0]])
    controls = np.zeros((2, 4, 3))
    controls[0, 2, 0] = -0.2
    return initial, controls, fly(Case.of(FREE), initial, controls)


def test_a_craft_that_cannot_brake_passes_where_its_path_leads():
    _, controls, states = approach()
    assert states[0, :, 0] == pytest.approx([-90, -70, -50, -40, -40], abs=1e-5)
    found = closest_adrift(Case.of(FREE), states, controls, ORBITS)
    assert found.distance == pytest.approx(5.0, abs=1e-5)
    assert (found.lost, found.other) == (0, 1)
    assert found.node in (0, 1, 2)
    assert found.time == pytest.approx(45.0, abs=1e-3)


def test_the_closest_approach_is_found_far_from_the_closest_point_of_the_grid():
    rng = np.random.default_rng(195)
    initial = rng.normal(size=(2, 6)) * np.repeat([60.0, 4.0], 3)
    controls = rng.normal(size=(2, 4, 3)) * 0.4
    states = fly(Case.of(FREE), initial, controls)
    flight = Case.of(FREE), states, controls
    every = [
        distance_adrift(*flight, pair, node, 10.0 * node + since)
        for pair in ((0, 1), (1, 0))
        for node in range(5)
        for since in np.linspace(0, 100, 201)
    ]
    found = closest_adrift(*flight, ORBITS)
    assert found.distance == pytest.approx(min(every), abs=0.05)
    assert found.distance <= min(every)


def test_a_drift_that_ends_before_is_no_danger():
    """Fifteen seconds from the third node on, it has come to within 20 m along its path."""
    _, controls, states = approach()
    found = closest_adrift(Case.of(FREE), states, controls, ORBITS * 0.15)
    assert found.distance == pytest.approx(np.hypot(20, 5), abs=1e-5)
    assert (found.node, found.time) == (2, pytest.approx(35.0, abs=1e-4))


@pytest.mark.parametrize(("miss", "wrong"), [(5.0, True), (14.99, True), (15.01, False)])
def test_a_plan_that_claims_passive_safety_is_held_to_it(miss, wrong):
    initial, controls, states = approach(miss)
    claim = {
        "orbits": ORBITS,
        "min_separation": miss,
        "min_separation_bound": miss - 1e-4,
        "pair": [0, 1],
        "node": 1,
        "time": 45.0,
    }
    scenario = {**FREE, "initial": initial, "goal": states[:, -1]}
    plan = {"states": states, "controls": controls, "certificate": {"passive_safety": claim}}
    report = judge_plan(scenario, plan)
    assert report.false_claims == ()
    assert any("adrift from node" in fault for fault in report.faults) == wrong
    for name, value in (("min_separation", 16.0), ("node", 4), ("time", 44.0)):
        false = {"passive_safety": {**claim, name: value}}
        assert judge_plan(scenario, {**plan, "certificate": false}).false_claims != ()
    silent = judge_plan(scenario, {"states": states, "controls": controls})
    assert silent.faults == ()
