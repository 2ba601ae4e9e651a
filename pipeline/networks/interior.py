"""The columns of the input between initial and goal state, which the paper leaves open."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import fly, minimum_energy, straight_line

Ends = Float[Array, "*batch 6"]
Trajectories = Float[Array, "*batch T 6"]


def line(initial: Ends, goal: Ends, problem: Problem) -> Trajectories:
    """The straight line from initial to goal state, in m and m/s."""
    return straight_line(initial, goal, problem.nodes)


def zeros(initial: Ends, goal: Ends, problem: Problem) -> Trajectories:
    """Nothing but the first and last state of each craft."""
    states = np.zeros((*initial.shape[:-1], problem.nodes, 6))
    states[..., 0, :], states[..., -1, :] = initial, goal
    return states


def least_energy(initial: Ends, goal: Ends, problem: Problem) -> Trajectories:
    """Each craft's own transfer of minimum energy, in closed form."""
    return fly(initial, minimum_energy(initial, goal, problem), problem)


INTERIORS: dict[str, Callable[[Ends, Ends, Problem], Trajectories]] = {
    "line": line,
    "zeros": zeros,
    "minimum-energy": least_energy,
}
"""By name, the trajectories (m, m/s) that stand in a network's input."""
