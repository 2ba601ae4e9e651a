"""Trials of one transfer with errors, flown side by side under some guidance."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce

import numpy as np
from jaxtyping import Float, Int

from pipeline.arrays import Array
from pipeline.flight.errors import Draws, Errors, burns_made, navigation_error
from pipeline.flight.nearest import Nearest, nearer, nearest, pieces_for
from pipeline.flight.world import World
from pipeline.orbit.bezier import norm
from pipeline.scenario import Scenario

SIZE = 0.35
"""Distance of two craft's centres at which two cubes of 20 cm can touch, m."""

Guidance = Callable[[int, Float[Array, "K n 6"]], Float[Array, "K n 3"]]
"""Controls, m/s², for the interval that begins at a node, from the number of that node and the
estimated states there, m and m/s; called for each node once, in order."""


def open_loop(controls: Float[Array, "n intervals 3"]) -> Guidance:
    """Guidance that flies a plan's controls, m/s², whatever the estimate."""
    return lambda node, estimate: np.broadcast_to(controls[:, node], (*estimate.shape[:2], 3))


@dataclass(frozen=True, eq=False)
class TrialResults:
    """Results of K trials."""

    nearest: Nearest  # the least separation of any pair of each trial at any time
    goal_error: Float[Array, "K"]  # of the craft furthest from its goal, m
    goal_velocity_error: Float[Array, "K"]  # likewise of velocities, m/s
    delta_v: Float[Array, "K"]  # of all craft, Σ‖u‖₁Δt of what was burnt, m/s
    missed: Int[Array, "K"]  # number of burns that were not made


def fly_trials(
    scenario: Scenario, world: World, guidance: Guidance, drawn: Draws, errors: Errors
) -> TrialResults:
    """Fly some trials side by side.

    The scenario's initial states are the estimates at the first node; craft are where those and
    the navigation errors put them. At a node the rest of a late burn is still to come; the ends of
    trials are evaluated after it.
    """
    problem, trials, n = scenario.problem, len(drawn.bias), scenario.n
    h, e, shape = problem.time_step, problem.mean_motion, (trials, n)
    state = scenario.initial - navigation_error(drawn, 0, errors)
    pieces, closest = pieces_for(h, e), []
    used, missed = np.zeros(trials), np.zeros(trials, dtype=int)
    late = np.zeros((*shape, 3))
    for node in range(problem.intervals):
        known = state + navigation_error(drawn, node, errors) if node else scenario.initial
        estimate = np.broadcast_to(known, (*shape, 6))
        burns = burns_made(guidance(node, estimate), drawn, node, errors, h)
        start = _pushed(state, late - burns.late).reshape(-1, 6)
        arc = world.arc(start, burns.held.reshape(-1, 3), node * h, h, pieces)
        arcs = arc.reshape(*shape, pieces + 1, 6)
        closest.append(nearest(arcs, node * h, h, e))
        state, late = arcs[:, :, -1], burns.late
        used += np.abs(burns.held).sum(axis=(1, 2)) * h
        missed += burns.missed
    miss = _pushed(state, late) - scenario.goal
    position, velocity = norm(miss[..., :3]).max(axis=1), norm(miss[..., 3:]).max(axis=1)
    return TrialResults(reduce(nearer, closest), position, velocity, used, missed)


def _pushed(state: Float[Array, "K n 6"], impulse: Float[Array, "K n 3"]) -> Float[Array, "K n 6"]:
    """States with an impulse, m/s, added to their velocities."""
    return np.concatenate([state[..., :3], state[..., 3:] + impulse], axis=-1)
