"""Decoupled optima: each craft's optimum without the others, the SCP's start and lower bound."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from pipeline.arrays import Array
from pipeline.expert.arrivals import Arrivals, arrivals_of
from pipeline.expert.limited import dual_bounds, impossible, least_of, settled
from pipeline.expert.solvers import OPTIMAL, clarabel_solver
from pipeline.expert.subproblem import Subproblem
from pipeline.orbit.arrays import Controls, Formation, Marked, Rows
from pipeline.orbit.decoupled import SHORT, acceleration_scale, least_fuel
from pipeline.orbit.problem import RANGES, Problem
from pipeline.orbit.thrust import Limits
from pipeline.orbit.thrust_cost import cost
from pipeline.orbit.transfer import meet_goal, minimum_energy, transfer_maps

BOUND_TOLERANCE = 1e-8  # relative, of the programs of single craft, and so of their lower bound
LOOSE = 1e-7  # share of a craft's fuel that its bound may be below it
FARKAS_MARGIN = 1e-6  # relative margin by which a proof of impossibility must hold, beyond rounding
# How a lower bound is proven
TABLE = "a dual vertex of each craft's own linear program, by table"
PROGRAM = "multipliers of each craft's own convex program"
LIMIT_SHARE = 1 - 1e-7  # share of the thrust limit that programs use, rounding staying within it


@dataclass(frozen=True, eq=False)
class DecoupledOptima(Rows):
    """The L1-optimal transfer of each craft without the others."""

    controls: Controls  # m/s²; the minimum-energy transfer where no optimum was found
    lower_bound: Float[Array, "n"]  # proven lower bound on the fuel of each craft, m/s²
    feasible: Marked  # whether an optimum was found
    # whether it is proven that the craft cannot make the transfer within the thrust limit, or with
    # any thrust; what is neither the solver failed at
    impossible: Marked
    tabled: Marked  # whether the bound is a vertex's of the table, or a program's
    basis: Int[Array, "n 6"] | None = None  # as in ``Subproblem``, without a thrust limit

    def bound(self, craft: slice = slice(None)) -> tuple[float, str]:
        """Lower bound on the fuel of some craft in all, m/s², and how it is proven."""
        proof = TABLE if self.tabled[craft].all() else PROGRAM
        return float(self.lower_bound[craft].sum()), proof


def decoupled_optima(
    initial: Formation,
    goal: Formation,
    problem: Problem,
    limits: Limits | None = None,
    arrivals: Arrivals | None = None,
) -> DecoupledOptima:
    """Least fuel that joins the two states of each craft, m and m/s.

    By table where the optimum without a thrust limit keeps to it, for then it is the optimum with
    it too; the others by one linear program each. With limits of each craft, by cone programs, and
    perhaps to other places than their goals.
    """
    if limits is not None:
        at = arrivals or arrivals_of(initial, goal, problem, {})
        return limited_optima(minimum_energy(initial, goal, problem), at, problem, limits)
    miss = goal_miss(initial, goal, problem)
    controls, bound = minimum_energy(initial, goal, problem), np.zeros(len(miss))
    feasible, impossible = np.zeros((2, len(miss)), dtype=bool)
    found = least_fuel(miss, problem)
    if found is not None:
        within = np.abs(found.controls).max(axis=(1, 2)) <= control_limit(problem)
        feasible = found.exact & within
        controls[feasible], bound[:] = found.controls[feasible], found.bound
    tabled = np.full(len(miss), found is not None)
    for k in np.flatnonzero(~feasible):
        alone, dual = _solve_alone(miss[k], problem)
        if alone is None:
            impossible[k] = _is_impossible(dual, miss[k], problem)
            continue
        proven = _dual_bound(dual, miss[k], problem)
        tabled[k] &= proven <= bound[k]
        feasible[k], controls[k], bound[k] = True, alone, max(bound[k], proven)
    exact = meet_goal(initial, controls, goal, problem)
    basis = None if found is None else found.basis
    return DecoupledOptima(exact, bound, feasible, impossible, tabled, basis)


def limited_optima(
    controls: Controls, at: Arrivals, problem: Problem, limits: Limits
) -> DecoupledOptima:
    """Decoupled optima by a cone program of all craft, and of each where that proves too little.

    The controls given are those of craft for which none are found.
    """
    n = len(at)
    controls, bound = controls.copy(), np.zeros(n)
    feasible, not_possible, tight = np.zeros((3, n), dtype=bool)
    for craft in [slice(0, n), *(slice(k, k + 1) for k in range(n * (n > 1)))]:
        if tight[craft].all():
            continue
        found, duals = least_of(at[craft], limits[craft], problem)
        if found is None:
            alone = craft.stop - craft.start == 1
            not_possible[craft] |= alone and impossible(duals, at[craft], limits[craft], problem)
            continue
        feasible[craft] = True
        controls[craft] = settled(found, at[craft], limits[craft], problem)
        bound[craft] = dual_bounds(duals, at[craft], limits[craft], problem)
        # Where misses are of very different sizes, the small are lost in the rounding.
        fuel = cost(controls[craft], problem.thrust).sum(axis=1)
        tight[craft] = fuel - bound[craft] <= LOOSE * fuel + problem.negligible_fuel
    spent = bound * problem.time_step
    not_possible |= spent > limits.delta_v * (1 + FARKAS_MARGIN)
    return DecoupledOptima(
        controls, bound, feasible & ~not_possible, not_possible, np.zeros(n, dtype=bool)
    )


def goal_miss(initial: Formation, goal: Formation, problem: Problem) -> Formation:
    """Change of final state that the controls of each craft must bring about, m and m/s."""
    return goal - np.matvec(transfer_maps(problem).drift[-1], initial)


def control_units(miss: Formation, problem: Problem) -> Float[Array, "n"]:
    """Size of a typical control, m/s²: of each transfer, or to move by the collision radius."""
    return np.maximum(_largest_control(miss, problem), problem.evasive_control)


def _largest_control(miss: Formation, problem: Problem) -> Float[Array, "n"]:
    """Largest control of each craft's minimum-energy transfer, m/s²."""
    return np.abs(np.matvec(transfer_maps(problem).to_goal, miss)).max(axis=1)


def control_limit(problem: Problem) -> float:
    """The thrust limit that programs are given, m/s²; infinite where there is none."""
    return np.inf if problem.max_acceleration is None else problem.max_acceleration * LIMIT_SHARE


def _solve_alone(
    miss: Float[Array, "6"], problem: Problem
) -> tuple[Float[Array, "intervals 3"] | None, Float[Array, "6"]]:
    """One craft's linear program: its controls, m/s², or None, and the goal's dual variables."""
    unit = float(_largest_control(miss[None], problem)[0])
    none: Int[Array, 0] = np.zeros(0, dtype=int)
    sub = Subproblem(
        reach=transfer_maps(problem).reach[-1],
        miss=miss[None],
        first=none,
        second=none,
        row=np.zeros((0, 3 * problem.intervals)),
        required=np.zeros(0),
        limit=control_limit(problem),
        penalty=0.0,
        unit=unit if unit > problem.negligible_fuel else problem.evasive_control,
    )
    # A new solver each time: one that has solved before rounds otherwise.
    found = clarabel_solver(sub, tolerance=BOUND_TOLERANCE).solve()
    dual = -np.asarray(found.z)[:6] * sub.goal_scale * sub.unit
    if str(found.status) not in OPTIMAL:
        return None, dual
    return sub.controls_of(np.asarray(found.x)).reshape(-1, 3), dual


def _dual_bound(y: Float[Array, "6"], miss: Float[Array, "6"], problem: Problem) -> float:
    """The lower bound on the fuel, m/s², that any dual variables prove (weak duality).

    It is missᵀy - limit · Σ max(|reachᵀy| - 1, 0), and also missᵀy where y is shrunk until
    |reachᵀy| ≤ 1.
    """
    size, limit = np.abs(transfer_maps(problem).reach[-1].T @ y), problem.max_acceleration
    bound = float(miss @ y) / max(1.0, float(size.max()))
    if limit is not None:
        bound = max(bound, float(miss @ y - limit * np.maximum(size - 1, 0).sum()))
    return max(bound, 0.0)


def _is_impossible(y: Float[Array, "6"], miss: Float[Array, "6"], problem: Problem) -> bool:
    """Whether it is proven that no controls bring about a change of state.

    Any controls with |u| ≤ limit reach at most limit · ‖reachᵀy‖₁ along y (Farkas' lemma). So it
    is along the dual variables y, and, for the largest limit that a problem may have, along the
    directions in which controls as good as do nothing, as where two of an orbit's intervals act
    alike.
    """
    reach, limit = transfer_maps(problem).reach[-1], problem.max_acceleration
    if limit is not None and np.isfinite(y).all():
        most = limit * float(np.abs(reach.T @ y).sum())
        if float(miss @ y) > most * (1 + FARKAS_MARGIN):
            return True
    scale = acceleration_scale(problem)
    directions = np.linalg.svd(reach * scale[:, None])[0].T * scale
    changes = np.abs(directions @ miss)
    furthest = RANGES["max_acceleration"][1] * np.abs(directions @ reach).sum(axis=1)
    return bool((changes > furthest + SHORT * np.abs(miss * scale).max()).any())
