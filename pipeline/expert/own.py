"""Each craft's own optimum, the others ignored: the SCP's start and the bound no plan beats."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.arrays import Array
from pipeline.expert.interior_point import OPTIMAL, new_solver
from pipeline.expert.split import controls_of
from pipeline.expert.subproblem import Subproblem
from pipeline.orbit.decoupled import least_fuel
from pipeline.orbit.problem import RANGES, Problem
from pipeline.orbit.transfer import meet_goal, minimum_energy, transfer_maps

BOUND_TOLERANCE = 1e-8
"""Relative tolerance of the programs of single craft, and so of their lower bound."""

SHORT = 1e-6
"""Share of a change of state that may be rounding."""

FARKAS_MARGIN = 1e-6
"""Relative margin by which a proof of impossibility must hold, beyond rounding."""

TABLE = "a dual vertex of each craft's own linear program, by table"
PROGRAM = "multipliers of each craft's own linear program"
"""How a lower bound is proven."""

LIMIT_SHARE = 1 - 1e-7
"""Share of the thrust limit that the programs use, so that rounding stays within it."""


@dataclass(frozen=True, eq=False)
class OwnOptima:
    """The L1-optimal transfer of each craft on its own.

    Attributes:
        controls: (n, T-1, 3), m/s²; the minimum-energy transfer where there is no optimum.
        lower_bound: proven lower bound on the fuel of each craft, (n,), m/s².
        feasible: whether an optimum was found, (n,).
        impossible: whether it is proven that the craft cannot make the transfer within the
            thrust limit, or with any thrust, (n,); what is neither the solver failed at.
        tabled: whether the bound is a vertex's of the table, (n,), or a program's.
        basis: basic variables without a thrust limit, as in ``Subproblem``, where they are known.
    """

    controls: Float[Array, "n intervals 3"]
    lower_bound: Float[Array, "n"]
    feasible: Bool[Array, "n"]
    impossible: Bool[Array, "n"]
    tabled: Bool[Array, "n"]
    basis: Int[Array, "n 6"] | None = None

    def of(self, craft: Bool[Array, "n"]) -> "OwnOptima":
        """Those of some craft."""
        basis = None if self.basis is None else self.basis[craft]
        return OwnOptima(
            self.controls[craft],
            self.lower_bound[craft],
            self.feasible[craft],
            self.impossible[craft],
            self.tabled[craft],
            basis,
        )

    def bound(self, craft: slice) -> tuple[float, str]:
        """What some craft need at least in all, m/s², and how that is proven."""
        proof = TABLE if self.tabled[craft].all() else PROGRAM
        return float(self.lower_bound[craft].sum()), proof


def goal_miss(
    initial: Float[Array, "n 6"], goal: Float[Array, "n 6"], problem: Problem
) -> Float[Array, "n 6"]:
    """Change of final state that the controls of each craft must bring about."""
    return goal - np.matvec(transfer_maps(problem).drift[-1], initial)


def control_units(miss: Float[Array, "n 6"], problem: Problem) -> Float[Array, "n"]:
    """Size of a typical control, m/s²: of each transfer, or to move by the collision radius."""
    return np.maximum(own_units(miss, problem), problem.evasive_control)


def own_units(miss: Float[Array, "n 6"], problem: Problem) -> Float[Array, "n"]:
    """Largest control of each craft's minimum-energy transfer, m/s², which no limit must exceed."""
    return np.abs(np.matvec(transfer_maps(problem).to_goal, miss)).max(axis=1)


def control_limit(problem: Problem) -> float:
    """The thrust limit that programs are given, m/s²; infinite where there is none."""
    return np.inf if problem.max_acceleration is None else problem.max_acceleration * LIMIT_SHARE


def own_optima(
    initial: Float[Array, "n 6"], goal: Float[Array, "n 6"], problem: Problem
) -> OwnOptima:
    """Least ‖u‖₁ that joins the two states of each craft.

    By table where the optimum without a thrust limit keeps to it, for then it is the optimum with
    it too; the others by one linear program each.
    """
    miss = goal_miss(initial, goal, problem)
    controls, bound = minimum_energy(initial, goal, problem), np.zeros(len(miss))
    feasible, impossible = np.zeros((2, len(miss)), dtype=bool)
    found = least_fuel(miss, problem)
    if found is not None:
        within = np.abs(found.controls).max(axis=(1, 2)) <= control_limit(problem)
        feasible = found.exact & within
        controls[feasible], bound[:] = found.controls[feasible], found.bound
    tabled = np.full(len(miss), found is not None)
    for k, one in zip(np.flatnonzero(~feasible), _programs(miss[~feasible], problem), strict=True):
        feasible[k], impossible[k] = one.controls is not None, one.impossible
        tabled[k] &= one.bound <= bound[k]
        bound[k] = max(bound[k], one.bound)
        if one.controls is not None:
            controls[k] = one.controls
    exact = meet_goal(initial, controls, goal, problem)
    basis = None if found is None else found.basis
    return OwnOptima(exact, bound, feasible, impossible, tabled, basis)


@dataclass(frozen=True, eq=False)
class _Program:
    """What the linear program of one craft gave."""

    controls: Float[Array, "intervals 3"] | None
    bound: float = 0.0
    impossible: bool = False


def _programs(miss: Float[Array, "n 6"], problem: Problem) -> Iterator[_Program]:
    """Solve one linear program a craft.

    The bound is not the solver's optimum but what its multipliers prove: for any y,
    missᵀy - limit · Σ max(|reachᵀy| - 1, 0) is a lower bound, and so is missᵀy where y is
    shrunk until |reachᵀy| ≤ 1 (linear programming duality).
    """
    reach, limit = transfer_maps(problem).reach[-1], problem.max_acceleration
    units = own_units(miss, problem)
    units = np.where(units > problem.negligible_fuel, units, problem.evasive_control)
    for wanted, unit in zip(miss, units.tolist(), strict=True):
        one = _single(reach, wanted[None], control_limit(problem), unit)
        # A new solver each time: one that has solved before rounds otherwise.
        found = new_solver(one, tolerance=BOUND_TOLERANCE).solve()
        y = -np.asarray(found.z)[:6] * one.goal_scale * unit
        if str(found.status) in OPTIMAL:
            controls = controls_of(np.asarray(found.x), one).reshape(-1, 3)
            yield _Program(controls, _proven(y, wanted, reach, limit))
        else:
            impossible = _refutes(y, wanted, reach, limit) or _unreachable(wanted, reach, problem)
            yield _Program(None, impossible=impossible)


def _single(
    reach: Float[Array, "6 m"], miss: Float[Array, "1 6"], limit: float, unit: float
) -> Subproblem:
    none: Int[Array, 0] = np.zeros(0, dtype=int)
    rows = np.zeros((0, reach.shape[1]))
    return Subproblem(reach, miss, none, none, rows, np.zeros(0), limit, 0.0, unit)


def _proven(
    y: Float[Array, "6"],
    miss: Float[Array, "6"],
    reach: Float[Array, "6 m"],
    limit: float | None,
) -> float:
    price = np.abs(reach.T @ y)
    bound = float(miss @ y) / max(1.0, float(price.max()))
    if limit is not None:
        bound = max(bound, float(miss @ y - limit * np.maximum(price - 1, 0).sum()))
    return max(bound, 0.0)


def _refutes(
    y: Float[Array, "6"],
    miss: Float[Array, "6"],
    reach: Float[Array, "6 m"],
    limit: float | None,
) -> bool:
    """Whether multipliers prove that no controls within the limit bring about a change of state.

    Any controls with |u| ≤ limit reach at most limit · ‖reachᵀy‖₁ along y (Farkas' lemma).
    """
    if limit is None or not np.isfinite(y).all():
        return False
    most = limit * float(np.abs(reach.T @ y).sum())
    return float(miss @ y) > most * (1 + FARKAS_MARGIN)


def _unreachable(miss: Float[Array, "6"], reach: Float[Array, "6 m"], problem: Problem) -> bool:
    """Whether no control that a thruster could give brings about a change of state.

    As in ``_refutes``, along the directions in which controls as good as do nothing, as where two
    of an orbit's intervals act alike.
    """
    scale = np.repeat([1.0, problem.duration], 3) / problem.duration**2  # all in m/s²
    directions = np.linalg.svd(reach * scale[:, None])[0].T * scale
    changes = np.abs(directions @ miss)
    most = RANGES["max_acceleration"][1] * np.abs(directions @ reach).sum(axis=1)
    return bool((changes > most + SHORT * np.abs(miss * scale).max()).any())
