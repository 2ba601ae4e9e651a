"""The floor under any safe plan's gap: its relaxation loses no safe plan, its bound is proven."""

import numpy as np
import pytest
from scipy.optimize import linprog

from benchmarks import floor
from pipeline.expert.cuts import NO_CUTS, cuts_at
from pipeline.expert.solvers import clarabel_solver
from pipeline.orbit.problem import Problem
from pipeline.scenario import draw

PAIR = cuts_at(np.array([0]), np.array([1]), np.array([4]), np.array([37.0]), Problem())


def triangles(depth):
    """All triangles that so many splits of the sphere give."""
    found = floor.OCTANTS
    for _ in range(depth):
        found = np.concatenate([floor.quarters(t) for t in found])
    return found


def inside(triangle, directions):
    """Whether directions are positive combinations of the corners."""
    return (np.linalg.solve(triangle.T, directions.T) >= 0).all(axis=0)


@pytest.mark.parametrize("depth", [0, 1, 3])
def test_triangles_cover_the_sphere_and_half_spaces_hold_within_them(depth):
    rng = np.random.default_rng(depth)
    d = rng.normal(size=(2000, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    length = 1 + rng.exponential(size=(2000, 1)) * (rng.random((2000, 1)) < 0.5)
    corners = triangles(depth)
    normal, share = floor.relaxed(corners)
    covered = np.zeros(len(d), dtype=bool)
    for triangle, n, s in zip(corners, normal, share, strict=True):
        here = inside(triangle, d)
        assert ((d * length)[here] @ n.T >= s - 1e-12).all()
        covered |= here
    assert covered.all()
    assert (share[:, 3] > 1 / 3**0.5 - 1e-12).all()


def test_bound_is_the_optimum_of_highs_and_holds_for_any_multipliers():
    tree = floor.Tree(draw("rings", 0, 2, 3, Problem()))
    for triangle in triangles(1)[::5]:
        sub = tree._relaxation(PAIR, triangle[None])
        n, m, k = sub.shape
        block = np.kron(np.eye(n), sub.reach * (sub.goal_scale * sub.unit)[:, None])
        rows = np.zeros((k, n, m))
        rows[np.arange(k), sub.first] = sub.row
        rows[np.arange(k), sub.second] = -sub.row
        rows = rows.reshape(k, -1) * sub.unit / 10
        cost = np.concatenate([np.ones(2 * n * m), np.full(k, 10 * sub.penalty / sub.unit)])
        optimum = sub.unit * (
            linprog(
                cost,
                A_ub=-np.hstack([rows, -rows, np.eye(k)]),
                b_ub=-sub.required / 10,
                A_eq=np.hstack([block, -block, np.zeros((6 * n, k))]),
                b_eq=(sub.miss * sub.goal_scale).ravel(),
            ).fun
        )
        z = np.asarray(clarabel_solver(sub).solve().z)
        assert floor.proven(sub, z) == pytest.approx(optimum, rel=1e-5)
        rng = np.random.default_rng(0)
        for size in (1e-3, 1e-1, 1.0):
            other = z + size * rng.normal(size=len(z))
            assert floor.proven(sub, other) <= optimum * (1 + 1e-7)


def test_floor_is_above_the_own_optima_and_below_the_best_plan():
    rows = np.array(
        [floor.floor_and_gaps(draw("rings", 0, 10, k, Problem()), 300) for k in range(8)]
    )
    assert (rows[:, 0] >= -1e-12).all()
    assert (rows[:, 0] <= rows[:, 1] + 1e-9).all()
    assert rows[:, 1].sum() < rows[:, 2].sum()
    assert rows[:, 0].sum() > 0.9 * rows[:, 1].sum() > 0


def test_craft_without_conflict_need_no_more_than_their_own_optima():
    tree = floor.Tree(draw("rings", 0, 1, 0, Problem()))
    root = tree._node(NO_CUTS, np.zeros((0, 3, 3)), 0.0)
    assert tree.bound(np.inf, 10) == pytest.approx(root.bound)
