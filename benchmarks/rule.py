"""The refiner's rounds without its network (the rule), with minimum-fuel or least-squares programs.

The rule shows what is learned; programs that minimize the sum of squares, in the null space of the
goal's constraint, show what minimum-fuel programs are worth.
"""

from dataclasses import replace
from typing import no_type_check

import numpy as np
from jaxtyping import Float, Int
from numba import njit

from pipeline.arrays import Array
from pipeline.experiments.ablations import NULL_SPACE, RULE
from pipeline.networks.model import Model
from pipeline.networks.refiner.geometry import Grid
from pipeline.networks.refiner.packaged import TrainedRefiner
from pipeline.networks.refiner.programs import LARGEST_DUAL, LEAST_FUEL, Decoupled, Programs, Sides
from pipeline.orbit.problem import Problem
from pipeline.plan import AT_ALL_TIMES, Requirements
from pipeline.planners.network import NetworkPlanner

STEADY = 1e-10  # largest change of a dual in a sweep at which the sweeps have converged
MOST_SWEEPS = 1000  # most sweeps over the duals of a craft
NO_GAIN = 1e-12  # |F g|² under which controls cannot move a craft along a plane's normal


def rule(
    rounds: int, null_space: bool = False, requirements: Requirements = AT_ALL_TIMES
) -> NetworkPlanner:
    """The untrained refiner: the cheapest safe iterate of so many rounds, or else the last.

    With ``null_space`` each craft solves a program of least change instead of one of least fuel.
    """
    programs, name = (LEAST_CHANGE, NULL_SPACE) if null_space else (LEAST_FUEL, RULE)
    unlearned = TrainedRefiner(None, rounds, Problem(), "", programs)
    return NetworkPlanner(unlearned, name, requirements)


def with_rounds(model: Model, rounds: int) -> Model:
    """A refiner with the same weights whose answer takes so many rounds."""
    return replace(model, config={**model.config, "rounds": rounds}).on(model.problem)


# Least change in place of least fuel: a craft that keeps to its side of some planes departs from
# its decoupled optimum u₀ as little as it can, by the sum of squares, while R u = b still holds:
#
#     min ½‖u - u₀‖² + Λ Σ max(0, d - g·u)   subject to   R u = b.
#
# With F, which takes from controls what changes the final state, that is u = u₀ + F Σ λ g. The
# duals λ in [0, Λ] are found one after the other until none changes: C. Hildreth, "A quadratic
# programming procedure", Naval Research Logistics Quarterly 4, 1957.


def _first_duals(
    _: Decoupled, craft: Int[Array, "k"], gain: Float[Array, "k m"], grid: Grid
) -> Float[Array, "k"]:
    """Initial duals: the marginal cost of a displacement of one, 1 / |F g|²; that of none is 0."""
    return 1 / np.maximum(np.square(gain @ grid.free).sum(axis=1), NO_GAIN)


def _optima(
    own: Decoupled, sides: Sides, gain: Float[Array, "L m"], asked: Float[Array, "L 2"], grid: Grid
) -> tuple[Float[Array, "C m"], Float[Array, "L 2"]]:
    controls, dual = own.controls[sides.craft], np.zeros_like(asked)
    free = gain @ grid.free
    _solve_all(sides.start, sides.order, gain, free, asked, controls, dual)
    return controls, dual


LEAST_CHANGE = Programs(_first_duals, _optima)  # the program above


@no_type_check
@njit(cache=True)
def _solve_all(start, order, gain, free, asked, controls, dual):
    """The optimum of each of C programs; arguments are those of ``simplex.solve_all``.

    But ``free`` has F times the rows, (L, m), and controls begin as the decoupled optima, (C, m).
    """
    for c in range(len(start) - 1):
        mine, u = order[start[c] : start[c + 1]], controls[c]
        for _ in range(MOST_SWEEPS):
            most = 0.0
            for side in mine:
                plane, second = side >> 1, side & 1
                sign = -1.0 if second else 1.0
                g, f = gain[plane], free[plane]
                left, length = asked[plane, second], 0.0
                for k in range(len(u)):
                    left -= sign * g[k] * u[k]
                    length += g[k] * f[k]
                if length > NO_GAIN:
                    before = dual[plane, second]
                    now = min(max(before + left / length, 0.0), LARGEST_DUAL)
                    dual[plane, second] = now
                    for k in range(len(u)):
                        u[k] += sign * (now - before) * f[k]
                    most = max(most, abs(now - before))
            if most < STEADY:
                break
