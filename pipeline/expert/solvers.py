"""The convex subproblem by HiGHS' dual simplex method, which is faster than Clarabel.

The simplex method starts from the decoupled optimum of every craft, whose basis a table gives.
That basis is dual feasible, since half-spaces then have dual variables of zero, so only the pivots
that move craft apart are left. Clarabel's interior-point method (``conic``) needs no basis; it also
solves cone programs, and is the reference for the simplex method.
"""

from dataclasses import replace
from threading import local
from typing import Any

import highspy
import numpy as np

from pipeline.arrays import Array, Float, Int
from pipeline.expert.subproblem import LENGTH, Basis, Optimum, Subproblem, UnsolvableError

# Of HiGHS
OPTIONS = {
    "presolve": "off",
    "solver": "simplex",
    "simplex_scale_strategy": 0,  # these programs are scaled
}

LONG: float = 1000  # half-spaces from which on a program may take seconds or minutes
CHECK_SECONDS = 0.1  # interval at which signals are handled meanwhile

_LOWER, _BASIC = highspy.HighsBasisStatus.kLower, highspy.HighsBasisStatus.kBasic
ROWWISE, _MINIMIZE = int(highspy.MatrixFormat.kRowwise), int(highspy.ObjSense.kMinimize)
_thread = local()


def by_simplex(sub: Subproblem) -> Optimum:
    """Solve a subproblem by the dual simplex method.

    UnsolvableError where there is no optimum: with slack, only a thrust limit can make it
    infeasible.
    """
    solver, (n, m, k) = _highs(), sub.shape
    upper = np.full(2 * n * m + k, np.inf)
    upper[: 2 * n * m] = sub.limit / sub.unit
    goals = sub.goals()
    lower = np.concatenate([goals, sub.required / LENGTH])
    start, column, value = _rows(sub)
    solver.passModel(
        *(len(upper), len(lower), len(value), ROWWISE, _MINIMIZE, 0.0),
        *(sub.cost(), np.zeros(len(upper)), upper),
        *(lower, np.concatenate([goals, np.full(k, np.inf)])),
        *(start, column, value, np.zeros(len(upper), dtype=np.int32)),
    )
    if sub.last is not None:
        solver.setBasis(_highs_basis(sub.last))
    elif sub.basis is not None:
        solver.setBasis(_highs_basis(Basis.of_decoupled(sub.basis, m, k)))
    run(solver, long=k >= LONG)
    status = solver.getModelStatus()
    if status != highspy.HighsModelStatus.kOptimal and sub.last is not None:
        return by_simplex(replace(sub, last=None))  # starts from a basis that is dual feasible
    if status != highspy.HighsModelStatus.kOptimal:
        reason = solver.modelStatusToString(status)
        raise UnsolvableError(f"the simplex method stopped with {reason}")
    found = solver.getSolution()
    dual = np.array(found.row_dual[6 * len(sub.miss) :])
    optimum = sub.optimum(np.array(found.col_value), dual)
    if sub.last is None:
        return optimum
    return replace(optimum, basis=_last(sub, solver.getBasicVariables()[1]))


def _highs() -> highspy.Highs:
    """The solver of this thread, made once."""
    if not hasattr(_thread, "solver"):
        _thread.solver = new_highs(**OPTIONS)
    return _thread.solver


class _SilentHighs(highspy.Highs):  # type: ignore[misc]  # untyped
    """HiGHS without any output; from version 1.16 on its constructor prints a header."""

    def enableCallbacks(self) -> None:  # noqa: N802
        self.silent()
        super().enableCallbacks()


def new_highs(**options: Any) -> highspy.Highs:
    """A silent solver with some options, on one thread, as instances run side by side."""
    solver = _SilentHighs()
    for name, value in {"threads": 1, **options}.items():
        solver.setOptionValue(name, value)
    return solver


def run(solver: highspy.Highs, *, long: bool) -> None:
    """Run HiGHS; a long program runs in its own thread, so that Ctrl-C and SIGTERM can stop it."""
    if not long:
        solver.run()
        return
    solver.HandleUserInterrupt = True
    try:
        solver.startSolve()
        while not solver.wait(CHECK_SECONDS)[0]:
            pass
    except BaseException:
        solver.cancelSolve()
        solver.wait()
        vars(_thread).clear()  # once interrupted, HiGHS would interrupt all later programs
        raise
    finally:
        solver.HandleUserInterrupt = False


def _rows(sub: Subproblem) -> tuple[Int[Array, "_"], Int[Array, "e"], Float[Array, "e"]]:
    """Starts, columns and values of the rows: the goals of each craft, and the half-spaces."""
    both = zip(sub.goal_rows(), sub.half_space_rows(), strict=True)
    count, column, value = map(np.concatenate, both)
    start = np.zeros(len(count) + 1, dtype=np.int32)
    count.cumsum(out=start[1:])
    return start, column.astype(np.int32), value


def _highs_basis(known: Basis) -> highspy.HighsBasis:
    goals = [_LOWER] * (6 * len(known.controls))
    columns = np.concatenate([known.controls.ravel(), known.slack]).tolist()
    basis = highspy.HighsBasis()
    basis.col_status = [_BASIC if basic else _LOWER for basic in columns]
    basis.row_status = goals + [_BASIC if basic else _LOWER for basic in known.row.tolist()]
    basis.valid = True
    return basis


def _last(sub: Subproblem, basic: Int[Array, "rows"]) -> Basis | None:
    """Basis from HiGHS' basic variables, row k as -1 - k; None where the row of a goal is basic."""
    n, m, k = sub.shape
    column, row = np.zeros(2 * n * m + k, dtype=bool), np.zeros(6 * n + k, dtype=bool)
    column[basic[basic >= 0]] = True
    row[-1 - basic[basic < 0]] = True
    if row[: 6 * n].any():
        return None
    return Basis(column[: 2 * n * m].reshape(n, 2 * m), column[2 * n * m :], row[6 * n :])
