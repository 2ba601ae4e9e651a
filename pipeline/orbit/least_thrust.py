"""The least thrust limit within which a craft can make its transfer, the others ignored."""

from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.sparse import block_diag, csr_array, eye_array, hstack, kron

from pipeline.arrays import Array
from pipeline.errors import ProlearnError
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import minimum_energy, transfer_maps

NO_REACH = 1e-6
"""Share of a transfer that full thrust must bring about for it to count as reached at all."""


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

    enough = np.abs(minimum_energy(initial, goal, problem)).max(axis=(1, 2))
    moving = np.flatnonzero(enough)  # the others arrive without thrust
    limits = np.zeros(len(initial))
    if len(moving) == 0:
        return limits
    maps = transfer_maps(problem)
    miss = goal[moving] - np.matvec(maps.drift[-1], initial[moving])
    scale = np.repeat([1.0, problem.duration], 3) / problem.duration**2
    reach = csr_array(maps.reach[-1] * scale[:, None])
    wanted = csr_array(block_diag(list((miss * scale / enough[moving, None])[..., None])))
    n, m = len(moving), reach.shape[1]
    balance: Any = hstack([kron(eye_array(n), reach), -wanted], format="csr")
    found = linprog(
        np.repeat([0.0, -1.0], [n * m, n]),
        A_eq=balance,
        b_eq=np.zeros(6 * n),
        bounds=[(-1.0, 1.0)] * (n * m) + [(0.0, np.inf)] * n,
        method="highs",
    )
    if found.x is None:
        raise ProlearnError(f"the least thrust limit was not found: {found.message}")
    times = found.x[n * m :]
    with np.errstate(divide="ignore"):
        limits[moving] = np.where(times > NO_REACH, enough[moving] / times, np.inf)
    return limits
