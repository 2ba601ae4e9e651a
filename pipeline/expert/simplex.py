"""The convex subproblem as a linear program for HiGHS' dual simplex method: the fast way.

Variables and rows are those of ``pipeline.expert.split``. It begins with the optimum of every
craft on its own, whose basis is known by table. That basis is dual feasible, since half-spaces
that are not in it have no price, so what is left are the pivots that move craft apart.
"""

from functools import lru_cache
from threading import local

import highspy
import numpy as np
from jaxtyping import Float, Int

from pipeline.arrays import Array
from pipeline.expert.split import cost, goal, goal_entries, half_space_entries, optimum
from pipeline.expert.subproblem import LENGTH, Optimum, Subproblem, UnsolvableError

_STATUS = np.array([highspy.HighsBasisStatus.kLower, highspy.HighsBasisStatus.kBasic], dtype=object)
_ROWWISE, _MINIMIZE = int(highspy.MatrixFormat.kRowwise), int(highspy.ObjSense.kMinimize)
_thread = local()


def solve(sub: Subproblem) -> Optimum:
    """The optimum of a subproblem.

    Raises:
        UnsolvableError: where there is none. With slack, only a thrust limit can make a subproblem
            infeasible.
    """
    solver = _solver()
    _pass(solver, sub)
    if sub.basis is not None:
        solver.setBasis(_basis(sub, sub.basis))
    solver.run()
    status = solver.getModelStatus()
    if status != highspy.HighsModelStatus.kOptimal:
        raise UnsolvableError(
            f"the simplex method stopped with {solver.modelStatusToString(status)}"
        )
    found = solver.getSolution()
    price = np.array(found.row_dual[6 * len(sub.miss) :])
    return optimum(np.array(found.col_value), price, sub)


def _solver() -> highspy.Highs:
    """A solver of this thread, made once."""
    if not hasattr(_thread, "solver"):
        _thread.solver = highspy.Highs()
        for name, value in {
            "output_flag": False,
            "presolve": "off",
            "solver": "simplex",
            "simplex_scale_strategy": 0,  # these programs are scaled
            "threads": 1,
        }.items():
            _thread.solver.setOptionValue(name, value)
    return _thread.solver


def _pass(solver: highspy.Highs, sub: Subproblem) -> None:
    n, m, k = sub.shape
    variables = 2 * n * m + k
    most = np.full(variables, np.inf)
    most[: 2 * n * m] = sub.limit / sub.unit
    wanted = goal(sub)
    least = np.concatenate([wanted, sub.required / LENGTH])
    start, column, value = _rows(sub)
    solver.passModel(
        *(variables, len(least), len(value), _ROWWISE, _MINIMIZE, 0.0),
        *(cost(sub), np.zeros(variables), most),
        *(least, np.concatenate([wanted, np.full(k, np.inf)])),
        *(start, column, value, _continuous(variables)),
    )


@lru_cache(maxsize=1024)
def _continuous(variables: int) -> Int[Array, "v"]:
    """None of them is an integer."""
    return np.zeros(variables, dtype=np.int32)


def _rows(sub: Subproblem) -> tuple[Int[Array, "_"], Int[Array, "e"], Float[Array, "e"]]:
    """Starts, columns and values of the rows: the goals of each craft, and the half-spaces."""
    n, _, k = sub.shape
    goals, cuts = goal_entries(sub), half_space_entries(sub)
    row, column, value = map(np.concatenate, zip(goals, cuts, strict=True))
    row[len(goals[0]) :] += 6 * n
    order = row.argsort(kind="stable")
    start = np.concatenate([[0], np.bincount(row, minlength=6 * n + k).cumsum()])
    return start.astype(np.int32), column[order].astype(np.int32), value[order]


def _basis(sub: Subproblem, own: Int[Array, "n 6"]) -> highspy.HighsBasis:
    """The own optima's bases, and every half-space as it falls out."""
    n, m, k = sub.shape
    basic = np.zeros(2 * n * m + k, dtype=int)
    basic[(own + 2 * m * np.arange(n)[:, None]).ravel()] = 1
    basis = highspy.HighsBasis()
    basis.col_status = _STATUS[basic].tolist()
    basis.row_status = _STATUS[[0] * (6 * n) + [1] * k].tolist()
    basis.valid = True
    return basis
