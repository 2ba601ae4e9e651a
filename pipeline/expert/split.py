"""The convex subproblem as a linear program: what the simplex method and interior points share.

Each control is split into its positive and negative part, u = p - q with p, q ≥ 0, so that
‖u‖₁ is linear. The variables are p and q of each craft in turn, then the slacks; the rows are
the goals and the half-spaces. All are scaled to be of order one.
"""

import numpy as np
from jaxtyping import Float, Int

from pipeline.arrays import Array
from pipeline.expert.subproblem import LENGTH, NEGLIGIBLE, Optimum, Subproblem

Entries = tuple[Int[Array, "e"], Int[Array, "e"], Float[Array, "e"]]
"""Row, column and value of each entry of a matrix that is not zero."""


def cost(sub: Subproblem) -> Float[Array, "v"]:
    """Of the variables."""
    n, m, k = sub.shape
    return np.concatenate([np.ones(2 * n * m), np.full(k, sub.penalty * LENGTH / sub.unit)])


def goal(sub: Subproblem) -> Float[Array, "rows"]:
    """What the goal rows are to be."""
    return (sub.miss * sub.goal_scale).ravel()


def goal_entries(sub: Subproblem) -> Entries:
    """The rows that are to equal ``goal``, craft after craft."""
    n, m, _ = sub.shape
    block = sub.reach * (sub.goal_scale * sub.unit)[:, None]
    r, c = np.nonzero(np.abs(block) > NEGLIGIBLE)
    craft = np.arange(n)[:, None]
    row, column = (6 * craft + r).ravel(), (2 * m * craft + c).ravel()
    value = np.tile(block[r, c], n)
    return np.tile(row, 2), np.concatenate([column, column + m]), np.concatenate([value, -value])


def half_space_entries(sub: Subproblem) -> Entries:
    """The rows that are to be at least ``required`` / LENGTH."""
    n, m, k = sub.shape
    r, c, value = _entries(sub.row, sub)
    s, d, against = (r, c, value) if sub.other is None else _entries(sub.other, sub)
    one, other = 2 * m * sub.first[r] + c, 2 * m * sub.second[s] + d
    slack = np.arange(k)
    return (
        np.concatenate([r, r, s, s, slack]),
        np.concatenate([one, one + m, other, other + m, 2 * n * m + slack]),
        np.concatenate([value, -value, -against, against, np.ones(k)]),
    )


def _entries(row: Float[Array, "k m"], sub: Subproblem) -> Entries:
    """What is not zero of scaled effects along the normals."""
    scaled = row * (sub.unit / LENGTH)
    r, c = np.nonzero(np.abs(scaled) > NEGLIGIBLE)
    return r, c, scaled[r, c]


def controls_of(x: Float[Array, "v"], sub: Subproblem) -> Float[Array, "n m"]:
    """Controls in m/s² from the solver's variables."""
    n, m, _ = sub.shape
    parts = x[: 2 * n * m].reshape(n, 2, m)
    controls: Float[Array, "n m"] = sub.unit * (parts[:, 0] - parts[:, 1])
    return controls


def optimum(x: Float[Array, "v"], price: Float[Array, "k"], sub: Subproblem) -> Optimum:
    """The solution in SI units, from the variables and the multipliers of the half-spaces."""
    n, m, _ = sub.shape
    controls = controls_of(x, sub)
    slack, price = LENGTH * x[2 * n * m :], sub.unit / LENGTH * price
    return Optimum(controls, slack, price, float(np.abs(controls).sum()))
