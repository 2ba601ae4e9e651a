"""The one judgement of a plan names every requirement that it does not satisfy."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.orbit.participants import Obstacle
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import fly
from pipeline.plan.certificate import certify
from pipeline.plan.judge import is_computable, violations, with_status
from pipeline.plan.plan import SOLVED, UNSAFE, UNSOLVED, Plan
from pipeline.plan.requirements import Requirements, RiskLimit
from pipeline.scenario import Scenario
from pipeline.scenario.spacecraft import Spacecraft

PROBLEM = Problem(mean_motion=1e-12, time_step=10.0, nodes=4, max_acceleration=1e-3)
"""As good as free space: a craft at rest, and one that passes it 3 m off, between two nodes."""

INITIAL = np.array([[0.0] * 6, [-150.0, 3.0, 0.0, 10.0, 0.0, 0.0]])


def found(push=0.0, miss=0.0, asked=None, radius=15.0):
    problem = replace(PROBLEM, collision_radius=radius)
    controls = np.zeros((2, 3, 3))
    controls[0, 0, 2] = push
    states = fly(INITIAL, controls, problem)
    scenario = Scenario(problem, INITIAL, states[:, -1] + miss)
    asked = asked or Requirements()
    (certificate,) = certify([scenario], states, controls, [(0.0, "")], asked)
    plan = Plan(scenario, "", "", states, controls, certificate, separation=asked.separation)
    return set(violations(plan)), with_status(plan).status


@pytest.mark.parametrize(
    ("given", "named", "status"),
    [
        ({"radius": 2.0}, set(), SOLVED),
        ({}, {"separation"}, UNSAFE),
        ({"asked": Requirements("nodes")}, set(), SOLVED),
        ({"radius": 2.0, "push": 1.1e-3}, {"thrust"}, UNSAFE),
        ({"push": 1.1e-3}, {"thrust", "separation"}, UNSAFE),
        ({"miss": 1e-3}, {"goal", "separation"}, UNSOLVED),
        ({"radius": 2.0, "asked": Requirements(risk=RiskLimit(0.01, 10.0))}, {"risk"}, UNSAFE),
        ({"asked": Requirements(passive_safety=1e-11)}, {"separation", "passive safety"}, UNSAFE),
    ],
)
def test_each_requirement_is_judged_by_itself(given, named, status):
    assert found(**given) == (named, status)


def test_craft_and_obstacles_that_come_too_close_are_named_with_how_much_and_when():
    for who, initial, obstacles in (
        ("craft 1", INITIAL, ()),
        ("debris", INITIAL[1:], (Obstacle("debris", tuple(INITIAL[0]), radius=2.0),)),
    ):
        controls = np.zeros((len(initial), 3, 3))
        states = fly(initial, controls, PROBLEM)
        craft = [Spacecraft(radius=2.0)] * len(initial)
        scenario = Scenario(PROBLEM, initial, states[:, -1], craft=craft, obstacles=obstacles)
        (certificate,) = certify([scenario], states, controls, [(0.0, "")], Requirements())
        wrong = violations(Plan(scenario, "", "", states, controls, certificate))
        # 3 m apart in passing, where they would have to be 4 m
        assert wrong == {"separation": f"craft 0 comes 1 m too close to {who} at 15 s"}


def test_of_nodes_that_count_alone_it_is_said_how_often_a_pair_is_too_close_there():
    """Two craft are 50 m apart at two nodes, and 3 m apart between them."""
    controls = np.zeros((2, 3, 3))
    states, asked = fly(INITIAL, controls, PROBLEM), Requirements("nodes")
    scenario = Scenario(replace(PROBLEM, collision_radius=51.0), INITIAL, states[:, -1])
    (certificate,) = certify([scenario], states, controls, [(0.0, "")], asked)
    plan = Plan(scenario, "", "", states, controls, certificate, separation="nodes")
    assert violations(plan)["separation"] == (
        "pairs too close at nodes: 2; at any time, craft 0 and 1 come within 3 m of each other at "
        "15 s; collision_radius is 51 m"
    )


def test_craft_are_lost_beyond_a_billion_kilometres_at_a_node_or_by_their_controls_between():
    states, controls = np.zeros((3, 4, 6)), np.zeros((3, 3, 3))
    states[1, 2, 0] = 1.1e12
    controls[2, 1, 1] = 1.1e12 / PROBLEM.time_step**2
    assert is_computable(states, controls, PROBLEM).tolist() == [True, False, False]
