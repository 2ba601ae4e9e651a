"""The least thrust limit within which a craft can make its transfer, the others ignored."""

from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.sparse import block_diag, csr_array, eye_array, hstack, kron

from pipeline.arrays import Array
from pipeline.errors import ProlearnError
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import minimum_energy, transfer_maps

SHORT = 1e-6
"""Share of a change of state that a transfer may leave undone and count as one: rounding."""

ROUNDING = np.repeat([1e-6, 1e-9], 3)
"""What a transfer may leave undone in any case, m and m/s."""


def least_limits(
    initial: Float[Array, "n 6"], goal: Float[Array, "n 6"], problem: Problem
) -> Float[Array, "n"]:
    """Min max|u| over all controls u that join the two states of each craft, m/s².

    A linear program for each craft: with every component of w within ±1, how many times s the
    change b of the final state can R w = s b be? A limit of 1/s is what it takes. All are solved
    in one call, scaled by the minimum-energy transfers, which no limit needs to exceed. Any thrust
    limit that the problem has is not looked at.

    Returns:
        The limit of each craft; infinite where no thrust reaches the goal.

    Raises:
        ProlearnError: where the solver fails.
    """
    from scipy.optimize import linprog  # slow to import, and only a check of a scenario needs it

    maps = transfer_maps(problem)
    scale = np.repeat([1.0, problem.duration], 3) / problem.duration**2  # all in m/s²
    reach = maps.reach[-1] * scale[:, None]
    miss = (goal - np.matvec(maps.drift[-1], initial)) * scale
    controls = minimum_energy(initial, goal, problem).reshape(len(miss), -1)
    left, enough = np.abs(miss - np.matvec(reach, controls)), np.abs(controls).max(axis=1)
    short = np.maximum(SHORT * np.abs(miss).max(axis=1, keepdims=True), ROUNDING * scale)
    missed = (left > short).any(axis=1)
    limits = np.where(missed, np.inf, 0.0)
    moving = np.flatnonzero((enough > 0) & ~missed)  # the others arrive without thrust
    if len(moving) == 0:
        return limits
    wanted = csr_array(block_diag(list((miss[moving] / enough[moving, None])[..., None])))
    n, m = len(moving), reach.shape[1]
    balance: Any = hstack([kron(eye_array(n), csr_array(reach)), -wanted], format="csr")
    found = linprog(
        np.repeat([0.0, -1.0], [n * m, n]),
        A_eq=balance,
        b_eq=np.zeros(6 * n),
        bounds=[(-1.0, 1.0)] * (n * m) + [(0.0, np.inf)] * n,
        method="highs",
    )
    if found.x is None:
        raise ProlearnError(f"the least thrust limit was not found: {found.message}")
    limits[moving] = enough[moving] / found.x[n * m :]
    return limits
