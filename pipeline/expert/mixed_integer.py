"""The subproblem with a smallest impulse bit, by HiGHS: thrusts are zero, or at least so large."""

import highspy
import numpy as np
from scipy import sparse

from pipeline.expert.conic import ConicProgram
from pipeline.expert.solvers import ROWWISE, new_highs
from pipeline.expert.subproblem import LENGTH, Optimum, Subproblem, UnsolvableError

GAP = 1e-3  # relative gap at which the search for the best choice of burns ends
SECONDS = 10.0  # after which it ends with the best that it has
LARGEST = 100.0  # thrust without a limit, in units; such a variable needs one
_FOUND = (highspy.HighsModelStatus.kOptimal, highspy.HighsModelStatus.kTimeLimit)


def by_integers(sub: Subproblem) -> Optimum:
    """The optimum of a subproblem whose thrusts are of some directions, without limits of norms.

    Its dual variables are not known, and zero. UnsolvableError where none was found.
    """
    program, least = ConicProgram(sub), sub.thrust.min_delta_v
    assert least is not None
    assert sub.limits is not None
    parts = [program.goals(), program.spending(), program.half_spaces()]
    rows = sparse.csr_array(sparse.vstack([part for part, _ in parts]))
    upper = np.concatenate([part for _, part in parts])
    lower = np.full(len(upper), -np.inf)
    lower[: len(parts[0][1])] = parts[0][1]
    S, V = len(program.slots[0]), len(program.price)
    thrust = np.arange(program.variables) < S * V
    most = np.full(program.variables, np.inf)
    limit = np.repeat(sub.limits.component[program.slots[0]] / sub.unit, V)
    most[thrust] = np.minimum(limit, LARGEST)
    most[np.setdiff1d(np.flatnonzero(thrust), program.kept)] = 0.0
    bit = np.where(thrust & (most > 0), least / (sub.time_step * sub.unit), 0.0)
    solver = new_highs(mip_rel_gap=GAP, time_limit=SECONDS)
    solver.passModel(
        *(len(most), len(upper), rows.nnz, ROWWISE, int(highspy.ObjSense.kMinimize), 0.0),
        *(program.cost(), bit, most, lower, upper),
        *(rows.indptr.astype(np.int32), rows.indices.astype(np.int32), rows.data),
        np.where(bit > 0, int(highspy.HighsVarType.kSemiContinuous), 0).astype(np.int32),
    )
    solver.run()
    status, found = solver.getModelStatus(), np.array(solver.getSolution().col_value)
    if status not in _FOUND or not np.isfinite(solver.getInfo().objective_function_value):
        reason = solver.modelStatusToString(status)
        raise UnsolvableError(f"the search for burns that are large enough stopped with {reason}")
    k = len(sub.required)
    slack = LENGTH * found[S * V : S * V + k]
    return Optimum(program.controls_of(found), slack, np.zeros(k))
