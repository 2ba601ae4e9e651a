"""The convex subproblem that each round of the SCP solves, and its form as a linear program.

    minimise    Σᵢ ‖uᵢ‖₁ + penalty · Σ slack
    subject to  reach uᵢ = missᵢ                                  every craft reaches its goal
                rowₖ · uᵢ - otherₖ · uⱼ + slackₖ ≥ requiredₖ       half-spaces, Eq. 5 linearized
                slack ≥ 0
                |uᵢ| ≤ limit

States are eliminated: the controls are the only variables. A half-space for the pair (i, j) at
one time is n̂ᵀ(pᵢ - pⱼ) ≥ r, with n̂ the direction between the two at the linearization point; by
Cauchy-Schwarz a pair that satisfies it is at least r apart at that time.

In the linear program each control is split into its positive and negative part, u = p - q with
p, q ≥ 0, so that ‖u‖₁ is linear. Its variables are p and q of each craft in turn, then the slacks;
its rows are the goals and the half-spaces. All are scaled to be of order one.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from pipeline.arrays import Array, Bool, Float, Int
from pipeline.errors import ProlearnError
from pipeline.orbit.arrays import Indices, Values
from pipeline.orbit.thrust import ALONG_AXES, Limits, Thrust

LENGTH = 10.0  # scale of half-space rows, m
NEGLIGIBLE = 1e-13  # entries of a scaled map below this are structural zeros

# Entries of each row of a matrix that are not zero: their number, then columns and values of all
Entries = tuple[Int[Array, "rows"], Int[Array, "e"], Float[Array, "e"]]


class UnsolvableError(ProlearnError):
    """The solver found no optimum; a thrust limit is the usual reason."""


@dataclass(frozen=True, eq=False)
class Basis:
    """A basis of the linear program in which no goal row is basic, as masks of what is."""

    controls: Bool[Array, "n both"]  # of each craft's positive and negative parts, 2m
    slack: Bool[Array, "k"]  # of the half-spaces' slacks
    row: Bool[Array, "k"]  # of the half-spaces' rows

    @classmethod
    def of_decoupled(cls, basic: Int[Array, "n 6"], m: int, k: int) -> "Basis":
        """The basis of decoupled optima, given as in ``Subproblem``, and k half-spaces' rows."""
        controls, slack = np.zeros((len(basic), 2 * m), dtype=bool), np.zeros(k, dtype=bool)
        np.put_along_axis(controls, basic, True, axis=1)
        return cls(controls, slack, ~slack)


@dataclass(frozen=True, eq=False)
class Optimum:
    """Solution of a subproblem."""

    controls: Float[Array, "n m"]  # flattened controls of each craft, m/s²
    slack: Values  # violation of each half-space, m
    dual: Values  # dual variables of half-spaces, m/s² per m
    basis: Basis | None = None  # where ``last`` was given and the final basis is of this kind
    bound: float = 0.0  # lower bound on the cost, m/s², by branch and bound


@dataclass(frozen=True, eq=False)
class Subproblem:
    """One convex program, for n craft and k half-spaces, in SI units."""

    # effect of a craft's flattened controls on its final state, and on those at waypoints
    reach: Float[Array, "r m"]
    miss: Float[Array, "n r"]  # change of these states that each craft's controls must produce
    first: Indices  # craft of each half-space
    second: Indices
    row: Float[Array, "k m"]  # effect of the first craft's controls along the normal, m per m/s²
    required: Values  # what the controls must contribute along the normal, m
    limit: float  # largest component of a control, m/s², or infinity
    penalty: float  # cost of a metre of slack, m/s²; infinite where cone programs have none
    unit: float  # size of a typical control, m/s², which makes the solver's numbers of order one
    # basic variables of each craft's decoupled optimum, where they are known: the index of a
    # control, plus m where it acts in the negative direction
    basis: Int[Array, "n 6"] | None = None
    last: Basis | None = None  # to start from instead; then the optimum has its basis, too
    # effect of the second craft's controls against the normal; None where it is ``row``, as for two
    # craft that fly their plans
    other: Float[Array, "k m"] | None = None
    # for cone programs: the thruster model, limits of each craft, the time step, s, and the weight
    # of each craft's fuel in the largest share
    thrust: Thrust = ALONG_AXES
    limits: Limits | None = None
    time_step: float = 1.0
    weight: Float[Array, "n"] | None = None
    constrained: Bool[Array, "n r"] | None = None  # which changes each craft must make; None: all
    rounding: Float[Array, "r"] | float = 0.0  # errors of these that count as zero, m and m/s

    @property
    def shape(self) -> tuple[int, int, int]:
        """Numbers of craft n, of control components of each m, and of half-spaces k."""
        return len(self.miss), self.reach.shape[1], len(self.required)

    @property
    def goal_scale(self) -> Float[Array, "r"]:
        """Factors that scale the rows of goals to order one."""
        return _goal_rows(self.reach.tobytes(), self.shape[1])[1] / self.unit

    def with_half_spaces(self, which: Bool[Array, "k"]) -> "Subproblem":
        """The subproblem with some of its half-spaces alone."""
        return replace(
            self,
            first=self.first[which],
            second=self.second[which],
            row=self.row[which],
            required=self.required[which],
            other=None if self.other is None else self.other[which],
        )

    def cost(self) -> Float[Array, "v"]:
        """Cost of each variable of the linear program."""
        n, m, k = self.shape
        slack = np.full(k, self.penalty * LENGTH / self.unit)
        return np.concatenate([np.ones(2 * n * m), slack])

    def goals(self) -> Float[Array, "rows"]:
        """Right-hand sides of the goal rows, craft after craft."""
        return (self.miss * self.goal_scale).ravel()

    def goal_rows(self) -> Entries:
        """Goal rows, craft after craft."""
        n, m, _ = self.shape
        (count, column, value), _ = _goal_rows(self.reach.tobytes(), m)
        each = (2 * m * np.arange(n)[:, None] + column).ravel()
        return np.concatenate([count] * n), each, np.concatenate([value] * n)

    def half_space_rows(self) -> Entries:
        """Rows that must be at least ``required`` / LENGTH."""
        n, m, k = self.shape
        one = self.row * (self.unit / LENGTH)
        against = one if self.other is None else self.other * (self.unit / LENGTH)
        value = np.concatenate([one, -one, -against, against, np.ones((k, 1))], axis=1)
        column = np.empty(value.shape, dtype=int)
        each = np.arange(2 * m)
        column[:, : 2 * m] = 2 * m * self.first[:, None] + each
        column[:, 2 * m : -1] = 2 * m * self.second[:, None] + each
        column[:, -1] = 2 * n * m + np.arange(k)
        kept = np.abs(value) > NEGLIGIBLE
        return kept.sum(axis=1), column[kept], value[kept]

    def optimum(self, x: Float[Array, "v"], dual: Values) -> Optimum:
        """The solution in SI units, from the variables and the half-spaces' dual variables."""
        n, m, _ = self.shape
        parts = x[: 2 * n * m].reshape(n, 2, m)
        controls = self.unit * (parts[:, 0] - parts[:, 1])
        return Optimum(controls, LENGTH * x[2 * n * m :], self.unit / LENGTH * dual)


@lru_cache(maxsize=32)
def _goal_rows(reach: bytes, m: int) -> tuple[Entries, Float[Array, "r"]]:
    """Goal rows of one craft and the factors that scaled them, the same in a whole problem."""
    block = np.frombuffer(reach).reshape(-1, m)
    scale = 1 / np.sqrt(np.square(block).sum(axis=1))
    block = block * scale[:, None]
    both = np.concatenate([block, -block], axis=1)
    kept = np.abs(both) > NEGLIGIBLE
    return (kept.sum(axis=1), kept.nonzero()[1], both[kept]), scale
