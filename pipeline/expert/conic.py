"""The subproblem as a second-order cone program, for all thruster models and limits.

Every control of a craft in an interval in which it may burn is u = E z:

- thrusters of given directions, the columns of E: z ≥ 0 are their thrusts, and cost their sum; each
  is at most the limit, and ‖E z‖₂ at most the limit on the norm;
- one thruster that is pointed: z is u and t ≥ ‖u‖₂, and costs t; |u| and t are at most the limits.

Other controls are no variables. Besides the rows of ``subproblem``, the Δv of a craft is limited to
what it has left. Where the largest share of that is minimized, it is a variable that bounds the
share of each craft.
"""

from collections.abc import Sequence
from typing import Any

import clarabel
import numpy as np

from pipeline.arrays import Array, Float, Int
from pipeline.expert.subproblem import LENGTH, NEGLIGIBLE, Optimum, Subproblem, UnsolvableError
from pipeline.orbit.arrays import Values
from pipeline.orbit.problem import LIMIT_ROUNDING
from pipeline.orbit.thrust import COMPONENTS, Limits

# Clarabel's statuses of a solution, and of an infeasible program
OPTIMAL, IMPOSSIBLE = ("Solved", "AlmostSolved"), "PrimalInfeasible"
FUEL_SHARE = 1e-4  # weight of total fuel beside the largest share, which makes optima unique
TOLERANCE = 1e-9  # relative: what rounding leaves in a cone is far below the smallest burn
FEW, MANY = 4, 200  # craft at most, and half-spaces at least, of a program that is solved by cuts
WORST = 40  # half-spaces that a round of cuts adds at most
VIOLATED = 1e-7  # violation, m, from which a half-space is added

# Row, column and value of entries of A, and the values of b in these rows
Parts = tuple[Int[Array, "_"], Int[Array, "_"], Float[Array, "_"]]
Block = tuple[Parts, Float[Array, "_"]]


class ConicProgram:
    """The cone program of one subproblem, in scaled variables."""

    def __init__(self, sub: Subproblem) -> None:
        self.sub, (n, m, k), directions = sub, sub.shape, sub.thrust.directions
        # Limits of each craft; made from the subproblem's single limit where it has none.
        none, burns = np.full(n, np.inf), np.ones((n, m // 3, 3), dtype=bool)
        self.limits = sub.limits or Limits(np.full(n, sub.limit), none, none, burns)
        # Craft and interval of every control that is a variable.
        craft, interval = np.nonzero(self.limits.burns.any(axis=2))
        self.slots = craft, interval
        # Whether the model is one thruster that can point in any direction, and whether the
        # largest share is minimized, and not total fuel.
        self.pointed = directions is None
        self.fair = sub.thrust.objective == "fair" and sub.weight is not None
        # The matrix E from the variables of a control to the control, and the cost of each.
        self.effect, self.price = np.eye(3, 4), np.array([0.0, 0.0, 0.0, 1.0])
        if directions is not None:
            self.effect, self.price = directions.T, np.ones(len(directions))
        # Number of thrust variables, which come first, and of all: slacks, and in fair programs
        # the largest share, follow.
        self.thrusts = len(craft) * len(self.price)
        self.variables = self.thrusts + k + self.fair
        # Indices of the variables that may be nonzero.
        may = np.ones(self.variables, dtype=bool)
        if sub.thrust.model == COMPONENTS:
            may[: self.thrusts] = np.tile(self.limits.burns[self.slots], 2).ravel()
        if not np.isfinite(sub.penalty):
            may[self.thrusts : self.thrusts + k] = False
        self.kept = np.flatnonzero(may)

    def cost(self) -> Float[Array, "v"]:
        """Cost of each variable."""
        spent = np.tile(self.price, len(self.slots[0]))
        slack = np.full(len(self.sub.required), self.sub.penalty * LENGTH / self.sub.unit)
        if self.fair:
            return np.concatenate([FUEL_SHARE * spent, slack, [1.0]])
        return np.concatenate([spent, slack])

    def _by_slot(self, value: Float[Array, "r S V"], row: Int[Array, "r S"]) -> Parts:
        """Nonzero entries of all controls' variables in given rows."""
        r, s, v = np.nonzero(np.abs(value) > NEGLIGIBLE)
        return row[r, s], s * value.shape[2] + v, value[r, s, v]

    def goals(self) -> Block:
        """Equality rows: every craft reaches its goal and passes its waypoints."""
        sub, (craft, interval) = self.sub, self.slots
        (_, m, _), r = sub.shape, len(sub.reach)
        scale = sub.goal_scale * sub.unit
        reach = (sub.reach * scale[:, None]).reshape(r, m // 3, 3)[:, interval] @ self.effect
        row, column, value = self._by_slot(reach, r * craft + np.arange(r)[:, None])
        right_side = sub.goals()
        if sub.constrained is None or sub.constrained.all():
            return (row, column, value), right_side
        constrained = sub.constrained.ravel()
        number, there = np.cumsum(constrained) - 1, constrained[row]
        return (number[row[there]], column[there], value[there]), right_side[constrained]

    def half_spaces(self) -> Block:
        """Half-space rows, which are at most b, with slacks."""
        sub, (craft, interval) = self.sub, self.slots
        _, m, k = sub.shape
        other = sub.row if sub.other is None else sub.other
        value = np.zeros((k, len(craft), len(self.price)))
        for of, along, sign in ((sub.first, sub.row, -1.0), (sub.second, other, 1.0)):
            r, s = np.nonzero(of[:, None] == craft)
            value[r, s] += sign * along.reshape(k, m // 3, 3)[r, interval[s]] @ self.effect
        value *= sub.unit / LENGTH
        number = np.arange(k)
        controls = self._by_slot(value, np.broadcast_to(number[:, None], value.shape[:2]))
        slack = number, self.thrusts + number, -np.ones(k)
        return _joined(controls, slack), -sub.required / LENGTH

    def spending(self) -> Block:
        """Rows that limit each craft's Δv and, in fair programs, its share by the largest."""
        sub, (craft, _) = self.sub, self.slots
        left = self.limits.delta_v / (sub.time_step * sub.unit)
        some, n = np.isfinite(left), len(sub.miss)
        value = np.where(some[craft], 1.0, 0.0)[:, None] * self.price
        spent = self._by_slot(value[None], (np.cumsum(some) - 1)[craft][None])
        if not self.fair:
            return spent, left[some]
        assert sub.weight is not None
        top = int(some.sum())
        shares = self._by_slot((sub.weight[craft][:, None] * self.price)[None], top + craft[None])
        largest = top + np.arange(n), np.full(n, self.variables - 1), -np.ones(n)
        return _joined(spent, shares, largest), np.concatenate([left[some], np.zeros(n)])

    def least_burns(self) -> Block:
        """Rows that keep burns of a pointed thruster at or above the minimum impulse bit."""
        sub, V, bit = self.sub, len(self.price), self.sub.thrust.min_delta_v
        value = np.zeros((1, len(self.slots[0]), V))
        if self.limits.least is not None:
            value[0, :, :3] = -self.limits.least[self.slots]
        some = value[0].any(axis=1)
        least = 0.0 if bit is None else bit * (1 + LIMIT_ROUNDING) / (sub.time_step * sub.unit)
        rows = self._by_slot(value, np.cumsum(some)[None] - 1)
        return rows, np.full(int(some.sum()), -least)

    def bounds(self) -> Block:
        """Bound rows: signs of thrusts and slacks, and limits of components or thrusters."""
        sub, (craft, _) = self.sub, self.slots
        V, end = len(self.price), self.thrusts + len(sub.required)
        most = np.repeat(self.limits.component[craft] / sub.unit, V).reshape(-1, V)
        signed = np.arange(self.thrusts, end)
        if self.pointed:
            most[:, 3] = self.limits.norm[craft] / sub.unit
        else:
            signed = self.kept[self.kept < end]
        limits = most.ravel()
        above = np.intersect1d(np.flatnonzero(np.isfinite(limits)), self.kept)
        below = above[above % V < 3] if self.pointed else above[:0]  # components have two
        column = np.concatenate([signed, above, below])
        sign = np.repeat([-1.0, 1.0, -1.0], [len(signed), len(above), len(below)])
        b = np.concatenate([np.zeros(len(signed)), limits[above], limits[below]])
        return (np.arange(len(column)), column, sign), b

    def cones(self) -> Block:
        """Rows in groups of four that put (t, u) in second-order cones."""
        sub, (craft, _) = self.sub, self.slots
        S, V = len(craft), len(self.price)
        if self.pointed:
            order = (V * np.arange(S)[:, None] + [3, 0, 1, 2]).ravel()
            return (np.arange(4 * S), order, -np.ones(4 * S)), np.zeros(4 * S)
        some = np.flatnonzero(np.isfinite(self.limits.norm[craft]))
        value = np.zeros((3, S, V))
        value[:, some] = -self.effect[:, None]
        number = np.zeros(S, dtype=int)
        number[some] = np.arange(len(some))
        row = 4 * number + np.arange(1, 4)[:, None]
        b = np.zeros((len(some), 4))
        b[:, 0] = self.limits.norm[craft[some]] / sub.unit
        return self._by_slot(value, row), b.ravel()

    def solution(self, *accepted: str) -> tuple[str, Float[Array, "v"], Values]:
        """Clarabel's status, variables x, and dual variables z of the rows of A x + s = b.

        The rows are goals, bounds, least burns, spending, half-spaces and cones. Where it ends with
        no accepted status, it is sought again with equilibration and iterative refinement, which
        these well-scaled programs rarely need and which take half of the time.
        """
        from scipy.sparse import csc_matrix  # slow to import, and few plans need it

        linear = [self.bounds(), self.least_burns(), self.spending(), self.half_spaces()]
        blocks = [self.goals(), *linear, self.cones()]
        heights = [len(b) for _, b in blocks]
        cones = [clarabel.ZeroConeT(heights[0]), clarabel.NonnegativeConeT(sum(heights[1:-1]))]
        cones += [clarabel.SecondOrderConeT(4)] * (heights[-1] // 4)
        A, right_side = stacked(blocks, self.variables, self.kept)
        quadratic = csc_matrix((len(self.kept), len(self.kept)))
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.max_threads = 1  # since solvers run in parallel
        settings.presolve_enable = False  # which only drops rows without bounds; there are none
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = TOLERANCE
        program = quadratic, self.cost()[self.kept], A, right_side, cones
        for careful in (False, True):
            settings.equilibrate_enable = settings.iterative_refinement_enable = careful
            found = clarabel.DefaultSolver(*program, settings).solve()
            if str(found.status) in accepted:
                break
        x = np.zeros(self.variables)
        x[self.kept] = found.x
        return str(found.status), x, np.asarray(found.z)

    def controls_of(self, x: Float[Array, "v"]) -> Float[Array, "n m"]:
        """Controls in m/s² from the variables."""
        craft, interval = self.slots
        n, m, _ = self.sub.shape
        controls = np.zeros((n, m // 3, 3))
        z = x[: self.thrusts].reshape(-1, len(self.price))
        controls[craft, interval] = self.sub.unit * z @ self.effect.T
        return controls.reshape(n, m)

    def half_space_duals(self, z: Values) -> Float[Array, "_"]:
        """The dual variables of half-spaces, m/s² per m."""
        end = len(z) - len(self.cones()[1])
        return self.sub.unit / LENGTH * z[end - len(self.sub.required) : end]

    def splits(self, z: Values) -> Float[Array, "n intervals 3"]:
        """The dual variables of each control's cone: the split w of ``conjugate_bound``."""
        sub, (craft, interval) = self.sub, self.slots
        some = np.full(len(craft), self.pointed) | np.isfinite(self.limits.norm[craft])
        found = np.zeros((len(sub.miss), sub.reach.shape[1] // 3, 3))
        found[craft[some], interval[some]] = -z[len(z) - 4 * some.sum() :].reshape(-1, 4)[:, 1:]
        return found


def stacked(
    blocks: Sequence[Block], width: int, kept: Int[Array, "v"]
) -> tuple[Any, Float[Array, "_"]]:
    """Stack blocks of ``width`` variables, of which some are kept, to a sparse A and b."""
    from scipy.sparse import csc_matrix  # slow to import, and few plans need it

    tops = np.cumsum([0, *(len(b) for _, b in blocks)])
    row = np.concatenate([e[0] + top for (e, _), top in zip(blocks, tops[:-1], strict=True)])
    column, value = (np.concatenate([e[k] for e, _ in blocks]) for k in (1, 2))
    if len(kept) < width:
        number = np.full(width, -1)
        number[kept] = np.arange(len(kept))
        there = number[column] >= 0
        row, column, value = row[there], number[column[there]], value[there]
    # Entries are unique, so this is faster than by way of COO.
    shape = int(tops[-1]), len(kept)
    order = np.argsort(column * shape[0] + row)
    starts = np.searchsorted(column[order], np.arange(shape[1] + 1))
    matrix = csc_matrix((value[order], row[order], starts), shape=shape)
    return matrix, np.concatenate([b for _, b in blocks])


def _joined(*parts: Parts) -> Parts:
    row, column, value = zip(*parts, strict=True)
    return np.concatenate(row), np.concatenate(column), np.concatenate(value)


def by_cones(sub: Subproblem) -> Optimum:
    """Solve a subproblem as a cone program; UnsolvableError where no optimum is found.

    Few of many half-spaces between few craft are tight. There, by a cutting-plane method, those
    that an optimum violates most are added to its program until it violates none.
    """
    k, other = len(sub.required), sub.row if sub.other is None else sub.other
    if k < MANY or len(sub.miss) > FEW:
        return _by_cones(sub)
    used = np.zeros(k, dtype=bool)
    while True:
        best = _by_cones(sub.with_half_spaces(used))
        u, slack, dual = best.controls, *np.zeros((2, k))
        short = sub.required - np.vecdot(sub.row, u[sub.first])
        short += np.vecdot(other, u[sub.second])
        worst = np.argsort(np.where(used, 0.0, -short), kind="stable")[:WORST]
        worst = worst[~used[worst] & (short[worst] > VIOLATED)]
        if len(worst) == 0:
            slack[used], dual[used] = best.slack, best.dual
            return Optimum(u, slack, dual)
        used[worst] = True


def _by_cones(sub: Subproblem) -> Optimum:
    """As ``by_cones``, with all half-spaces at once."""
    program = ConicProgram(sub)
    status, x, z = program.solution(*OPTIMAL)
    if status not in OPTIMAL:
        raise UnsolvableError(f"the convex solver stopped with {status}")
    slack = LENGTH * x[program.thrusts :][: len(sub.required)]
    return Optimum(program.controls_of(x), slack, program.half_space_duals(z))
