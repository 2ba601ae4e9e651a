"""What thrusters of a scenario may do, what a plan makes them do, and the least that they need."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import chain, combinations
from typing import Any
from warnings import catch_warnings, simplefilter

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import eye, kron

SHARE = 1e-6
"""Relative difference of forces and fuels that counts as rounding."""

FIELDS = ("max_acceleration_norm", "min_delta_v", "no_burn", "objective", "craft")
"""Fields of scenario.json that say more of thrust than max_acceleration; an objective "total" says
nothing more."""


@dataclass(frozen=True)
class Thrusters:
    """Of n craft; m/s² and m/s, infinite where there is no limit.

    Attributes:
        model: "components", "norm" or unit vectors (K, 3).
        component: limit of a component or thruster of each craft.
        norm: limit of the norm of each craft's control.
        budget: Δv of each craft.
        open: whether a craft may burn in an interval, (n, T-1).
        bit: least Δv of a burn; 0 where any is.
        fair: whether the largest share of its budget that a craft burns is to be least.
    """

    model: str | np.ndarray
    component: np.ndarray
    norm: np.ndarray
    budget: np.ndarray
    open: np.ndarray
    bit: float
    fair: bool

    @classmethod
    def of(cls, document: Mapping[str, Any], n: int) -> "Thrusters | None":
        """Those of the fields of scenario.json; None where max_acceleration is all of it."""
        model = document.get("thrust") or "components"
        said = [document.get(name) for name in FIELDS]
        if model == "components" and all(one == "total" or not one for one in said):
            return None
        craft: Sequence[Mapping[str, Any]] = document.get("craft") or [{}] * n
        step, intervals = document["time_step"], document["nodes"] - 1
        may = np.ones((n, intervals), dtype=bool)
        for k, one in enumerate(craft):
            for begin, end in [*(document.get("no_burn") or ()), *(one.get("no_burn") or ())]:
                for interval in range(intervals):
                    overlap = min(end, (interval + 1) * step) - max(begin, interval * step)
                    may[k, interval] &= overlap <= 0

        def own(name: str) -> np.ndarray:
            of_all = document.get(name)
            given = [of_all if one.get(name) is None else one[name] for one in craft]
            return np.array([np.inf if one is None else one for one in given], dtype=float)

        return cls(
            model if isinstance(model, str) else np.asarray(model, dtype=float),
            own("max_acceleration"),
            own("max_acceleration_norm"),
            own("delta_v"),
            may,
            document.get("min_delta_v") or 0.0,
            document.get("objective") == "fair",
        )

    @property
    def bit_counts(self) -> bool:
        """Whether lower bounds account for the minimum impulse bit: not for a pointed thruster."""
        return self.bit > 0 and not (isinstance(self.model, str) and self.model == "norm")

    def firings(self, controls: np.ndarray) -> np.ndarray:
        """Thrust of each thruster, (n, T-1, K): what gives a control at the least sum."""
        if isinstance(self.model, str):
            by_norm = np.linalg.norm(controls, axis=2, keepdims=True)
            return by_norm if self.model == "norm" else np.abs(controls)
        found = np.zeros((*controls.shape[:2], len(self.model)))
        burns = np.nonzero(np.abs(controls).max(axis=2))
        if len(burns[0]):
            size = np.abs(controls[burns]).max(axis=1, keepdims=True)
            most = self.component[burns[0], None] * (1 + SHARE) / size
            found[burns] = size * _least_sums(controls[burns] / size, self.model, most)
        return found

    def spent(self, controls: np.ndarray) -> np.ndarray:
        """Fuel of each craft, m/s²."""
        return np.asarray(self.firings(controls).sum(axis=(1, 2)))

    def faults(self, controls: np.ndarray, step: float) -> Iterator[str]:
        """What thrusters must not do and do, in words."""
        fired = self.firings(controls)
        size = np.linalg.norm(controls, axis=2)
        each = np.abs(controls) if isinstance(self.model, str) else fired
        for what, used, limit in (
            ("component", each.max(axis=(1, 2)), self.component),
            ("norm", size.max(axis=1), self.norm),
            ("budget", step * fired.sum(axis=(1, 2)), self.budget),
        ):
            for k in np.flatnonzero(used > limit * (1 + 2 * SHARE)):
                yield f"craft {k} uses {used[k]:.9g} of its {what} {limit[k]:.9g}"
        for k in np.flatnonzero(((size > 0) & ~self.open).any(axis=1)):
            yield f"craft {k} burns where it must not"
        for k in np.flatnonzero(self.smaller(controls, self.bit / step).any(axis=1)):
            yield f"craft {k} burns less than {self.bit:g} m/s"

    def smaller(self, controls: np.ndarray, thrust: float) -> np.ndarray:
        """Whether each control needs a thrust below a given one at the least sum, (n, T-1)."""
        fired = self.firings(controls)
        burns = fired > (0 if isinstance(self.model, str) else SHARE) * fired.max(2, keepdims=True)
        found = np.asarray((burns & (fired < thrust * (1 - SHARE))).any(axis=2))
        if not isinstance(self.model, str):
            for k, t in np.argwhere(found):
                most = self.component[k] * (1 + SHARE)
                found[k, t] = not _fires_within(controls[k, t], self.model, thrust, most)
        return found

    def least(self, k: int, reach: np.ndarray, miss: np.ndarray, unit: float) -> float:
        """Least fuel of craft k, in units, with reach · u = miss; infinite where none does."""
        import cvxpy as cp  # slow to import, and few scenarios need it

        limits = {"component": self.component[k] / unit, "norm": self.norm[k] / unit}
        limits = {name: float(one) for name, one in limits.items() if np.isfinite(one)}
        model = (
            self.model if isinstance(self.model, str) else tuple(map(tuple, self.model.tolist()))
        )
        closed = tuple(np.flatnonzero(~self.open[k]).tolist())
        program, given = _program(model, reach.shape, closed, tuple(limits))
        for name, value in {"reach": reach, "miss": miss, **limits}.items():
            given[name].value = value
        tolerances = {"tol_gap_rel": 1e-10, "tol_gap_abs": 1e-12, "tol_feas": 1e-10}
        with catch_warnings():  # where so small tolerances are not met, nearly so is enough
            simplefilter("ignore", UserWarning)
            program.solve(solver=cp.CLARABEL, warm_start=False, **tolerances)
        if program.status in ("infeasible", "infeasible_inaccurate"):
            return np.inf
        if program.value is None:
            raise ArithmeticError(f"Clarabel cannot tell the least fuel: {program.status}")
        return float(program.value)


@cache
def _program(
    model: str | tuple[tuple[float, ...], ...],
    shape: tuple[int, int],
    closed: tuple[int, ...],
    limited: tuple[str, ...],
) -> tuple[Any, dict[str, Any]]:
    """The program for the least fuel of a craft, and its parameters: cvxpy takes long to make it.

    It may not burn in intervals that are closed; limits of component and norm are named if any.
    """
    import cvxpy as cp

    m = shape[1] // 3
    given = {"reach": cp.Parameter(shape), "miss": cp.Parameter(shape[0])}
    given |= {name: cp.Parameter(nonneg=True) for name in limited}
    if isinstance(model, str):
        control = cp.Variable((m, 3))
        cost = cp.norm(control, 1 if model == "components" else 2, axis=1)
        thrust = cp.abs(control)
    else:
        thrust = cp.Variable((m, len(model)), nonneg=True)
        control, cost = thrust @ np.array(model), cp.sum(thrust, axis=1)
    limits = [given["reach"] @ cp.vec(control, order="C") == given["miss"]]
    if "component" in limited:
        limits.append(thrust <= given["component"])
    if "norm" in limited:
        limits.append(cp.norm(control, 2, axis=1) <= given["norm"])
    limits += [thrust[t] <= 0 for t in closed]
    return cp.Problem(cp.Minimize(cp.sum(cost)), limits), given


def _fires_within(wanted: np.ndarray, model: np.ndarray, least: float, most: float) -> bool:
    """Whether thrusts of least sum, each zero or within a range, produce a vector.

    Tries all sets of the thrusters which by the least sum's dual variables may fire.
    """
    size = np.abs(wanted).max()
    ones, given, top = np.ones(len(model)), wanted / size, most / size
    cheapest = linprog(ones, A_eq=model.T, b_eq=given, bounds=(0, top))
    if cheapest.fun is None:
        return False
    may_fire = np.flatnonzero(1 - model @ cheapest.eqlin.marginals < SHARE)
    sets = chain.from_iterable(combinations(may_fire, k) for k in range(1, len(may_fire) + 1))
    bottom = least / size * (1 - SHARE)
    for some in map(list, sets):
        found = linprog(ones[some], A_eq=model[some].T, b_eq=given, bounds=(bottom, top))
        if found.fun is not None and found.fun <= cheapest.fun * (1 + SHARE):
            return True
    return False


def _least_sums(wanted: np.ndarray, model: np.ndarray, most: np.ndarray) -> np.ndarray:
    """Thrusts (n, K) of least sums that give vectors (n, 3), at most (n, 1) where they can."""
    n, K = len(wanted), len(model)
    given: dict[str, Any] = {"A_eq": kron(eye(n), model.T, format="csc"), "b_eq": wanted.ravel()}
    for limit in (most, np.full((n, 1), np.inf)):
        solved = linprog(np.ones(n * K), **given, bounds=[(0, one) for one in limit.repeat(K)])
        if solved.status == 0:
            return np.asarray(solved.x).reshape(n, K)
        if n > 1:
            pairs = zip(wanted[:, None], most[:, None], strict=True)
            return np.concatenate([_least_sums(one, model, its) for one, its in pairs])
    raise ArithmeticError(f"HiGHS cannot tell what thrusters fire: {solved.message}")
