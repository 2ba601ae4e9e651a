"""The subproblem with a minimum impulse bit, by HiGHS: each thrust is zero or at least that bit.

A binary variable for each thrust says whether the thruster fires. Thrusters that fire together
must produce their control at the least cost, as a plan stores their sum alone: pairs that do not
are excluded from the start, and other sets as they appear. So are controls whose norm exceeds its
limit, by planes that cut off a bit of the sphere.
"""

from dataclasses import replace
from functools import cached_property
from itertools import combinations
from typing import Any

import highspy
import numpy as np
from scipy import sparse

from pipeline.arrays import Array, Float, Int
from pipeline.expert.conic import ConicProgram, stacked
from pipeline.expert.solvers import ROWWISE, new_highs, run
from pipeline.expert.subproblem import LENGTH, Optimum, Subproblem, UnsolvableError
from pipeline.orbit.arrays import Values, norm
from pipeline.orbit.problem import LIMIT_ROUNDING
from pipeline.orbit.thrust_cost import cost

GAP = 1e-3  # relative gap at which branch and bound ends
NODES = 500  # of its tree at most, after which it ends with the best solution so far
TOLERANCE = 1e-5  # share of bounds that tolerances of the solver and of burn sizes may take
FEASIBLE = 1e-9  # tolerance of rows; times the largest thrust it is far below a burn
ROUNDS = 20  # programs at most, each with rows against what was wrong in those before
INSIDE = 0.995  # distance of a plane from the origin over the norm's limit: one serves for 6°
# A row with an upper bound: indices of variables, their coefficients, and the bound
BoundedRow = tuple[Int[Array, "_"], Float[Array, "_"], float]
_FOUND = (highspy.HighsModelStatus.kOptimal, highspy.HighsModelStatus.kSolutionLimit)


class _InfeasibleError(UnsolvableError):
    """HiGHS finds that a mixed-integer program is infeasible."""


class _IntegerProgram(ConicProgram):
    """The program without cones; binary variables of all thrusts follow its own."""

    def rows(self) -> tuple[sparse.csr_array, Values]:
        """Rows and b: equalities, inequalities, and thrusts that are zero or at least a bit."""
        sub, N = self.sub, self.thrusts
        assert sub.thrust.min_delta_v is not None
        parts = [self.goals(), self.spending(), self.half_spaces()]
        known, upper = stacked(parts, self.variables, np.arange(self.variables))
        fires, rest = sparse.eye_array(N), sparse.csr_array((N, self.variables - N))
        bit = sub.thrust.min_delta_v / (sub.time_step * sub.unit)
        off = sparse.csr_array((known.shape[0], N))
        blocks: list[Any] = [
            sparse.hstack([known, off]),
            sparse.hstack([fires, rest, -sparse.diags_array(self.most())]),
            sparse.hstack([-fires, rest, bit * fires]),
        ]
        rows = sparse.csr_array(sparse.vstack(blocks))
        return rows, np.concatenate([upper, np.zeros(2 * N)])

    def most(self) -> Float[Array, "N"]:
        """Upper bounds on scaled thrusts: limits, or else a big M; 0 where none is allowed."""
        limit = np.minimum(self.limits.component / self.sub.unit, self.big_m)
        most = np.repeat(limit[self.slots[0]], len(self.price))
        most[np.setdiff1d(np.arange(self.thrusts), self.kept)] = 0.0
        return np.asarray(most)

    def beyond_big_m(self) -> float:
        """Lower bound on the cost of any solution with a thrust above the big M.

        Infinite where limits of thrust exclude these.
        """
        limited = self.limits.component / self.sub.unit <= self.big_m
        return float(np.where(limited, np.inf, self.big_m).min())

    @cached_property
    def big_m(self) -> Float[Array, "n"]:
        """Big M of each craft's scaled thrusts, for intervals without a limit of thrust.

        Twice the largest of 1 and what the craft needs by its own rows, in all intervals. Lower
        bounds are no higher, as a larger thrust is not excluded but by its own cost.
        """
        sub, (n, m, _) = self.sub, self.sub.shape
        assert sub.constrained is not None
        scale = sub.goal_scale * sub.constrained
        reach = scale[..., None] * sub.reach * self.limits.burns.reshape(n, 1, m)
        least_energy = np.matvec(np.linalg.pinv(reach), scale * sub.miss)
        dearest = cost(np.concatenate([np.eye(3), -np.eye(3)]), sub.thrust).max()
        needed = dearest * np.abs(least_energy).max(axis=1) / sub.unit
        return np.asarray(2 * np.maximum(1.0, needed) * (m / 3))

    def allowed(self) -> Values:
        """Rounding of the rows of goals, 0 where it is below the solver's tolerance.

        It is above in rows of states that controls hardly change, as in intervals of half an orbit.
        """
        sub = self.sub
        assert sub.constrained is not None
        scaled = sub.rounding * sub.goal_scale * np.ones(sub.constrained.shape)
        return np.where(scaled > FEASIBLE, scaled, 0.0)[sub.constrained]

    def not_together(self, thrusts: Int[Array, "_"]) -> BoundedRow:
        """The row that excludes some thrusts from being nonzero all at once."""
        return self.variables + thrusts, np.ones(len(thrusts)), len(thrusts) - 1.0

    def wasteful_pairs(self) -> list[BoundedRow]:
        """Rows that exclude pairs of thrusters whose joint effect others give at less cost."""
        V, pairs = len(self.price), np.array(list(combinations(range(len(self.price)), 2)))
        together = cost(self.effect.T[pairs].sum(axis=1), self.sub.thrust)
        pairs = pairs[together < 2 * (1 - LIMIT_ROUNDING)]
        each = V * np.arange(len(self.slots[0]))[:, None, None] + pairs
        return list(map(self.not_together, each.reshape(-1, 2)))

    def beyond_norm(self, control: Float[Array, "S 3"]) -> list[BoundedRow]:
        """Cutting planes, in all intervals, for scaled controls beyond the limit on their norm."""
        craft, V, size = self.slots[0], len(self.price), norm(control)
        limit = self.limits.norm[craft] / self.sub.unit
        return [
            (V * each + np.arange(V), control[s] / size[s] @ self.effect, INSIDE * float(limit[s]))
            for s in np.flatnonzero(size > limit).tolist()
            for each in np.flatnonzero(craft == craft[s]).tolist()
        ]

    def best(self, added: list[BoundedRow]) -> tuple[Float[Array, "v"], float]:
        """Optimal variables with additional rows, and a lower bound on the optimum's cost."""
        (rows, upper), N = self.rows(), self.thrusts
        width = rows.shape[1]
        more = sparse.lil_array((len(added), width))
        for k, (variables, coefficients, _) in enumerate(added):
            more[k, variables] = coefficients
        rows = sparse.csr_array(sparse.vstack([rows, sparse.csr_array(more)]))
        upper = np.concatenate([upper, [bound for *_, bound in added]])
        lower = np.full(len(upper), -np.inf)
        goals = self.goals()[1]
        allowed = self.allowed()
        lower[: len(goals)] = goals - allowed
        upper[: len(goals)] += allowed
        largest = np.full(width, np.inf)
        largest[:N], largest[width - N :] = self.most(), 1.0
        solver = new_highs(
            mip_rel_gap=GAP,
            mip_max_nodes=NODES,
            mip_feasibility_tolerance=FEASIBLE,
            primal_feasibility_tolerance=FEASIBLE,
        )
        solver.passModel(
            *(width, len(upper), rows.nnz, ROWWISE, int(highspy.ObjSense.kMinimize), 0.0),
            *(np.append(self.cost(), np.zeros(N)), np.zeros(width), largest, lower, upper),
            *(rows.indptr.astype(np.int32), rows.indices.astype(np.int32), rows.data),
            np.repeat([0, 1], [width - N, N]).astype(np.int32),
        )
        run(solver, long=True)
        status = solver.getModelStatus()
        if status not in _FOUND or not np.isfinite(solver.getInfo().objective_function_value):
            none = status == highspy.HighsModelStatus.kInfeasible
            reason = solver.modelStatusToString(status)
            raise (_InfeasibleError if none else UnsolvableError)(
                f"the search for burns that are large enough stopped with {reason}"
            )
        found = np.array(solver.getSolution().col_value)
        return found[: width - N], float(solver.getInfo().mip_dual_bound)


def by_integers(sub: Subproblem) -> Optimum:
    """Solve a subproblem of thrusters with fixed directions.

    Dual variables are not known, and zero. UnsolvableError where no solution is found.
    """
    program = _IntegerProgram(sub)
    N, V, k = program.thrusts, len(program.price), len(sub.required)
    added, bound, within_norm = program.wasteful_pairs(), 0.0, False
    for _ in range(ROUNDS):
        found, proven = program.best(added)
        if not within_norm:
            bound = max(bound, min(proven, program.beyond_big_m()) * (1 - TOLERANCE))
        fired = found[:N].reshape(-1, V)
        fired = np.where(fired > LIMIT_ROUNDING * fired.max(initial=0.0), fired, 0.0)
        control = fired @ program.effect.T
        spent, least = fired.sum(axis=1), cost(control, sub.thrust)
        dear = np.flatnonzero(spent > least * (1 + LIMIT_ROUNDING))
        wrong = [program.not_together(V * s + np.flatnonzero(fired[s])) for s in dear]
        planes = program.beyond_norm(control)
        if not wrong and not planes:
            found[:N] = fired.ravel()
            slack = LENGTH * found[N : N + k]
            controls = program.controls_of(found)
            return Optimum(controls, slack, np.zeros(k), bound=bound * sub.unit)
        within_norm |= len(planes) > 0  # slightly inside of the limit, which proves nothing
        added += wrong + planes
    raise UnsolvableError("no burns were found that fire at the least cost within the norm's limit")


def integer_infeasible(sub: Subproblem) -> bool:
    """Whether a subproblem with a minimum impulse bit is infeasible even with relaxed limits."""
    assert sub.limits is not None
    assert sub.thrust.min_delta_v is not None
    larger = replace(sub.limits, component=(1 + TOLERANCE) * sub.limits.component)
    smaller = replace(sub.thrust, min_delta_v=(1 - TOLERANCE) * sub.thrust.min_delta_v)
    program = _IntegerProgram(replace(sub, limits=larger, thrust=smaller))
    if np.isfinite(program.beyond_big_m()):
        return False
    try:
        program.best(program.wasteful_pairs())
    except UnsolvableError as error:
        return isinstance(error, _InfeasibleError)
    return False
