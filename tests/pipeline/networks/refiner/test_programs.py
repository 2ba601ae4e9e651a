"""Craft's own programs against HiGHS, and their gradients against finite differences."""

import numpy as np
import pytest
import torch
from scipy.optimize import linprog
from tableaux import one_of

from pipeline.errors import InputError
from pipeline.networks.refiner.geometry import Sides, grid_of
from pipeline.networks.refiner.programs import LARGEST_DUAL, decoupled_optima
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import transfer_maps

CRAFT, PLANES = 40, 4
PROBLEMS = [Problem(), Problem(nodes=6, time_step=200.0), Problem(nodes=21)]


def drawn_programs(problem, seed=0):
    """Random changes of state, and planes across random positions, mostly a little too far."""
    rng, grid = np.random.default_rng(seed), grid_of(problem)
    size = np.repeat([8.0, 8.0 * problem.time_step / problem.duration], 3)
    own = decoupled_optima(np.zeros((CRAFT, 6)), rng.normal(size=(CRAFT, 6)) * size, grid, problem)
    node = rng.integers(2, problem.nodes - 1, size=(CRAFT, PLANES))
    normal = rng.normal(size=(CRAFT, PLANES, 3))
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    position = grid.reach.reshape(problem.nodes, 6, -1)[node, :3]
    row = np.einsum("cpx,cpxm->cpm", normal, position)
    asked = (row @ own.controls[:, :, None])[:, :, 0]
    asked = asked + rng.uniform(-0.5, 1.0, size=asked.shape)
    count = rng.integers(1, PLANES + 1, size=CRAFT)
    real = np.arange(PLANES) < count[:, None]
    return own, row[real], asked[real], count, grid.reach[-6:]


def first_sides(count):
    """Sides of planes of which nothing is asked of the second craft, the one after the first."""
    first = np.arange(len(count)).repeat(count)
    return Sides.of(np.stack([first, (first + 1) % len(count)], axis=1))


def solve(own, row, asked, count):
    """Controls and duals; planes stand one craft's after the other's."""
    sides, both = first_sides(count), np.stack([asked, np.full_like(asked, -1000.0)], axis=1)
    controls, dual = own.optima(sides, row, both)
    assert (dual[:, 1] == 0).all()
    return controls, dual[:, 0]


def first_dual(own, row):
    """Of a row for each craft."""
    return own.first_duals(np.arange(len(row)), row)


def by_craft(values, count):
    """Planes of each craft."""
    return np.split(values, count.cumsum()[:-1])


def by_highs(goal, row, asked, reach):
    """The optimum of one program, with controls split by sign and missing separation."""
    p, m = row.shape
    found = linprog(
        np.concatenate([np.ones(2 * m), np.full(p, LARGEST_DUAL)]),
        A_eq=np.hstack([reach, -reach, np.zeros((6, p))]),
        b_eq=goal,
        A_ub=-np.hstack([row, -row, np.eye(p)]),
        b_ub=-asked,
    )
    return found.fun, -found.ineqlin.marginals


@pytest.mark.parametrize("problem", PROBLEMS)
def test_the_optimum_and_its_duals_are_those_of_highs(problem):
    own, row, asked, count, reach = drawn_programs(problem)
    flown, dual = solve(own, row, asked, count)
    goal = own.controls @ reach.T
    assert np.abs(flown @ reach.T - goal).max() < 1e-9
    every = (by_craft(values, count) for values in (row, asked, dual))
    for k, (rows, wanted, duals) in enumerate(zip(*every, strict=True)):
        controls = flown[k]
        mine = np.abs(controls).sum() + LARGEST_DUAL * np.maximum(wanted - rows @ controls, 0).sum()
        least, theirs = by_highs(goal[k], rows, wanted, reach)
        assert mine == pytest.approx(least, rel=1e-7)
        assert duals == pytest.approx(theirs, abs=1e-6)
    assert (dual > 0).any()


def test_the_second_craft_of_a_plane_sees_it_from_the_other_side():
    own, row, asked, _, _ = drawn_programs(Problem())
    pair, one = np.array([[3, 8], [8, 20]]), row[:2]
    both = np.stack([asked[:2], asked[2:4]], axis=1)
    sides = Sides.of(pair)
    controls, dual = own.optima(sides, one, both)
    assert sides.craft.tolist() == [3, 8, 20]
    asked_of = {3: [(0, 0)], 8: [(0, 1), (1, 0)], 20: [(1, 1)]}
    for k, craft in enumerate(sides.craft.tolist()):
        planes = np.stack([(-1.0) ** side * one[which] for which, side in asked_of[craft]])
        wanted = np.stack([both[which, side] for which, side in asked_of[craft]])
        alone = solve(one_of(own, craft), planes, wanted, np.array([len(planes)]))
        assert np.array_equal(controls[k], alone[0][0])
        assert [dual[which, side] for which, side in asked_of[craft]] == alone[1].tolist()
    assert (dual > 0).any()


def test_what_cannot_be_had_is_given_up_at_the_largest_dual():
    own, row, _, _, _ = drawn_programs(Problem())
    both = np.tile(np.stack([row[0], -row[0]]), (CRAFT, 1))  # both sides of a plane
    controls, dual = solve(own, both, np.full(2 * CRAFT, 0.5), np.full(CRAFT, 2))
    assert np.isfinite(controls).all()
    assert dual.reshape(CRAFT, 2).max(axis=1) == pytest.approx(LARGEST_DUAL)


def test_a_craft_whose_planes_are_far_away_keeps_its_decoupled_optimum():
    own, row, asked, count, _ = drawn_programs(Problem())
    controls, dual = solve(own, row, asked - 100, count)
    assert controls == pytest.approx(own.controls, abs=1e-12)
    assert (dual == 0).all()


def test_gradients_are_how_the_optimum_moves():
    own, row, asked, count, _ = drawn_programs(Problem(), seed=3)
    rng = np.random.default_rng(0)
    taste, move = (
        rng.normal(size=own.controls.shape),
        [rng.normal(size=x.shape) for x in (row, asked)],
    )
    rows, wanted = (torch.from_numpy(x).requires_grad_() for x in (row, asked))
    both = torch.stack([wanted, torch.full_like(wanted, -1000.0)], dim=1)
    controls, _ = own.optima(first_sides(count), rows, both)
    (controls * torch.from_numpy(taste)).sum().backward()
    step, now = 1e-6, controls.detach().numpy()
    assert np.array_equal(now, solve(own, row, asked, count)[0])
    ahead, behind = (
        (solve(own, row + s * move[0], asked + s * move[1], count)[0] - now) / s
        for s in (step, -step)
    )
    smooth = np.abs(ahead - behind).max(axis=1) < 1e-2  # others are at a kink
    slope = ((ahead + behind) / 2 * taste).sum(axis=1)
    each = (rows.grad.numpy() * move[0]).sum(axis=1) + wanted.grad.numpy() * move[1]
    mine = np.array([part.sum() for part in by_craft(each, count)])
    assert mine[smooth] == pytest.approx(slope[smooth], rel=1e-4, abs=1e-4)
    assert smooth.sum() >= CRAFT - 4
    assert np.abs(mine).max() > 0.1


def test_the_first_unit_along_a_row_costs_what_a_small_step_does():
    own, row, _, count, _ = drawn_programs(Problem())
    step, one = 1e-6, row[count.cumsum() - count]
    asked = (one * own.controls).sum(axis=1) + step
    controls, dual = solve(own, one, asked, np.ones_like(count))
    more = np.abs(controls).sum(axis=1) - np.abs(own.controls).sum(axis=1)
    assert more / step == pytest.approx(first_dual(own, one), rel=1e-4)
    assert dual == pytest.approx(first_dual(own, one), rel=1e-6)


def test_what_no_control_moves_costs_the_same_however_it_is_rounded():
    """A plane at the last node, which every control that meets the goal leaves where it is."""
    own, _, _, _, reach = drawn_programs(Problem())
    normal = np.random.default_rng(0).normal(size=(CRAFT, 6))
    dual = first_dual(own, normal @ reach)
    assert (dual > 1e6).all()
    assert np.array_equal(dual, first_dual(own, -normal @ reach))


def test_where_a_state_is_out_of_reach_it_says_so():
    """In two intervals of half a revolution each, in which controls act alike."""
    problem = Problem(time_step=np.pi / Problem().mean_motion, nodes=3)
    with pytest.raises(InputError, match="no controls reach"):
        decoupled_optima(np.zeros((1, 6)), np.ones((1, 6)), grid_of(problem), problem)


def test_units_of_step_and_radius_change_no_transfer():
    """The grid against the problem's own maps, in m and s."""
    problem = Problem()
    maps, grid = transfer_maps(problem), grid_of(problem)
    rng = np.random.default_rng(0)
    initial, controls = rng.normal(size=(1, 6)), rng.normal(size=(1, 30))
    states = initial @ maps.drift.reshape(-1, 6).T + controls @ maps.reach.reshape(-1, 30).T
    per_step = np.repeat([1.0, problem.time_step], 3)
    flown = grid.fly(initial * per_step, controls * problem.time_step**2)
    assert flown[0] / per_step == pytest.approx(states.reshape(-1, 6), rel=1e-9)
