"""Solvers of the convex subproblem: HiGHS' dual simplex method, the fast one, and Clarabel.

The simplex method begins with the decoupled optimum of every craft, whose basis is known by table.
That basis is dual feasible, since half-spaces that are not in it have a dual variable of zero, so
what is left are the pivots that move craft apart. Clarabel's interior points need no basis; they
also solve the program of a single craft, and are the reference for the simplex method.
"""

from collections.abc import Callable
from functools import lru_cache
from threading import local
from typing import Any

import clarabel
import highspy
import numpy as np
from jaxtyping import Float, Int
from scipy import sparse

from pipeline.arrays import Array
from pipeline.expert.subproblem import LENGTH, Optimum, Subproblem, UnsolvableError

TOLERANCE = 1e-7  # relative tolerance of Clarabel in a joint program: far below what a round gains
OPTIMAL = ("Solved", "AlmostSolved")  # what Clarabel calls an optimum

# Of HiGHS
OPTIONS = {
    "presolve": "off",
    "solver": "simplex",
    "simplex_scale_strategy": 0,  # these programs are scaled
}

_STATUS = np.array([highspy.HighsBasisStatus.kLower, highspy.HighsBasisStatus.kBasic], dtype=object)
ROWWISE, _MINIMIZE = int(highspy.MatrixFormat.kRowwise), int(highspy.ObjSense.kMinimize)
_thread = local()


def by_simplex(sub: Subproblem) -> Optimum:
    """The optimum of a subproblem by the dual simplex method.

    UnsolvableError where there is none: with slack, only a thrust limit can make it infeasible.
    """
    solver, (n, m, k) = _highs(), sub.shape
    most = np.full(2 * n * m + k, np.inf)
    most[: 2 * n * m] = sub.limit / sub.unit
    wanted = sub.goals()
    least = np.concatenate([wanted, sub.required / LENGTH])
    start, column, value = _rows(sub)
    solver.passModel(
        *(len(most), len(least), len(value), ROWWISE, _MINIMIZE, 0.0),
        *(sub.cost(), np.zeros(len(most)), most),
        *(least, np.concatenate([wanted, np.full(k, np.inf)])),
        *(start, column, value, np.zeros(len(most), dtype=np.int32)),
    )
    if sub.basis is not None:
        solver.setBasis(_basis(sub, sub.basis))
    solver.run()
    status = solver.getModelStatus()
    if status != highspy.HighsModelStatus.kOptimal:
        reason = solver.modelStatusToString(status)
        raise UnsolvableError(f"the simplex method stopped with {reason}")
    found = solver.getSolution()
    dual = np.array(found.row_dual[6 * len(sub.miss) :])
    return sub.optimum(np.array(found.col_value), dual)


def by_interior_points(sub: Subproblem) -> Optimum:
    """The optimum of a subproblem by Clarabel; UnsolvableError where it stops without one."""
    found = clarabel_solver(sub).solve()
    if str(found.status) not in OPTIMAL:
        found = clarabel_solver(sub, careful=True).solve()
    if str(found.status) not in OPTIMAL:
        raise UnsolvableError(f"the convex solver stopped with {found.status}")
    x, z = np.asarray(found.x), np.asarray(found.z)
    return sub.optimum(x, z[len(z) - len(sub.required) :])


# Solvers by their name in ``Settings``
SOLVERS: dict[str, Callable[[Subproblem], Optimum]] = {
    "simplex": by_simplex,
    "clarabel": by_interior_points,
}


def _highs() -> highspy.Highs:
    """A solver of this thread, made once."""
    if not hasattr(_thread, "solver"):
        _thread.solver = new_highs(**OPTIONS)
    return _thread.solver


def new_highs(**options: Any) -> highspy.Highs:
    """A silent solver with some options, on one thread, as instances run side by side."""
    solver = highspy.Highs()
    for name, value in {"output_flag": False, "threads": 1, **options}.items():
        solver.setOptionValue(name, value)
    return solver


def _rows(sub: Subproblem) -> tuple[Int[Array, "_"], Int[Array, "e"], Float[Array, "e"]]:
    """Starts, columns and values of the rows: the goals of each craft, and the half-spaces."""
    n, _, k = sub.shape
    goals, cuts = sub.goal_entries(), sub.half_space_entries()
    row, column, value = map(np.concatenate, zip(goals, cuts, strict=True))
    row[len(goals[0]) :] += 6 * n
    order = row.argsort(kind="stable")
    start = np.concatenate([[0], np.bincount(row, minlength=6 * n + k).cumsum()])
    return start.astype(np.int32), column[order].astype(np.int32), value[order]


def _basis(sub: Subproblem, decoupled: Int[Array, "n 6"]) -> highspy.HighsBasis:
    """The decoupled optima's bases, and every half-space's slack row."""
    n, m, k = sub.shape
    basic = np.zeros(2 * n * m + k, dtype=int)
    basic[(decoupled + 2 * m * np.arange(n)[:, None]).ravel()] = 1
    basis = highspy.HighsBasis()
    basis.col_status = _STATUS[basic].tolist()
    basis.row_status = _STATUS[[0] * (6 * n) + [1] * k].tolist()
    basis.valid = True
    return basis


def clarabel_solver(
    sub: Subproblem, *, tolerance: float = TOLERANCE, careful: bool = False
) -> clarabel.DefaultSolver:
    """Clarabel with the subproblem as A x + s = b, s in cones.

    The rows are the goals, the signs of the variables, the limits and the half-spaces.
    """
    settings = clarabel_settings(tolerance, careful=careful)
    n, m, k = sub.shape
    cost, A, equalities = sub.cost(), _constraints(sub), 6 * n
    limits = np.full(2 * n * m if np.isfinite(sub.limit) else 0, sub.limit / sub.unit)
    b = np.concatenate([sub.goals(), np.zeros(2 * n * m + k), limits, -sub.required / LENGTH])
    cones = [clarabel.ZeroConeT(equalities), clarabel.NonnegativeConeT(len(b) - equalities)]
    return clarabel.DefaultSolver(_no_curvature(len(cost)), cost, A, b, cones, settings)


def clarabel_settings(tolerance: float, *, careful: bool) -> clarabel.DefaultSettings:
    """Settings of Clarabel: a relative tolerance, and one thread, as instances run side by side.

    A careful solver has equilibration and iterative refinement, which these well-scaled programs
    hardly ever need and which take half of the time.
    """
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.presolve_enable = False  # which only drops rows without a bound, and there is none
    settings.equilibrate_enable = settings.iterative_refinement_enable = careful
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    return settings


@lru_cache(maxsize=1024)
def _no_curvature(variables: int) -> sparse.csc_matrix:
    """P of a linear program: the quadratic term, which is zero."""
    return sparse.csc_matrix((variables, variables))


def _constraints(sub: Subproblem) -> sparse.csc_matrix:
    n, m, k = sub.shape
    variables = np.arange(2 * n * m + k)
    limited = variables[: 2 * n * m if np.isfinite(sub.limit) else 0]
    r, c, value = sub.half_space_entries()
    blocks = (
        (6 * n, sub.goal_entries()),
        (len(variables), (variables, variables, -np.ones(len(variables)))),
        (len(limited), (limited, limited, np.ones(len(limited)))),
        (k, (r, c, -value)),
    )
    tops = np.cumsum([0] + [height for height, _ in blocks])
    row = np.concatenate([e[0] + top for (_, e), top in zip(blocks, tops[:-1], strict=True)])
    column, value = (np.concatenate([e[k] for _, e in blocks]) for k in (1, 2))
    # The entries are all different: in less time than by way of COO.
    shape = int(tops[-1]), len(variables)
    order = np.argsort(column * shape[0] + row)
    starts = np.searchsorted(column[order], np.arange(shape[1] + 1))
    return sparse.csc_matrix((value[order], row[order], starts), shape=shape)
