"""The subproblem as a second-order cone program: thrust that is more than axes with one limit.

Every control that may be, of a craft in an interval in which it may burn, is u = E z:

- thrusters of given directions, the columns of E: z ≥ 0 are their thrusts, and cost their sum; each
  at most the limit, and ‖E z‖₂ at most the limit on the norm;
- one thruster that is pointed: z is u and t ≥ ‖u‖₂, and costs t; |u| and t at most the limits.

Controls that may not be are no variables. Besides the rows of ``subproblem``, a craft may spend no
more than it has left. Where the largest share of that is to be least, it is a variable, above the
share of each craft.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import clarabel
import numpy as np
from jaxtyping import Float, Int
from scipy import sparse

from pipeline.arrays import Array
from pipeline.expert.solvers import OPTIMAL, clarabel_settings
from pipeline.expert.subproblem import LENGTH, Optimum, Subproblem, UnsolvableError
from pipeline.orbit.arrays import Values
from pipeline.orbit.thrust import COMPONENTS

FUEL_SHARE = 1e-4  # of the fuel of all that counts beside the largest share, so that one is best
TOLERANCE = 1e-9  # relative: what rounding leaves in a cone is far below the smallest burn

Rows = tuple[sparse.csr_array, Values]  # left-hand sides A and right-hand sides b


@dataclass(frozen=True, eq=False)
class ConicProgram:
    """One subproblem with thrust of any kind, in scaled variables."""

    sub: Subproblem

    @cached_property
    def slots(self) -> tuple[Int[Array, "S"], Int[Array, "S"]]:
        """Craft and interval of every control that may be."""
        assert self.sub.limits is not None
        craft, interval = np.nonzero(self.sub.limits.burns.any(axis=2))
        return craft, interval

    @cached_property
    def kept(self) -> Int[Array, "v"]:
        """Numbers of the variables that may be other than zero."""
        assert self.sub.limits is not None
        S, V = len(self.slots[0]), len(self.price)
        may = np.ones((S, V), dtype=bool)
        if self.sub.thrust.model == COMPONENTS:
            may = np.tile(self.sub.limits.burns[self.slots], 2)
        others = np.arange(S * V, self.variables)
        return np.concatenate([np.flatnonzero(may), others])

    @cached_property
    def effect(self) -> Float[Array, "3 V"]:
        """E, from the variables of a control to it."""
        directions = self.sub.thrust.directions
        if directions is None:
            return np.hstack([np.eye(3), np.zeros((3, 1))])
        return directions.T

    @cached_property
    def price(self) -> Float[Array, "V"]:
        """What each variable of a control costs."""
        return np.array([0.0, 0.0, 0.0, 1.0]) if self.pointed else np.ones(self.effect.shape[1])

    @property
    def pointed(self) -> bool:
        """Whether there is one thruster, which is pointed."""
        return self.sub.thrust.directions is None

    @property
    def fair(self) -> bool:
        """Whether the largest share is least, and not the fuel of all."""
        return self.sub.thrust.objective == "fair" and self.sub.weight is not None

    @property
    def variables(self) -> int:
        """Number of variables: those of controls, slacks, and perhaps the largest share."""
        return len(self.slots[0]) * len(self.price) + len(self.sub.required) + self.fair

    def cost(self) -> Float[Array, "v"]:
        """Cost of each variable."""
        spent = np.tile(self.price, len(self.slots[0]))
        slack = np.full(len(self.sub.required), self.sub.penalty * LENGTH / self.sub.unit)
        if self.fair:
            return np.concatenate([FUEL_SHARE * spent, slack, [1.0]])
        return np.concatenate([spent, slack])

    def _wide(self, block: Any, first: int = 0) -> sparse.csr_array:
        """A block whose first column is that variable, with zeros for the other variables."""
        rows = block.shape[0]
        left = sparse.csr_array((rows, first))
        right = sparse.csr_array((rows, self.variables - first - block.shape[1]))
        return sparse.csr_array(sparse.hstack([left, block, right]))

    def goals(self) -> Rows:
        """Every craft meets its goal, and passes its waypoints."""
        sub, (craft, interval) = self.sub, self.slots
        (n, m, _), r = sub.shape, len(sub.reach)
        scale = sub.goal_scale * sub.unit
        reach = (sub.reach * scale[:, None]).reshape(r, m // 3, 3)[:, interval] @ self.effect
        row = np.broadcast_to(r * craft[None, :, None] + np.arange(r)[:, None, None], reach.shape)
        rows, wanted = self._wide(self._by_slot(reach, row, r * n)), sub.goals()
        if sub.asked is None or sub.asked.all():
            return rows, wanted
        asked = sub.asked.ravel()
        return rows[asked], wanted[asked]

    def _by_slot(
        self, value: Float[Array, "r S V"], row: Int[Array, "r S V"], rows: int
    ) -> sparse.csr_array:
        """Entries in the rows given of the variables of every slot."""
        column = np.broadcast_to(
            np.arange(value.shape[1] * value.shape[2]).reshape(value.shape[1:]), value.shape
        )
        entries = value.ravel(), (row.ravel(), column.ravel())
        made = sparse.csr_array(entries, shape=(rows, value.shape[1] * value.shape[2]))
        made.eliminate_zeros()
        return made

    def half_spaces(self) -> Rows:
        """Pairs apart, as rows that are at most b."""
        sub, (craft, interval) = self.sub, self.slots
        _, m, k = sub.shape
        other = sub.row if sub.other is None else sub.other
        value = np.zeros((k, len(craft), len(self.price)))
        for of, row, sign in ((sub.first, sub.row, 1.0), (sub.second, other, -1.0)):
            r, s = np.nonzero(of[:, None] == craft)
            value[r, s] += sign * row.reshape(k, m // 3, 3)[r, interval[s]] @ self.effect
        row = np.broadcast_to(np.arange(k)[:, None, None], value.shape)
        controls = self._by_slot(-value * (sub.unit / LENGTH), row, k)
        slack = -sparse.eye_array(k)
        rows = self._wide(sparse.hstack([controls, slack]))
        return rows, -sub.required / LENGTH

    def spending(self) -> Rows:
        """No craft spends more than it has left, nor, where that is asked for, a larger share."""
        sub, (craft, _) = self.sub, self.slots
        assert sub.limits is not None
        n = len(sub.miss)
        value = np.broadcast_to(self.price, (1, len(craft), len(self.price)))
        row = np.broadcast_to(craft[None, :, None], value.shape)
        spent = self._wide(self._by_slot(value, row, n))
        left = sub.limits.delta_v / (sub.time_step * sub.unit)
        some = np.isfinite(left)
        rows, most = [spent[some]], [left[some]]
        if self.fair:
            assert sub.weight is not None
            column = sparse.csr_array(-np.ones((n, 1)))
            weighted = sparse.diags_array(sub.weight) @ spent
            rows.append(weighted + self._wide(column, self.variables - 1))
            most.append(np.zeros(n))
        return sparse.csr_array(sparse.vstack(rows)), np.concatenate(most)

    def bounds(self) -> Rows:
        """Signs of thrusts and slacks, and limits of components or thrusters."""
        sub, (craft, _) = self.sub, self.slots
        assert sub.limits is not None
        S, V, k = len(craft), len(self.price), len(sub.required)
        most = np.repeat(sub.limits.component[craft] / sub.unit, V).reshape(S, V)
        signed = np.arange(S * V, S * V + k)
        if self.pointed:
            most[:, 3] = sub.limits.norm[craft] / sub.unit
        else:
            signed = self.kept[self.kept < S * V + k]
        limits = most.ravel()
        above = np.flatnonzero(np.isfinite(limits))
        above = above[np.isin(above, self.kept)]
        below = above[above % V < 3] if self.pointed else above[:0]  # components have two
        signs = (signed, -1), (above, 1), (below, -1)
        rows = sparse.vstack([sign * _rows_of(which, self.variables) for which, sign in signs])
        return sparse.csr_array(rows), np.concatenate([0.0 * signed, limits[above], limits[below]])

    def cones(self) -> tuple[sparse.csr_array, Values, int]:
        """(t, u) in the second-order cone, by rows of four, and their number."""
        sub, (craft, _) = self.sub, self.slots
        assert sub.limits is not None
        S, V = len(craft), len(self.price)
        if self.pointed:
            order = (V * np.arange(S)[:, None] + [3, 0, 1, 2]).ravel()
            return -_rows_of(order, self.variables), np.zeros(4 * S), S
        some = np.flatnonzero(np.isfinite(sub.limits.norm[craft]))
        block = sparse.csr_array(np.vstack([np.zeros(V), -self.effect]))
        rows = self._wide(sparse.kron(_rows_of(some, S), block))
        b = np.zeros((len(some), 4))
        b[:, 0] = sub.limits.norm[craft[some]] / sub.unit
        return rows, b.ravel(), len(some)

    def solver(self, tolerance: float, *, careful: bool) -> clarabel.DefaultSolver:
        """Clarabel with A x + s = b: goals, bounds, spending, half-spaces, cones."""
        parts = [self.goals(), self.bounds(), self.spending(), self.half_spaces()]
        A, b, count = self.cones()
        equal = parts[0][0].shape[0]
        inequal = sum(rows.shape[0] for rows, _ in parts[1:])
        cones = [clarabel.ZeroConeT(equal), clarabel.NonnegativeConeT(inequal)]
        cones += [clarabel.SecondOrderConeT(4)] * count
        rows = sparse.csc_matrix(sparse.vstack([*(part for part, _ in parts), A]))[:, self.kept]
        wanted = np.concatenate([*(part for _, part in parts), b])
        quadratic = sparse.csc_matrix((len(self.kept), len(self.kept)))
        settings = clarabel_settings(tolerance, careful=careful)
        return clarabel.DefaultSolver(
            quadratic, self.cost()[self.kept], rows, wanted, cones, settings
        )

    def solved(self, x: Values) -> Float[Array, "v"]:
        """All variables, from those that may be other than zero."""
        found = np.zeros(self.variables)
        found[self.kept] = x
        return found

    def controls_of(self, x: Float[Array, "v"]) -> Float[Array, "n m"]:
        """Controls in m/s² from the variables."""
        craft, interval = self.slots
        n, m, _ = self.sub.shape
        controls = np.zeros((n, m // 3, 3))
        S, V = len(craft), len(self.price)
        z = x[: S * V].reshape(S, V)
        controls[craft, interval] = self.sub.unit * z @ self.effect.T
        return controls.reshape(n, m)

    def half_space_duals(self, z: Float[Array, "rows"]) -> Float[Array, "k"]:
        """Dual variables of the half-spaces, of those of all rows."""
        k, (_, _, count) = len(self.sub.required), self.cones()
        end = len(z) - 4 * count
        return z[end - k : end]

    def splits(self, z: Values) -> Float[Array, "n intervals 3"]:
        """The part of what each control does along the goals' duals that its cone pays for."""
        sub, (craft, interval) = self.sub, self.slots
        assert sub.limits is not None
        some = np.full(len(craft), self.pointed) | np.isfinite(sub.limits.norm[craft])
        found = np.zeros((len(sub.miss), sub.reach.shape[1] // 3, 3))
        found[craft[some], interval[some]] = -z[len(z) - 4 * some.sum() :].reshape(-1, 4)[:, 1:]
        return found


def _rows_of(columns: Any, width: int) -> sparse.csr_array:
    """Rows with a one in the columns given."""
    rows = np.arange(len(columns))
    return sparse.csr_array((np.ones(len(columns)), (rows, columns)), shape=(len(rows), width))


def by_cones(sub: Subproblem) -> Optimum:
    """The optimum of a subproblem with thrust of any kind; UnsolvableError where there is none."""
    program = ConicProgram(sub)
    for careful in (False, True):
        found = program.solver(TOLERANCE, careful=careful).solve()
        if str(found.status) in OPTIMAL:
            x, z = program.solved(np.asarray(found.x)), np.asarray(found.z)
            k = len(sub.required)
            top = len(program.slots[0]) * len(program.price)
            dual = sub.unit / LENGTH * program.half_space_duals(z)
            return Optimum(program.controls_of(x), LENGTH * x[top : top + k], dual)
    raise UnsolvableError(f"the convex solver stopped with {found.status}")
