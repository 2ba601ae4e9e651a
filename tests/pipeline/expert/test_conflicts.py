"""Conflicts on fine time grids: one cut for each pair in a block of intervals, the closest."""

import numpy as np
import pytest
from judge import Case, closest_adrift

from pipeline.expert import solve
from pipeline.expert.conflicts import BLOCKS, BackOff, ConflictDetection, Trajectory
from pipeline.expert.decoupled import decoupled_optima
from pipeline.orbit.approaches import close_approaches
from pipeline.orbit.covariance import Uncertainty
from pipeline.orbit.drift_search import DriftingPaths
from pipeline.orbit.partition import swarm_partition
from pipeline.orbit.passive_safety import loss_encounters
from pipeline.orbit.problem import Problem
from pipeline.orbit.separation import node_distances
from pipeline.orbit.transfer import fly
from pipeline.plan.plan import SOLVED
from pipeline.plan.requirements import AT_ALL_TIMES, Requirements
from pipeline.scenario import draw

FINE = Problem(time_step=10.0, nodes=121)
WIDTH = 3  # intervals in a block of this grid
ORBITS = 0.2


def flown(problem=FINE, n=8):
    """A dense swarm by its decoupled optima, which meet many times."""
    scenario = draw("dense", 3, n, 0, problem)
    controls = decoupled_optima(scenario.initial, scenario.goal, problem).controls
    return Trajectory(controls, fly(scenario.initial, controls, problem))


def detection(problem, requirements=AT_ALL_TIMES, back_off=None):
    return ConflictDetection(problem, requirements, swarm_partition((8,)), back_off=back_off)


def least_of_blocks(values, *keys):
    """The least value of each combination of keys, by a plain loop."""
    least = {}
    for value, *key in zip(values.tolist(), *(key.tolist() for key in keys), strict=True):
        least[tuple(key)] = min(value, least.get(tuple(key), np.inf))
    return least


def test_of_a_pair_s_approaches_in_a_block_the_closest_is_cut():
    motion, within = flown(), 30.0
    cuts, bound = detection(FINE).conflicts(motion, within)
    every = close_approaches(motion.states, motion.controls, FINE, within)
    wanted = least_of_blocks(every.bound, every.first, every.second, every.interval // WIDTH)
    found = least_of_blocks(bound, cuts.first, cuts.second, cuts.interval // WIDTH)
    assert found == wanted
    assert len(cuts) == len(wanted) < len(every) / 2


def test_after_a_loss_of_thrust_a_block_is_of_times_of_the_loss_too():
    motion, within = flown(), 20.0
    asked = Requirements(passive_safety=ORBITS)
    cuts, bound = detection(FINE, asked).conflicts(motion, within)
    _, flying = detection(FINE).conflicts(motion, within)
    plan, some = (motion.states, motion.controls, FINE), np.ones(8, dtype=bool)
    every = loss_encounters(DriftingPaths(*plan, ORBITS, swarm_partition((8,))), within, some)
    blocks = every.interval // WIDTH, every.node // WIDTH
    wanted = least_of_blocks(every.bound, every.first, every.second, *blocks)
    assert np.sort(bound[len(flying) :]).tolist() == sorted(wanted.values())
    assert len(cuts) == len(flying) + len(wanted)
    assert len(wanted) < len(every) / 4


def test_at_nodes_only_it_is_the_closest_node():
    motion, within = flown(), 30.0
    cuts, bound = detection(FINE, Requirements("nodes")).conflicts(motion, within)
    distances = node_distances(motion.states)[:, :-1]
    pair, node = np.nonzero(distances <= within)
    wanted = least_of_blocks(distances[pair, node], pair, node // WIDTH)
    assert np.sort(bound) == pytest.approx(sorted(wanted.values()))
    assert len(cuts) == len(wanted) < len(pair) / 2


def test_with_errors_it_is_the_one_that_lacks_most_of_its_back_off(monkeypatch):
    motion, within = flown(), 15.0
    errors = BackOff(Uncertainty(position=0.5, velocity=5e-4, magnitude=0.02), 3.0)
    cuts, bound = detection(FINE, back_off=errors).conflicts(motion, within)
    monkeypatch.setattr("pipeline.expert.conflicts.BLOCKS", FINE.intervals)
    every, bounds = detection(FINE, back_off=errors).conflicts(motion, within)
    wanted = least_of_blocks(bounds, every.first, every.second, every.interval // WIDTH)
    assert least_of_blocks(bound, cuts.first, cuts.second, cuts.interval // WIDTH) == wanted
    assert len(cuts) == len(wanted) < len(every) / 2


def test_two_craft_back_off_by_root_two_of_the_deviation_of_one():
    """In straight lines, 20 m apart at the middle, each of them known to three metres."""
    problem = Problem(mean_motion=1e-12, time_step=100.0, nodes=4)
    start = np.array([[0, 0, 0, 0, 0, 0], [-150.0, 20, 0, 1.0, 0, 0]])
    motion = Trajectory(np.zeros((2, 3, 3)), fly(start, np.zeros((2, 3, 3)), problem))
    errors, left = BackOff(Uncertainty(position=3.0), 3.0), 20 - 3 * 2**0.5 * 3
    of = ConflictDetection(problem, AT_ALL_TIMES, swarm_partition((2,)), back_off=errors)
    cuts, bound = of.conflicts(motion, left + 0.01)
    assert cuts.interval.tolist() == [1]
    assert bound == pytest.approx([left], abs=2e-3)
    assert len(of.conflicts(motion, left - 0.01)[0]) == 0


def test_on_a_grid_of_no_more_intervals_than_blocks_every_approach_is_cut():
    problem = Problem(time_step=30.0, nodes=BLOCKS + 1)
    motion = flown(problem)
    cuts, _ = detection(problem).conflicts(motion, 30.0)
    every = close_approaches(motion.states, motion.controls, problem, 30.0)
    assert (cuts.interval == every.interval).all()


@pytest.mark.parametrize("family", ["rings", "tilt-split"])
def test_a_passively_safe_plan_on_a_fine_grid_is_safe_and_costs_what_it_does_with_all_cuts(
    family, monkeypatch
):
    problem = Problem(time_step=24.0, nodes=51)
    scenario, asked = draw(family, 7, 4, 0, problem), Requirements(passive_safety=0.5)
    plan = solve(scenario, requirements=asked)
    assert plan.status == SOLVED
    case = Case(problem.mean_motion, problem.time_step, problem.nodes, problem.collision_radius)
    found = closest_adrift(case, plan.states, plan.controls, 0.5)
    assert found.distance > problem.collision_radius
    monkeypatch.setattr("pipeline.expert.conflicts.BLOCKS", problem.intervals)
    every = solve(scenario, requirements=asked)
    assert plan.certificate.fuel == pytest.approx(every.certificate.fuel, rel=5e-3)
