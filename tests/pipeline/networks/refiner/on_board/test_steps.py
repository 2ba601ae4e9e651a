"""One craft's steps, run by torch, against the swarm as a whole."""

from dataclasses import replace
from math import prod

import numpy as np
import pytest
import torch
from tableaux import one_of

from pipeline.networks.architecture import find
from pipeline.networks.encoding import Encoding
from pipeline.networks.refiner import tensors
from pipeline.networks.refiner.geometry import EncounterGeometry, Encounters, Sides, grid_of
from pipeline.networks.refiner.on_board import ROUND, STEPS, told_each_round
from pipeline.networks.refiner.on_board_export import (
    Discrepancy,
    compare,
    fly_rounds,
    swarm_controls,
)
from pipeline.networks.refiner.programs import LARGEST_DUAL, decoupled_optima
from pipeline.networks.refiner.tensors import is_minimum, nearest
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import transfer_maps
from pipeline.scenario import draw

# What is run here is a graph, one small call after the other.
pytestmark = pytest.mark.untyped

PROBLEM = Problem()
OTHERS = [replace(PROBLEM, nodes=6, time_step=200.0), replace(PROBLEM, nodes=21)]
REFINER = find("refiner")
ROUNDS = 7  # more than those in which only local minima get planes; all after them are alike


def network(spread):
    """A network whose answers depend on what it reads, the more the greater the spread."""
    torch.manual_seed(0)
    encoding = Encoding(PROBLEM, 10, "line", "offset", (1.0,) * 6, (1.0,) * 6)
    made = REFINER.network({**REFINER.config, "rounds": ROUNDS}, encoding, 0.0)
    torch.nn.init.normal_(made.offer.weight, std=spread)
    return made.eval().requires_grad_(False)


def drawn(family, n, k, problem=PROBLEM):
    scenario = draw(family, 0, n, k, problem, "valid")
    return scenario.initial, scenario.goal


def by_craft(made, initial, goal):
    """Controls of every round, each craft by itself."""
    steps = {name: step(made, PROBLEM) for name, step in STEPS.items()}

    def run(name, known):
        given = [torch.as_tensor(known[one]) for one in STEPS[name].takes]
        found = steps[name](*given)
        return dict(zip(STEPS[name].gives, (one.numpy() for one in found), strict=True))

    flown = fly_rounds(run, initial, goal, PROBLEM.collision_radius, rounds=made.rounds)
    return np.stack(list(flown))


@pytest.mark.parametrize(("family", "n"), [("rings", 1), ("rings", 2), ("dense", 10)])
def test_by_the_rule_alone_craft_by_themselves_fly_as_the_swarm_does(family, n):
    for k in range(2):
        ends = drawn(family, n, k)
        wanted = swarm_controls(network(0.0), PROBLEM, *ends)
        difference = np.abs(by_craft(network(0.0), *ends) - wanted).max()
        assert difference <= 1e-6 * np.abs(wanted).max()


def test_what_is_learned_is_bargained_craft_by_craft_as_in_the_swarm():
    made = network(0.05)
    found = []
    for family, n, k in [("rings", 10, 2), ("rings", 10, 4), ("dense", 5, 2), ("dense", 5, 3)]:
        ends = drawn(family, n, k)
        wanted = swarm_controls(made, PROBLEM, *ends)
        assert (
            np.abs(wanted - swarm_controls(network(0.0), PROBLEM, *ends)).max()
            > 1e-3 * np.abs(wanted).max()
        )
        found.append(compare(by_craft(made, *ends), wanted))
    assert max(one.difference for one in found) <= 1e-5
    assert sum(one.tie for one in found) <= 1  # else little would have been compared


def test_another_optimum_of_the_same_fuel_is_no_difference_but_more_fuel_is():
    wanted = np.ones((3, 2, 4))
    other = wanted.copy()
    other[1, 0, :2], other[2] = (0.5, 1.5), 7.0
    assert compare(other, wanted) == Discrepancy(0.0, tie=True)
    other[1, 0, 0] = 0.75
    assert compare(other, wanted) == Discrepancy(0.5, tie=False)


def test_craft_by_themselves_know_no_numbers_of_craft():
    made, (initial, goal) = network(0.05), drawn("dense", 5, 2)
    order = np.random.default_rng(0).permutation(5)
    found = compare(
        by_craft(made, initial[order], goal[order]), by_craft(made, initial, goal)[:, order]
    )
    assert found.difference <= 1e-5


def own_of(problem, initial, goal):
    """Decoupled optima by the table, and the ends in r_col and Δt that they are of."""
    scale = np.repeat([1.0, problem.time_step], 3) / problem.collision_radius
    ends = initial * scale, goal * scale
    return decoupled_optima(*ends, grid_of(problem), problem), ends


def as_tensors(own):
    """The decoupled optima as tensors."""
    return tensors.TensorDecoupled(*map(torch.from_numpy, vars(own).values()))


def test_one_craft_s_program_is_that_of_many():
    """With planes that are met, that are asked too much of, and that are not there."""
    for problem in (PROBLEM, *OTHERS):
        own, _ = own_of(problem, *drawn("dense", 10, 0, problem))
        grid, rng = grid_of(problem), np.random.default_rng(0)
        node = rng.integers(2, problem.nodes - 1, size=(10, 5))
        position = grid.reach.reshape(problem.nodes, 6, -1)[node, :3]
        row = np.einsum("cpx,cpxm->cpm", rng.normal(size=(10, 5, 3)), position)
        row[:, 1] = -row[:, 0]
        asked = (row @ own.controls[:, :, None])[:, :, 0] + rng.uniform(-0.5, 1.5, size=(10, 5))
        real = rng.random((10, 5)) < 0.8
        largest = 0.0
        for k in range(10):
            one, some = one_of(own, k), real[k]
            order = 2 * np.arange(some.sum())
            first = Sides(np.array([0]), np.array([0, some.sum()]), order, np.zeros_like(order))
            wanted = one.optima(first, row[k, some], np.tile(asked[k, some, None], 2))
            given = (torch.from_numpy(values[None, k]) for values in (row, asked, real))
            controls, (dual,) = as_tensors(one).solved(*given)
            assert controls.numpy() == pytest.approx(wanted[0], abs=1e-8)
            assert dual.numpy()[some] == pytest.approx(wanted[1][:, 0], abs=1e-7)
            assert (dual.numpy()[~some] == 0).all()
            largest = max(largest, float(dual.amax()))
        assert largest == pytest.approx(LARGEST_DUAL)


def test_the_closest_approach_that_a_craft_finds_is_the_swarm_s():
    states = np.random.default_rng(0).normal(size=(40, 6, 6))
    states[20:, 1:] = states[20:, :1] + 1e-3 * states[20:, 1:]  # almost still
    first = np.arange(0, 40, 2).repeat(5)
    met = Encounters(first, first + 1, np.tile(np.arange(5), 20))
    ends = torch.from_numpy(met.relative(states))
    far, moved = np.full(len(met), np.inf), np.ones(len(states), dtype=bool)
    found = met.approaches(states, far, EncounterGeometry(far, far, far > 0), moved)
    share = nearest(ends)
    assert share.numpy() == pytest.approx(found.share, abs=1e-6)
    assert np.array_equal(is_minimum(ends, share).numpy(), found.is_minimum)
    assert (~found.is_minimum).sum() > 5


def test_the_decoupled_optimum_that_a_craft_looks_up_is_the_swarm_s():
    for problem in (PROBLEM, *OTHERS):
        grid = grid_of(problem, torch.device("cpu"))
        initial, goal = drawn("rings", 20, 0, problem)
        goal[0] = initial[0] @ transfer_maps(problem).drift[-1].T  # about to stay where it drifts
        goal[1, [2, 5]] = initial[1, [2, 5]] = 0.0  # nothing across the plane
        every, scaled = own_of(problem, initial, goal)
        for k in range(20):
            ends = (torch.from_numpy(end[[k]]) for end in scaled)
            own, same = tensors.decoupled_optima(*ends, grid, problem), one_of(every, k)
            assert own.controls.numpy() == pytest.approx(same.controls, abs=1e-8)
            if k == 0:
                continue  # any basis will do
            for name in ("basis", "others", "side"):
                assert np.array_equal(getattr(own, name).numpy(), getattr(same, name))
            assert own.tableau.numpy() == pytest.approx(same.tableau, abs=1e-7)
            assert own.cost.numpy() == pytest.approx(same.cost, abs=1e-7)


def test_a_craft_tells_50_numbers_for_each_live_encounter_in_a_round():
    """As many as a swarm really exchanges, where a name is told by every step that says so."""
    told = told_each_round(REFINER.config["message"])
    looks, network_tells = {"first_price": 1, "standing": 3}, {"heard": 32, "offer": 1}
    assert told == {**looks, **network_tells, "nodes": 12, "price": 1}
    assert sum(told.values()) == 18 + 2 * REFINER.config["message"] == 50
    seen = {}
    made, (initial, goal) = network(0.05), drawn("dense", 4, 0)

    def run(name, known):
        step = STEPS[name](made, PROBLEM)
        found = step(*(torch.as_tensor(known[one]) for one in STEPS[name].takes))
        given = dict(zip(step.gives, (one.numpy() for one in found), strict=True))
        if name in ROUND:
            seen.update({one: prod(given[one].shape[1:]) for one in step.tells})
        return given

    list(fly_rounds(run, initial, goal, 15.0, rounds=1))
    assert seen == told
