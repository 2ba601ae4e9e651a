"""Trials of one transfer with errors, flown side by side under some guidance."""

from collections.abc import Callable, Mapping
from functools import reduce

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.flight.encounters import Encounters, Surroundings
from pipeline.flight.errors import Draws, Errors, burns_made, navigation_errors
from pipeline.flight.world import World
from pipeline.orbit.bezier import norm
from pipeline.orbit.feedback import feedback_gains
from pipeline.orbit.problem import Problem
from pipeline.orbit.thrust_cost import burned
from pipeline.scenario import Scenario

SIZE = 0.35  # distance of two craft's centres at which two cubes of 20 cm can touch, m

Trials = Mapping[str, Array]
"""Trials of a loop by column, a value a trial, SI units. Errors at the goal are those of the craft
furthest from it, separations the least of any pair at any time, Δv that of all craft. A craft alone
has a ``first_craft`` of -1 and no separation; ``replan_seconds`` has a row of times a trial, NaN
where nobody planned. By sizes, and with corridors, there are those of ``Encounters.columns``."""

Guidance = Callable[[int, Float[Array, "K n 6"]], Float[Array, "K n 3"]]
"""Controls, m/s², for the interval that begins at a node, from the number of that node and the
estimated states there, m and m/s; called for each node once, in order."""


def open_loop(controls: Float[Array, "n intervals 3"]) -> Guidance:
    """Guidance that flies a plan's controls, m/s², whatever the estimate."""
    return lambda node, estimate: np.broadcast_to(controls[:, node], (*estimate.shape[:2], 3))


def feedback(
    controls: Float[Array, "n intervals 3"], states: Float[Array, "n T 6"], problem: Problem
) -> Guidance:
    """Guidance that corrects a plan's controls, m/s², for what is off its states, m and m/s.

    By ``pipeline.orbit.feedback``, and within the thrust limit.
    """
    gains, most = feedback_gains(problem), problem.most_control
    return lambda node, estimate: np.clip(
        controls[:, node] + np.matvec(gains[node], estimate - states[:, node]), -most, most
    )


def fly_trials(
    scenario: Scenario, world: World, guidance: Guidance, drawn: Draws, errors: Errors
) -> dict[str, Array]:
    """Fly some trials side by side; all columns of ``Trials`` but those of replanning.

    The scenario's initial states are the estimates at the first node; craft are where those and
    the navigation errors put them. At a node the rest of a late burn is still to come; the ends of
    trials are evaluated after it. Obstacles have no errors.
    """
    problem, trials, n = scenario.problem, len(drawn.bias), scenario.n
    h, shape, met, around = problem.time_step, (trials, n), [], Surroundings(scenario, world)
    wrong = navigation_errors(drawn, errors, problem)
    state = scenario.initial - wrong[:, 0]
    used, missed = np.zeros(trials), np.zeros(trials, dtype=int)
    late, carried = np.zeros((*shape, 3)), state
    for node in range(problem.intervals):
        known = _pushed(state, late) + wrong[:, node] if node else scenario.initial
        known = np.broadcast_to(known, (*shape, 6))
        commanded = guidance(node, carried if errors.latency and node else known)
        A, B = problem.dynamics.step(h, node)
        carried = np.matvec(A, known) + np.matvec(B, commanded)  # to the next node
        burns = burns_made(commanded, drawn, node, errors, h)
        start = _pushed(state, late - burns.late).reshape(-1, 6)
        arc = world.arc(start, burns.held.reshape(-1, 3), node)
        arcs = arc.reshape(*shape, *arc.shape[1:])
        met.append(around.encounters(arcs, node))
        state, late = arcs[:, :, -1, -1], burns.late
        used += burned(burns.held, problem.thrust) * h
        missed += burns.missed
    least, miss = reduce(Encounters.nearer, met), _pushed(state, late) - scenario.goal
    return {
        **least.columns(problem.collision_radius),
        "goal_error": norm(miss[..., :3]).max(axis=1),
        "goal_velocity_error": norm(miss[..., 3:]).max(axis=1),
        "delta_v": used,
        "missed_burns": missed,
    }


def _pushed(state: Float[Array, "K n 6"], impulse: Float[Array, "K n 3"]) -> Float[Array, "K n 6"]:
    """States with an impulse, m/s, added to their velocities."""
    return np.concatenate([state[..., :3], state[..., 3:] + impulse], axis=-1)
