"""Craft's own programs against HiGHS, and their gradients against finite differences."""

import numpy as np
import pytest
import torch
from scipy.optimize import linprog

from pipeline.networks.least_fuel import least_fuel
from pipeline.networks.refiner.grid import grid_of
from pipeline.networks.refiner.program import DEAREST, optimum, own_tableau, solve
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import transfer_maps

CRAFT, PLANES = 40, 4
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
    real = torch.from_numpy(rng.random((CRAFT, PLANES)) < 0.8)
    return own, row, asked, real, grid.to_goal


def cost(controls, row, asked, real):
    missing = (asked - (row @ controls[:, :, None])[:, :, 0]).clamp(min=0) * real
    return controls.abs().sum(dim=1) + DEAREST * missing.sum(dim=1)


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
    own, row, asked, real, reach = programs(problem)
    found = solve(own, row, asked, real)
    goal = (own.controls @ reach.T).numpy()
    assert np.abs((found.controls @ reach.T).numpy() - goal).max() < 1e-9
    mine = cost(found.controls, row, asked, real)
    for k in range(CRAFT):
        some = real[k].numpy()
        least, price = by_highs(
            goal[k], row[k].numpy()[some], asked[k].numpy()[some], reach.numpy()
        )
        assert float(mine[k]) == pytest.approx(least, rel=1e-7)
        assert found.price[k].numpy()[some] == pytest.approx(price, abs=1e-6)
    assert (found.price[~real] == 0).all()
    assert (found.price > 0).any()


def test_what_cannot_be_had_is_given_up_at_the_dearest_price():
    own, row, asked, _, _ = programs(Problem())
    row[:, 1], asked[:, 1] = -row[:, 0], 1 - asked[:, 0]  # on both sides of a plane, and off it
    real = torch.zeros(CRAFT, PLANES, dtype=torch.bool).index_fill(1, torch.tensor([0, 1]), True)
    found = solve(own, row, asked, real)
    assert torch.isfinite(found.controls).all()
    assert found.price.amax(dim=1).numpy() == pytest.approx(DEAREST)


def test_a_craft_without_planes_keeps_its_own_optimum():
    own, row, asked, real, _ = programs(Problem())
    assert torch.equal(solve(own, row, asked, torch.zeros_like(real)).controls, own.controls)


def test_gradients_are_how_the_optimum_moves():
    own, row, asked, real, _ = programs(Problem(), seed=3)
    torch.manual_seed(0)
    taste = torch.randn_like(own.controls)
    rows, wanted = row.clone().requires_grad_(), asked.clone().requires_grad_()
    controls, _ = optimum(own, rows, wanted, real)
    (controls * taste).sum().backward()
    step, move = 1e-6, (torch.randn_like(row), torch.randn_like(asked))
    ahead, behind = (
        (solve(own, row + s * move[0], asked + s * move[1], real).controls - controls.detach()) / s
        for s in (step, -step)
    )
    smooth = (ahead - behind).abs().amax(dim=1) < 1e-2  # others are at a kink
    slope = ((ahead + behind) / 2 * taste).sum(dim=1)
    mine = (rows.grad * move[0]).sum(dim=(1, 2)) + (wanted.grad * move[1]).sum(dim=1)
    assert mine[smooth].numpy() == pytest.approx(slope[smooth].numpy(), rel=1e-4, abs=1e-4)
    assert smooth.sum() >= CRAFT - 4
    assert mine.abs().max() > 0.1


def test_the_first_unit_along_a_row_costs_what_a_small_step_does():
    own, row, _, _, _ = programs(Problem())
    step, alone = 1e-6, torch.ones(CRAFT, 1, dtype=torch.bool)
    one = row[:, :1]
    asked = (one @ own.controls[:, :, None])[:, :, 0] + step
    found = solve(own, one, asked, alone)
    more = found.controls.abs().sum(dim=1) - own.controls.abs().sum(dim=1)
    assert (more / step).numpy() == pytest.approx(own.price(one[:, 0]).numpy(), rel=1e-4)


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
