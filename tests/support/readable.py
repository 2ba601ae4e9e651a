"""The convex subproblem of the expert written in cvxpy: the oracle of its fast solvers."""

import cvxpy as cp
import numpy as np

from pipeline.expert.subproblem import Optimum, Subproblem, UnsolvableError


def solve(sub: Subproblem) -> Optimum:
    """The optimum of a subproblem, by cvxpy.

    Raises:
        UnsolvableError: where the solver stops without one.
    """
    n, m, k = sub.shape
    u = cp.Variable((n, m))  # in units of sub.unit, as the solver wants numbers of order one
    slack = cp.Variable(k, nonneg=True)
    scale = 1 / np.linalg.norm(sub.reach, axis=1)
    constraints = [u @ (sub.reach.T * scale) == sub.miss * scale / sub.unit]
    apart = []
    if k:
        other = sub.row if sub.other is None else sub.other
        along = cp.sum(cp.multiply(sub.row, u[sub.first]), axis=1)
        along -= cp.sum(cp.multiply(other, u[sub.second]), axis=1)
        apart.append(sub.unit * along + slack >= sub.required)
    if np.isfinite(sub.limit):
        constraints.append(cp.abs(u) <= sub.limit / sub.unit)
    fuel = cp.sum(cp.abs(u))
    problem = cp.Problem(
        cp.Minimize(fuel + sub.penalty / sub.unit * cp.sum(slack)), constraints + apart
    )
    problem.solve(solver=cp.CLARABEL)
    if problem.status not in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE):
        raise UnsolvableError(f"the convex solver stopped with {problem.status}")
    dual = sub.unit * apart[0].dual_value if k else np.zeros(0)
    return Optimum(sub.unit * u.value, slack.value, dual)
