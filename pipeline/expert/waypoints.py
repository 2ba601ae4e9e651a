"""The nodes at which craft pass waypoints whose times are open: those of least decoupled fuel."""

from collections.abc import Sequence

import numpy as np

from pipeline.arrays import Array, Float
from pipeline.expert.decoupled import decoupled_optima
from pipeline.orbit.arrays import Formation
from pipeline.orbit.problem import Problem
from pipeline.orbit.thrust import Limits
from pipeline.orbit.thrust_cost import spent
from pipeline.scenario.arrivals import Arrivals, arrivals_of
from pipeline.scenario.waypoint import Waypoint, choices_of, of_craft


def arrivals_at_least_fuel(
    initial: Formation,
    goal: Formation,
    problem: Problem,
    limits: Limits,
    waypoints: Sequence[Waypoint],
) -> tuple[Arrivals, Float[Array, "n"]]:
    """Where each craft must be, and a lower bound on its fuel for every choice of open times.

    The bound is infinite where no time is open, m/s². Every choice of a craft is tried.
    """
    passed, bound = {}, np.full(len(initial), np.inf)
    for craft, some in of_craft(waypoints).items():
        choices = choices_of(some, problem)
        best = choices[0]
        if len(choices) > 1:
            many = [craft] * len(choices)
            ends = initial[many], goal[many], problem
            tried = {k: list(zip(nodes, some, strict=True)) for k, nodes in enumerate(choices)}
            optima = decoupled_optima(*ends, limits[many], arrivals_of(*ends, tried))
            fuel = spent(optima.controls, problem.thrust, limits[many])
            fuel = np.where(optima.feasible, fuel, np.inf)
            # Where none is feasible, one that is not proven to be impossible.
            best = choices[int(np.lexsort((optima.impossible, fuel))[0])]
            bound[craft] = np.where(optima.impossible, np.inf, optima.lower_bound).min()
        passed[craft] = list(zip(best, some, strict=True))
    return arrivals_of(initial, goal, problem, passed), bound
