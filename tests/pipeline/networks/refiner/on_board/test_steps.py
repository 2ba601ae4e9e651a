"""One craft's steps, run by torch, against the swarm as a whole."""

from dataclasses import replace
from math import prod

import numpy as np
import pytest
import torch
from tableaux import one_of

from pipeline.networks.architecture import find
from pipeline.networks.encoding import Encoding
from pipeline.networks.refiner.encounters import Encounters, look
from pipeline.networks.refiner.grid import grid_of
from pipeline.networks.refiner.on_board.check import Compared, compare, together
from pipeline.networks.refiner.on_board.nearest import nearest
from pipeline.networks.refiner.on_board.own_optimum import own_optimum
from pipeline.networks.refiner.on_board.pivots import solve_one
from pipeline.networks.refiner.on_board.planes import cubic, turns
from pipeline.networks.refiner.on_board.planes import planes as on_board_planes
from pipeline.networks.refiner.on_board.steps import ROUND, STEPS, takes, told_each_round
from pipeline.networks.refiner.on_board.swarm import fly_rounds
from pipeline.networks.refiner.planes import planes
from pipeline.networks.refiner.program import DEAREST, solve
from pipeline.networks.refiner.rounds import begin
from pipeline.networks.refiner.sides import Sides
from pipeline.networks.swarms import swarms
from pipeline.orbit.problem import Problem
from pipeline.scenario import draw

PROBLEM = Problem()
OTHERS = [replace(PROBLEM, nodes=6, time_step=200.0), replace(PROBLEM, nodes=21)]
REFINER = find("refiner")


def network(spread):
    """A network whose answers depend on what it reads, the more the greater the spread."""
    torch.manual_seed(0)
    encoding = Encoding(PROBLEM, 10, "line", "offset", (1.0,) * 6, (1.0,) * 6)
    made = REFINER.network(REFINER.config, encoding, 0.0)
    torch.nn.init.normal_(made.offer.weight, std=spread)
    return made.eval().requires_grad_(False)


def drawn(family, n, k, problem=PROBLEM):
    scenario = draw(family, 0, n, k, problem, "valid")
    return scenario.initial, scenario.goal


def by_craft(made, initial, goal):
    """Controls of every round, each craft by itself."""
    steps = {name: step(made, PROBLEM) for name, step in STEPS.items()}

    def run(name, known):
        given = [torch.as_tensor(known[one]) for one in takes(STEPS[name])]
        found = steps[name](*given)
        return dict(zip(STEPS[name].gives, (one.numpy() for one in found), strict=True))

    flown = fly_rounds(run, initial, goal, PROBLEM.collision_radius, rounds=made.rounds)
    return np.stack(list(flown))


def relative(met, states):
    """States of first craft relative to second at both ends of their interval."""
    first, second = (
        torch.stack([states[craft, met.interval], states[craft, met.interval + 1]], dim=1)
        for craft in met.both
    )
    return first - second


@pytest.mark.parametrize(("family", "n"), [("rings", 1), ("rings", 2), ("dense", 10)])
def test_by_the_rule_alone_craft_by_themselves_fly_as_the_swarm_does(family, n):
    for k in range(2):
        ends = drawn(family, n, k)
        wanted = together(network(0.0), PROBLEM, *ends)
        difference = np.abs(by_craft(network(0.0), *ends) - wanted).max()
        assert difference <= 1e-6 * np.abs(wanted).max()


def test_what_is_learned_is_bargained_craft_by_craft_as_in_the_swarm():
    made = network(0.05)
    found = []
    for family, n, k in [("rings", 10, 2), ("rings", 10, 4), ("dense", 5, 2), ("dense", 5, 3)]:
        ends = drawn(family, n, k)
        wanted = together(made, PROBLEM, *ends)
        assert (
            np.abs(wanted - together(network(0.0), PROBLEM, *ends)).max()
            > 1e-3 * np.abs(wanted).max()
        )
        found.append(compare(by_craft(made, *ends), wanted))
    assert max(one.difference for one in found) <= 1e-5
    assert sum(one.tie for one in found) <= 1  # else little would have been compared


def test_another_optimum_of_the_same_fuel_is_no_difference_but_more_fuel_is():
    wanted = np.ones((3, 2, 4))
    other = wanted.copy()
    other[1, 0, :2], other[2] = (0.5, 1.5), 7.0
    assert compare(other, wanted) == Compared(0.0, tie=True)
    other[1, 0, 0] = 0.75
    assert compare(other, wanted) == Compared(0.5, tie=False)


def test_craft_by_themselves_know_no_numbers_of_craft():
    made, (initial, goal) = network(0.05), drawn("dense", 5, 2)
    order = np.random.default_rng(0).permutation(5)
    found = compare(
        by_craft(made, initial[order], goal[order]), by_craft(made, initial, goal)[:, order]
    )
    assert found.difference <= 1e-5


def test_one_craft_s_program_is_that_of_many():
    """With planes that are met, that are asked too much of, and that are not there."""
    for problem in (PROBLEM, *OTHERS):
        ends = [torch.from_numpy(end[None]) for end in drawn("dense", 10, 0, problem)]
        task = begin(swarms(problem, *(end.numpy() for end in ends)))
        rng, m = np.random.default_rng(0), task.grid.reach.shape[1]
        node = rng.integers(2, problem.nodes - 1, size=(10, 5))
        normal = torch.from_numpy(rng.normal(size=(10, 5, 3)))
        position = task.grid.reach.reshape(-1, 6, m)[torch.from_numpy(node), :3]
        row = torch.einsum("cpx,cpxm->cpm", normal, position)
        row[:, 1] = -row[:, 0]
        more = torch.from_numpy(rng.uniform(-0.5, 1.5, size=(10, 5)))
        asked = (row @ task.own.controls[:, :, None])[:, :, 0] + more
        real = torch.from_numpy(rng.random((10, 5)) < 0.8)
        dearest = 0.0
        for k in range(10):
            own, some = one_of(task.own, k), real[k]
            count = int(some.sum())
            first = Sides(torch.tensor([0]), torch.tensor([0, count]), 2 * torch.arange(count))
            wanted = solve(own, first, row[k, some], asked[k, some, None].expand(-1, 2))
            controls, price = solve_one(own, row[k], asked[k], some)
            assert controls.numpy() == pytest.approx(wanted.controls[0].numpy(), abs=1e-8)
            assert price[some].numpy() == pytest.approx(wanted.price[:, 0].numpy(), abs=1e-7)
            assert (price[~some] == 0).all()
            dearest = max(dearest, float(price.amax()))
        assert dearest == pytest.approx(DEAREST)


def test_the_closest_approach_that_a_craft_finds_is_the_swarm_s():
    rng = np.random.default_rng(0)
    states = torch.from_numpy(rng.normal(size=(40, 6, 6)))
    states[20:, 1:] = states[20:, :1] + 1e-3 * states[20:, 1:]  # almost still
    first = torch.arange(0, 40, 2).repeat_interleave(5)
    met = Encounters(first, first + 1, torch.arange(5).repeat(20))
    motion = cubic(relative(met, states))
    share, found = nearest(motion), look(met, states)
    assert share.numpy() == pytest.approx(found.share.numpy(), abs=1e-6)
    assert torch.equal(turns(motion, share), found.turns)
    assert (~found.turns).sum() > 5


def test_the_planes_that_a_craft_puts_up_are_the_swarm_s():
    torch.manual_seed(0)
    states, grid = torch.randn(6, PROBLEM.nodes, 6).double(), grid_of(PROBLEM, torch.device("cpu"))
    states[3] = states[0]  # one pair touches, and one stands still
    states[4] = states[1] + 1.0
    met = Encounters(torch.arange(3), torch.arange(3, 6), torch.tensor([2, 0, 9]))
    share = torch.tensor([0.0, 0.3, 1.0]).double()
    wanted = planes(met, share, states, grid)
    found = on_board_planes(met.interval, share, cubic(relative(met, states)), grid)
    for name, values in vars(wanted).items():
        torch.testing.assert_close(getattr(found, name), values, msg=name)


def test_the_own_optimum_that_a_craft_looks_up_is_the_swarm_s():
    for problem in (PROBLEM, *OTHERS):
        grid = grid_of(problem, torch.device("cpu"))
        initial, goal = drawn("rings", 20, 0, problem)
        goal[0] = initial[0] @ grid.drift[-6:].T.numpy()  # about to stay where it drifts
        goal[1, [2, 5]] = initial[1, [2, 5]] = 0.0  # nothing across the plane
        task = begin(swarms(problem, initial[None], goal[None]))
        scale = np.repeat([1.0, problem.time_step], 3) / problem.collision_radius
        for k in range(20):
            ends = (torch.from_numpy(end[k : k + 1] * scale) for end in (initial, goal))
            own = own_optimum(*ends, grid, problem)
            same = one_of(task.own, k)
            assert own.controls.numpy() == pytest.approx(same.controls.numpy(), abs=1e-8)
            assert torch.equal(own.basis, same.basis) and torch.equal(own.others, same.others)
            assert own.tableau.numpy() == pytest.approx(same.tableau.numpy(), abs=1e-7)
            assert own.cost.numpy() == pytest.approx(same.cost.numpy(), abs=1e-7)


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
        found = step(*(torch.as_tensor(known[one]) for one in takes(STEPS[name])))
        given = dict(zip(step.gives, (one.numpy() for one in found), strict=True))
        if name in ROUND:
            seen.update({one: prod(given[one].shape[1:]) for one in step.tells})
        return given

    list(fly_rounds(run, initial, goal, 15.0, rounds=1))
    assert seen == told
