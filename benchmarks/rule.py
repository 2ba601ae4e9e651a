"""The refiner's rounds without its network (the rule), with minimum-fuel or least-squares programs.

The rule shows what is learned; programs that minimize the sum of squares, in the null space of the
goal's constraint, show what minimum-fuel programs are worth.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import cast, no_type_check

import numpy as np
from jaxtyping import Float, Int
from numba import njit

from pipeline.arrays import Array
from pipeline.expert.batch import Batch
from pipeline.networks.document import Ends, portions
from pipeline.networks.model import Model
from pipeline.networks.refiner.geometry import Grid
from pipeline.networks.refiner.model import answer
from pipeline.networks.refiner.programs import LARGEST_DUAL, LEAST_FUEL, Decoupled, Programs, Sides
from pipeline.networks.refiner.refiner import MessagePassing
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import meet_goal
from pipeline.plan import AT_ALL_TIMES, Plan, Requirements
from pipeline.planners.certified import certified, stacked_ends
from pipeline.scenario import Scenario

RULE, NULL_SPACE = "rule", "rule, null space"

STEADY = 1e-10  # largest change of a dual in a sweep at which the sweeps have converged
MOST_SWEEPS = 1000  # most sweeps over the duals of a craft
NO_GAIN = 1e-12  # |F g|² under which controls cannot move a craft along a plane's normal


def by_rule(
    initial: Ends, goal: Ends, problem: Problem, rounds: int, programs: Programs = LEAST_FUEL
) -> Float[Array, "N n _ 3"]:
    """Controls after some rounds of the refiner without its network, m/s².

    Args:
        initial: initial states of N swarms, m and m/s.
        goal: their goal states.
        problem: orbit, time grid and collision radius.
        rounds: how many; after none each craft keeps its decoupled optimum.
        programs: what each craft solves.
    """
    radius = np.full(len(initial), problem.collision_radius)
    found = [
        answer(None, rounds, problem, initial[k], goal[k], radius[k], programs)
        for k in portions(initial, goal, problem.nodes)
    ]
    return np.concatenate(found)


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
    """The optimum of each of C programs; sides are those of ``simplex.solve_all``.

    Args:
        start: where the sides of each craft begin in ``order``, (C + 1,).
        order: sides of planes, (S,).
        gain: rows of planes for the first craft of each, (L, m).
        free: F times these, (L, m).
        asked: what is asked of either craft, (L, 2).
        controls: decoupled optima, which become the result, (C, m).
        dual: zeros, which become the result, (L, 2).
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


def own_rounds(model: Model) -> int | None:
    """The rounds that a refiner's answer takes; None of a network of another kind."""
    return model.network.rounds if isinstance(model.network, MessagePassing) else None


def with_rounds(model: Model, rounds: int) -> Model:
    """A refiner with the same weights whose answer takes so many rounds."""
    network = cast("MessagePassing", copy(model.network))  # shares the weights
    network.rounds = rounds
    return replace(model, config={**model.config, "rounds": rounds}, network=network)


@dataclass(frozen=True)
class Rule:
    """The untrained refiner: the cheapest safe iterate of some rounds, or else the last."""

    rounds: int  # how many
    null_space: bool = False  # whether steps lie in the null space, instead of each craft's program
    requirements: Requirements = AT_ALL_TIMES  # what its plans are judged by

    @property
    def name(self) -> str:
        """What tables call it."""
        return NULL_SPACE if self.null_space else RULE

    def plan(self, scenarios: Sequence[Scenario]) -> list[Plan]:
        """One plan for each scenario, in order; the scenarios share one problem and one n."""
        program = LEAST_CHANGE if self.null_space else LEAST_FUEL

        def answer(batch: Batch) -> Float[Array, "n _ 3"]:
            (initial, goal), problem = stacked_ends(batch), batch.problem
            controls = by_rule(initial, goal, problem, self.rounds, program)
            exact = meet_goal(initial, controls, goal, problem)
            return exact.reshape(-1, problem.intervals, 3)

        return certified(self.name, scenarios, answer, self.requirements)
