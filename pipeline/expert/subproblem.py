"""The convex subproblem as data: what the SCP solves again and again.

    minimise    Σᵢ ‖uᵢ‖₁ + penalty · Σ slack
    subject to  reach uᵢ = missᵢ                                  every craft meets its goal
                rowₖ · uᵢ - otherₖ · uⱼ + slackₖ ≥ requiredₖ       half-spaces, Eq. 5 linearised
                slack ≥ 0
                |uᵢ| ≤ limit

States are eliminated: the controls are the only variables. A half-space for the pair (i, j) at
one time is n̂ᵀ(pᵢ - pⱼ) ≥ r, with n̂ the direction between the two in the trajectory aimed from;
by Cauchy-Schwarz whatever satisfies it is at least r apart at that time.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from pipeline.arrays import Array
from pipeline.errors import ProlearnError

LENGTH = 10.0
"""Scale of half-space rows, m."""

NEGLIGIBLE = 1e-13
"""Entries of a scaled map below this are structural zeros."""


class UnsolvableError(ProlearnError):
    """The solver found no optimum; a thrust limit is the usual reason."""


@dataclass(frozen=True, eq=False)
class Subproblem:
    """One convex program, for n craft and k half-spaces, in SI units.

    Attributes:
        reach: effect of a craft's flattened controls on its final state, (6, m).
        miss: change of final state that each craft's controls must bring about, (n, 6).
        first: first craft of each half-space, (k,).
        second: second craft, (k,).
        row: effect of the first craft's controls along the normal, m per m/s², (k, m).
        required: what the controls must contribute along the normal, m, (k,).
        limit: largest component of a control, m/s², or infinity.
        penalty: cost of a metre of slack, m/s².
        unit: size of a typical control, m/s², which makes the solver's numbers of order one.
        basis: basic variables of each craft's own optimum, where they are known, (n, 6): the
            number of a control, or m more where it acts in the negative direction.
        other: effect of the second craft's controls against the normal, (k, m); None where it is
            ``row``, as it is for two craft that are looked at alike.
    """

    reach: Float[Array, "6 m"]
    miss: Float[Array, "n 6"]
    first: Int[Array, "k"]
    second: Int[Array, "k"]
    row: Float[Array, "k m"]
    required: Float[Array, "k"]
    limit: float
    penalty: float
    unit: float
    basis: Int[Array, "n 6"] | None = None
    other: Float[Array, "k m"] | None = None

    @property
    def shape(self) -> tuple[int, int, int]:
        """Craft n, controls of each m, half-spaces k."""
        return len(self.miss), self.reach.shape[1], len(self.required)

    @cached_property
    def goal_scale(self) -> Float[Array, "6"]:
        """Factors on the goals that make their rows of order one."""
        return 1 / (np.sqrt(np.square(self.reach).sum(axis=1)) * self.unit)


@dataclass(frozen=True, eq=False)
class Optimum:
    """Solution of a subproblem.

    Attributes:
        controls: flattened controls of each craft, (n, m), m/s².
        slack: by how much each half-space is missed, (k,), m.
        price: what a metre more of each half-space would cost, (k,), m/s² per m (multipliers).
        fuel: Σ ‖uᵢ‖₁ without the penalty, m/s².
    """

    controls: Float[Array, "n m"]
    slack: Float[Array, "k"]
    price: Float[Array, "k"]
    fuel: float
