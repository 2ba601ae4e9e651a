"""Craft's own programs against HiGHS, and their gradients against finite differences."""

import numpy as np
import pytest
import torch
from scipy.optimize import linprog
from tableaux import one_of

from pipeline.networks.least_fuel import least_fuel
from pipeline.networks.refiner import program
from pipeline.networks.refiner.grid import grid_of
from pipeline.networks.refiner.program import DEAREST, own_tableau
from pipeline.networks.refiner.sides import sides_of
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import transfer_maps

CRAFT, PLANES = 40, 4
GRID = grid_of(Problem(), torch.device("cpu"))
PROBLEMS = [Problem(), Problem(nodes=6, time_step=200.0), Problem(nodes=21)]


def programs(problem, seed=0):
    """Random changes of state, and planes across random positions, mostly a little too far."""
    rng = np.random.default_rng(seed)
    size = np.repeat([8.0, 8.0 / problem.duration], 3)
    miss = torch.from_numpy(rng.normal(size=(CRAFT, 6)) * size)
    found, grid = least_fuel(miss, problem), grid_of(problem, torch.device("cpu"))
    m = grid.reach.shape[1]
    controls = found.controls.reshape(CRAFT, m) * problem.time_step**2
    side = torch.where(found.basis < m, 1.0, -1.0).double()
    own = own_tableau(controls, found.basis % m, side, grid.to_goal)
    node = rng.integers(2, problem.nodes - 1, size=(CRAFT, PLANES))
    normal = rng.normal(size=(CRAFT, PLANES, 3))
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    position = grid.reach.reshape(problem.nodes, 6, m)[torch.from_numpy(node), :3]
    row = torch.einsum("cpx,cpxm->cpm", torch.from_numpy(normal), position)
    asked = (row @ controls[:, :, None])[:, :, 0]
    asked = asked + torch.from_numpy(rng.uniform(-0.5, 1.0, size=asked.shape))
    count = torch.from_numpy(rng.integers(1, PLANES + 1, size=CRAFT))
    real = torch.arange(PLANES) < count[:, None]
    return own, row[real], asked[real], count, grid.to_goal


def first_sides(asked, count):
    """Sides of planes of which nothing is asked of the second craft, the one after the first."""
    first = torch.arange(len(count)).repeat_interleave(count)
    sides = sides_of(torch.stack([first, (first + 1) % len(count)], dim=1), len(count))
    return sides, torch.stack([asked, torch.full_like(asked, -1000.0)], dim=1)


def solve(own, row, asked, count):
    """Controls and prices; planes stand one craft's after the other's."""
    sides, both = first_sides(asked, count)
    found = program.solve(own, sides, row, both)
    assert (found.price[:, 1] == 0).all()
    return found.controls, found.price[:, 0]


def first_price(own, row):
    """Of a row for each craft."""
    return program.first_price(own, torch.arange(len(row)), row, GRID)


def by_craft(values, count):
    """Planes of each craft, as arrays."""
    return [part.numpy() for part in torch.split(values, count.tolist())]


def by_highs(goal, row, asked, reach):
    """The optimum of one program, with controls split by sign and missing separation."""
    p, m = row.shape
    found = linprog(
        np.concatenate([np.ones(2 * m), np.full(p, DEAREST)]),
        A_eq=np.hstack([reach, -reach, np.zeros((6, p))]),
        b_eq=goal,
        A_ub=-np.hstack([row, -row, np.eye(p)]),
        b_ub=-asked,
    )
    return found.fun, -found.ineqlin.marginals


@pytest.mark.parametrize("problem", PROBLEMS)
def test_the_optimum_and_its_prices_are_those_of_highs(problem):
    own, row, asked, count, reach = programs(problem)
    flown, price = solve(own, row, asked, count)
    goal = (own.controls @ reach.T).numpy()
    assert np.abs((flown @ reach.T).numpy() - goal).max() < 1e-9
    every = (by_craft(values, count) for values in (row, asked, price))
    for k, (rows, wanted, prices) in enumerate(zip(*every, strict=True)):
        controls = flown[k].numpy()
        mine = np.abs(controls).sum() + DEAREST * np.maximum(wanted - rows @ controls, 0).sum()
        least, theirs = by_highs(goal[k], rows, wanted, reach.numpy())
        assert mine == pytest.approx(least, rel=1e-7)
        assert prices == pytest.approx(theirs, abs=1e-6)
    assert (price > 0).any()


def test_the_second_craft_of_a_plane_sees_it_from_the_other_side():
    own, row, asked, _, _ = programs(Problem())
    pair, one = torch.tensor([[3, 8], [8, 20]]), row[:2]
    both = torch.stack([asked[:2], asked[2:4]], dim=1)
    sides = sides_of(pair, CRAFT)
    found = program.solve(own, sides, one, both)
    assert sides.craft.tolist() == [3, 8, 20]
    asked_of = {3: [(0, 0)], 8: [(0, 1), (1, 0)], 20: [(1, 1)]}
    for k, craft in enumerate(sides.craft.tolist()):
        planes = torch.stack([(-1.0) ** side * one[which] for which, side in asked_of[craft]])
        wanted = torch.stack([both[which, side] for which, side in asked_of[craft]])
        alone = solve(one_of(own, craft), planes, wanted, torch.tensor([len(planes)]))
        assert torch.equal(found.controls[k], alone[0][0])
        price = [float(found.price[which, side]) for which, side in asked_of[craft]]
        assert price == alone[1].tolist()
    assert (found.price > 0).any()


def test_what_cannot_be_had_is_given_up_at_the_dearest_price():
    own, row, _, _, _ = programs(Problem())
    one = row[:1].expand(CRAFT, -1)
    both = torch.stack([one, -one], dim=1).reshape(2 * CRAFT, -1)  # both sides of a plane
    asked, count = torch.full((2 * CRAFT,), 0.5).double(), torch.full((CRAFT,), 2)
    controls, price = solve(own, both, asked, count)
    assert torch.isfinite(controls).all()
    assert price.reshape(CRAFT, 2).amax(dim=1).numpy() == pytest.approx(DEAREST)


def test_a_craft_whose_planes_are_far_away_keeps_its_own_optimum():
    own, row, asked, count, _ = programs(Problem())
    controls, price = solve(own, row, asked - 100, count)
    assert controls.numpy() == pytest.approx(own.controls.numpy(), abs=1e-12)
    assert (price == 0).all()


def test_gradients_are_how_the_optimum_moves():
    own, row, asked, count, _ = programs(Problem(), seed=3)
    torch.manual_seed(0)
    taste = torch.randn_like(own.controls)
    rows, wanted = row.clone().requires_grad_(), asked.clone().requires_grad_()
    sides, both = first_sides(wanted, count)
    controls, _ = program.optimum(own, sides, rows, both, GRID)
    (controls * taste).sum().backward()
    step, move = 1e-6, (torch.randn_like(row), torch.randn_like(asked))
    ahead, behind = (
        (solve(own, row + s * move[0], asked + s * move[1], count)[0] - controls.detach()) / s
        for s in (step, -step)
    )
    smooth = (ahead - behind).abs().amax(dim=1) < 1e-2  # others are at a kink
    slope = ((ahead + behind) / 2 * taste).sum(dim=1)
    each = (rows.grad * move[0]).sum(dim=1) + wanted.grad * move[1]
    mine = torch.stack([part.sum() for part in torch.split(each, count.tolist())])
    assert mine[smooth].numpy() == pytest.approx(slope[smooth].numpy(), rel=1e-4, abs=1e-4)
    assert smooth.sum() >= CRAFT - 4
    assert mine.abs().max() > 0.1


def test_the_first_unit_along_a_row_costs_what_a_small_step_does():
    own, row, _, count, _ = programs(Problem())
    step, one = 1e-6, row[count.cumsum(0) - count]
    asked = (one * own.controls).sum(dim=1) + step
    controls, price = solve(own, one, asked, torch.ones_like(count))
    more = controls.abs().sum(dim=1) - own.controls.abs().sum(dim=1)
    assert (more / step).numpy() == pytest.approx(first_price(own, one).numpy(), rel=1e-4)
    assert price.numpy() == pytest.approx(first_price(own, one).numpy(), rel=1e-6)


def test_what_no_control_moves_costs_the_same_however_it_is_rounded():
    """A plane at the last node, which every control that meets the goal leaves where it is."""
    own, _, _, _, reach = programs(Problem())
    normal = torch.randn(CRAFT, 6, dtype=torch.float64, generator=torch.manual_seed(0))
    price = first_price(own, normal @ reach)
    assert (price > 1e6).all()
    assert torch.equal(price, first_price(own, -normal @ reach))


def test_units_of_step_and_radius_change_no_transfer():
    """The grid against the problem's own maps, in m and s."""
    problem = Problem()
    maps, grid = transfer_maps(problem), grid_of(problem, torch.device("cpu"))
    rng = np.random.default_rng(0)
    initial, controls = rng.normal(size=(1, 6)), rng.normal(size=(1, 30))
    states = initial @ maps.drift.reshape(-1, 6).T + controls @ maps.reach.reshape(-1, 30).T
    per_step = np.repeat([1.0, problem.time_step], 3)
    flown = grid.fly(
        torch.from_numpy(initial * per_step), torch.from_numpy(controls * problem.time_step**2)
    )
    assert flown.numpy()[0] / per_step == pytest.approx(states.reshape(-1, 6), rel=1e-9)
