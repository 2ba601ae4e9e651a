"""The convex subproblem as a linear program for HiGHS' dual simplex method: the fast way.

Each control is split into its positive and negative part, u = p - q with p, q ≥ 0. The variables
are p and q of each craft in turn, then the slacks; the rows are the goals and the half-spaces.
All are scaled to be of order one.

It begins with the optimum of every craft on its own, whose basis is known by table. That basis is
dual feasible, since half-spaces that are not in it have no price, so what is left are the pivots
that move craft apart.
"""

from functools import lru_cache
from threading import local

import highspy
import numpy as np
from jaxtyping import Float, Int

from pipeline.arrays import Array
from pipeline.expert.subproblem import LENGTH, NEGLIGIBLE, Optimum, Subproblem, UnsolvableError

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
    n, m, _ = sub.shape
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
    x, price = np.array(found.col_value), np.array(found.row_dual[6 * n :])
    parts = x[: 2 * n * m].reshape(n, 2, m)
    controls = sub.unit * (parts[:, 0] - parts[:, 1])
    fuel = float(np.abs(controls).sum())
    return Optimum(controls, LENGTH * x[2 * n * m :], sub.unit / LENGTH * price, fuel)


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
    cost = np.ones(variables)
    cost[2 * n * m :] = sub.penalty * LENGTH / sub.unit
    most = np.full(variables, np.inf)
    most[: 2 * n * m] = sub.limit / sub.unit
    goal = (sub.miss * sub.goal_scale).ravel()
    least = np.concatenate([goal, sub.required / LENGTH])
    start, column, value = _rows(sub)
    solver.passModel(
        *(variables, len(least), len(value), _ROWWISE, _MINIMIZE, 0.0),
        *(cost, np.zeros(variables), most),
        *(least, np.concatenate([goal, np.full(k, np.inf)])),
        *(start, column, value, _continuous(variables)),
    )


@lru_cache(maxsize=1024)
def _continuous(variables: int) -> Int[Array, "v"]:
    """None of them is an integer."""
    return np.zeros(variables, dtype=np.int32)


def _rows(sub: Subproblem) -> tuple[Int[Array, "_"], Int[Array, "e"], Float[Array, "e"]]:
    """Starts, columns and values of the rows: the goals of each craft, and the half-spaces."""
    n, m, k = sub.shape
    block = sub.reach * (sub.goal_scale * sub.unit)[:, None]
    block = np.hstack([block, -block])
    r, c = np.nonzero(np.abs(block) > NEGLIGIBLE)
    goal_columns = (c + 2 * m * np.arange(n)[:, None]).ravel()
    along = sub.row * (sub.unit / LENGTH)
    cut, control = np.nonzero(np.abs(along) > NEGLIGIBLE)
    one, other = 2 * m * sub.first[cut] + control, 2 * m * sub.second[cut] + control
    slack = np.arange(k)
    owner = np.concatenate([cut, cut, cut, cut, slack])
    order = owner.argsort(kind="stable")
    columns = np.concatenate([one, one + m, other, other + m, 2 * n * m + slack])[order]
    push = along[cut, control]
    values = np.concatenate([push, -push, -push, push, np.ones(k)])[order]
    lengths = [np.tile(np.bincount(r, minlength=6), n), np.bincount(owner, minlength=k)]
    start = np.concatenate([[0], np.concatenate(lengths).cumsum()])
    return (
        start.astype(np.int32),
        np.concatenate([goal_columns, columns]).astype(np.int32),
        np.concatenate([np.tile(block[r, c], n), values]),
    )


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
