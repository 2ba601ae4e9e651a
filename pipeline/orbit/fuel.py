"""Fuel of a transfer (Eq. 4)."""

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.orbit.problem import Problem


def fuel(controls: Float[Array, "*batch n intervals 3"]) -> Float[Array, "*batch"]:
    """f_fuel = Σₜ Σᵢ ‖uᵢ[t]‖₁ in m/s², Eq. 4, of controls in m/s²."""
    return np.asarray(np.abs(controls).sum(axis=(-3, -2, -1)))


def implied_controls(
    states: Float[Array, "*batch T 6"], problem: Problem
) -> Float[Array, "*batch intervals 3"]:
    """B⁺(s[t+1] - A s[t]): the controls nearest to those that a row of states asks for, m/s².

    Exact where the states obey Eq. 2. States that do not, such as a network's raw output, can
    look cheaper than any transfer that can be flown.
    """
    A, B = problem.dynamics.step(problem.time_step)
    return (states[..., 1:, :] - states[..., :-1, :] @ A.T) @ np.linalg.pinv(B).T
