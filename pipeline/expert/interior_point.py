"""The convex subproblem handed to Clarabel as sparse data: the reference for the simplex method.

Variables and rows are those of ``pipeline.expert.split``, with the signs and the limits as rows
between the goals and the half-spaces.
"""

from functools import lru_cache

import clarabel
import numpy as np
from jaxtyping import Float, Int
from scipy import sparse

from pipeline.arrays import Array
from pipeline.expert.split import cost, goal, goal_entries, half_space_entries, optimum
from pipeline.expert.subproblem import LENGTH, Optimum, Subproblem, UnsolvableError

TOLERANCE = 1e-7
"""Relative tolerance of a joint program: far below what a round gains."""

OPTIMAL = ("Solved", "AlmostSolved")
"""What Clarabel calls an optimum."""


def new_solver(
    sub: Subproblem, *, tolerance: float = TOLERANCE, careful: bool = False
) -> clarabel.DefaultSolver:
    """A solver that holds the subproblem; one thread, since instances run in parallel.

    Args:
        sub: the subproblem.
        tolerance: relative, of the optimum and of feasibility.
        careful: with equilibration and iterative refinement, which these well-scaled programs
            hardly ever need and which take half of the time.
    """
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.presolve_enable = False  # which only drops rows without a bound, and there is none
    settings.equilibrate_enable = settings.iterative_refinement_enable = careful
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    prices, A, equalities = cost(sub), _constraints(sub), 6 * len(sub.miss)
    cones = [
        clarabel.ZeroConeT(equalities),
        clarabel.NonnegativeConeT(A.shape[0] - equalities),
    ]
    return clarabel.DefaultSolver(
        _no_curvature(len(prices)), prices, A, _right_hand_side(sub), cones, settings
    )


def solve(sub: Subproblem) -> Optimum:
    """The optimum of a subproblem.

    Raises:
        UnsolvableError: where the solver stops without one. With slack, only a thrust limit can
            make a subproblem infeasible.
    """
    found = new_solver(sub).solve()
    if str(found.status) not in OPTIMAL:
        found = new_solver(sub, careful=True).solve()
    if str(found.status) not in OPTIMAL:
        raise UnsolvableError(f"the convex solver stopped with {found.status}")
    x, z = np.asarray(found.x), np.asarray(found.z)
    return optimum(x, z[len(z) - len(sub.required) :], sub)


def _right_hand_side(sub: Subproblem) -> Float[Array, "rows"]:
    """B of A x + s = b."""
    n, m, k = sub.shape
    limits = 2 * n * m if np.isfinite(sub.limit) else 0
    return np.concatenate(
        [
            goal(sub),
            np.zeros(2 * n * m + k),
            np.full(limits, sub.limit / sub.unit),
            -sub.required / LENGTH,
        ]
    )


@lru_cache(maxsize=1024)
def _no_curvature(variables: int) -> sparse.csc_matrix:
    """P of a linear program."""
    return sparse.csc_matrix((variables, variables))


def _constraints(sub: Subproblem) -> sparse.csc_matrix:
    """A of A x + s = b with s in the cones."""
    n, m, k = sub.shape
    variables = np.arange(2 * n * m + k)
    limited = variables[: 2 * n * m if np.isfinite(sub.limit) else 0]
    r, c, value = half_space_entries(sub)
    blocks = (
        (6 * n, goal_entries(sub)),
        (len(variables), (variables, variables, -np.ones(len(variables)))),
        (len(limited), (limited, limited, np.ones(len(limited)))),
        (k, (r, c, -value)),
    )
    tops = np.cumsum([0] + [height for height, _ in blocks])
    row = np.concatenate([e[0] + top for (_, e), top in zip(blocks, tops[:-1], strict=True)])
    column = np.concatenate([e[1] for _, e in blocks])
    value = np.concatenate([e[2] for _, e in blocks])
    return _by_columns(row, column, value, (int(tops[-1]), len(variables)))


def _by_columns(
    row: Int[Array, "e"], column: Int[Array, "e"], value: Float[Array, "e"], shape: tuple[int, int]
) -> sparse.csc_matrix:
    """A sparse matrix from entries that are all different, in less time than by way of COO."""
    order = np.argsort(column * shape[0] + row)
    starts = np.searchsorted(column[order], np.arange(shape[1] + 1))
    return sparse.csc_matrix((value[order], row[order], starts), shape=shape)
