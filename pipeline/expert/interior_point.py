"""The convex subproblem handed to Clarabel as sparse data: the reference for the simplex method.

Each control is split into its positive and negative part, u = p - q with p, q ≥ 0, so that
‖u‖₁ is linear. The variables are p and q of each craft in turn, then the slacks; the rows are
the goals, the signs, the limits and the half-spaces. All are scaled to be of order one.
"""

from functools import lru_cache

import clarabel
import numpy as np
from jaxtyping import Float, Int
from scipy import sparse

from pipeline.arrays import Array
from pipeline.expert.subproblem import LENGTH, NEGLIGIBLE, Optimum, Subproblem, UnsolvableError

TOLERANCE = 1e-7
"""Relative tolerance of a joint program: far below what a round gains."""

OPTIMAL = ("Solved", "AlmostSolved")
"""What Clarabel calls an optimum."""

Entries = tuple[Int[Array, "e"], Int[Array, "e"], Float[Array, "e"]]


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
    settings.presolve_enable = False  # or the right-hand side could not be updated
    settings.equilibrate_enable = settings.iterative_refinement_enable = careful
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    n, m, k = sub.shape
    cost = np.concatenate([np.ones(2 * n * m), np.full(k, sub.penalty * LENGTH / sub.unit)])
    A, equalities = _constraints(sub), 6 * n
    cones = [
        clarabel.ZeroConeT(equalities),
        clarabel.NonnegativeConeT(A.shape[0] - equalities),
    ]
    return clarabel.DefaultSolver(
        _no_curvature(len(cost)), cost, A, right_hand_side(sub), cones, settings
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
    n, m, k = sub.shape
    x, z = np.asarray(found.x), np.asarray(found.z)
    controls = controls_of(x, sub)
    price = sub.unit / LENGTH * z[len(z) - k :]
    return Optimum(controls, LENGTH * x[2 * n * m :], price, float(np.abs(controls).sum()))


def controls_of(x: Float[Array, "v"], sub: Subproblem) -> Float[Array, "n m"]:
    """Controls in m/s² from the solver's variables."""
    n, m, _ = sub.shape
    parts = x[: 2 * n * m].reshape(n, 2, m)
    controls: Float[Array, "n m"] = sub.unit * (parts[:, 0] - parts[:, 1])
    return controls


def right_hand_side(sub: Subproblem) -> Float[Array, "rows"]:
    """B of A x + s = b."""
    n, m, k = sub.shape
    limits = 2 * n * m if np.isfinite(sub.limit) else 0
    return np.concatenate(
        [
            (sub.miss * sub.goal_scale).ravel(),
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
    blocks = (
        (6 * n, _goal_entries(sub)),
        (len(variables), (variables, variables, -np.ones(len(variables)))),
        (len(limited), (limited, limited, np.ones(len(limited)))),
        (k, _half_space_entries(sub)),
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


def _goal_entries(sub: Subproblem) -> Entries:
    n, m, _ = sub.shape
    block = sub.reach * (sub.goal_scale * sub.unit)[:, None]
    r, c = np.nonzero(np.abs(block) > NEGLIGIBLE)
    craft = np.arange(n)[:, None]
    row, column = (6 * craft + r).ravel(), (2 * m * craft + c).ravel()
    value = np.tile(block[r, c], n)
    return np.tile(row, 2), np.concatenate([column, column + m]), np.concatenate([value, -value])


def _half_space_entries(sub: Subproblem) -> Entries:
    n, m, k = sub.shape
    scaled = sub.row * sub.unit / LENGTH
    r, c = np.nonzero(np.abs(scaled) > NEGLIGIBLE)
    value = scaled[r, c]
    one, other = 2 * m * sub.first[r] + c, 2 * m * sub.second[r] + c
    slack = np.arange(k)
    return (
        np.concatenate([r, r, r, r, slack]),
        np.concatenate([one, one + m, other, other + m, 2 * n * m + slack]),
        np.concatenate([-value, value, value, -value, -np.ones(k)]),
    )
