"""Trials of one transfer with errors, flown as a batch under some guidance."""

from collections.abc import Callable, Mapping
from functools import reduce

import numpy as np

from pipeline.arrays import Array, Bool, Float, Int, plain
from pipeline.flight.errors import Draws, Errors, Loss, burns_made, lost_thrust, navigation_errors
from pipeline.flight.least_distances import LeastDistances, Surroundings
from pipeline.flight.world import World
from pipeline.orbit.arrays import Controls, States, norm
from pipeline.orbit.feedback import feedback_gains
from pipeline.orbit.nearest import nearest, smaller_separation
from pipeline.orbit.problem import Problem
from pipeline.orbit.thrust_cost import cost_within
from pipeline.orbit.transfer import step_maps
from pipeline.scenario import Scenario

SIZE = 0.35  # distance of two craft's centres at which two cubes of 20 cm can touch, m
SHORTEST = 1e-9  # shortest part of an interval that is flown separately, as a share of it

Trials = Mapping[str, Array]
"""Columns of a loop's trials, one value each, SI units. Errors at the goal are those of the craft
furthest from it, separations the least of any pair at any time, Δv that of all craft. A craft alone
has a ``first_craft`` of -1 and no separation; ``replan_seconds`` has a row of times a trial, NaN
where nobody planned. By sizes, and with corridors, there are those of ``LeastDistances``.
``lost_craft`` lost its thrust at ``lost_time``, -1 and NaN where none did; its error at the goal
does not count."""

Guidance = Callable[[int, Float[Array, "K n 6"]], Float[Array, "K n 3"]]
"""Controls, m/s², for the interval that begins at a node, from the number of that node and the
estimated states there, m and m/s; called for each node once, in order."""


def open_loop(controls: Controls) -> Guidance:
    """Guidance that flies a plan's controls, m/s², whatever the estimate."""
    return lambda node, estimate: np.broadcast_to(controls[:, node], (*estimate.shape[:2], 3))


def feedback(
    controls: Controls, states: States, problem: Problem, *, late: bool = False
) -> Guidance:
    """Guidance that corrects a plan's controls, m/s², for deviations from its states, m and m/s.

    By ``pipeline.orbit.feedback``, and within the thrust limit. A ``late`` estimate is carried on
    in linear motion, and so is the plan's state, which a plan as flown does not move by.
    """
    gains, most = feedback_gains(problem), problem.most_control
    if late:
        A, B = step_maps(problem)
        carried = np.matvec(A, states[:, :-1]) + np.matvec(B, controls)
        states = np.concatenate([states[:, :1], carried], axis=1)
    return lambda node, estimate: np.clip(
        controls[:, node] + np.matvec(gains[node], estimate - states[:, node]), -most, most
    )


def fly_trials(
    scenario: Scenario, world: World, guidance: Guidance, drawn: Draws, errors: Errors
) -> dict[str, Array]:
    """Fly a batch of trials; all columns of ``Trials`` but those of replanning.

    The scenario's initial states are the estimates at the first node; true states are these minus
    the navigation errors. At a node the end of a late burn is still to come; the final states are
    evaluated after it. Obstacles have no errors. A craft that loses its thrust in mid-burn has
    begun the burn in time, and the rest of it does not count as a missed burn.
    """
    problem, trials, n = scenario.problem, len(drawn.bias), scenario.n
    h, shape, met, around = problem.time_step, (trials, n), [], Surroundings(scenario, world)
    wrong, loss = navigation_errors(drawn, errors, problem), lost_thrust(drawn, errors, problem)
    adrift = _mask(loss.by(0), n)
    state = scenario.initial - wrong[:, 0]
    held, shares, missed = [], [], np.zeros(trials, dtype=int)
    late, carried = np.zeros((*shape, 3)), state
    for node in range(problem.intervals):
        known = _with_impulse(state, late) + wrong[:, node] if node else scenario.initial
        known = np.broadcast_to(known, (*shape, 6))
        commanded = guidance(node, carried if errors.latency and node else known)
        commanded = np.where(adrift[..., None], 0.0, commanded)
        if errors.latency:  # what is known, carried on to the next node
            A, B = problem.dynamics.step(h, node)
            carried = np.matvec(A, known) + np.matvec(B, commanded)
        burns = burns_made(commanded, drawn, node, errors, h)
        before, adrift = adrift, _mask(loss.by(node + 1), n)
        stops = (adrift & ~before)[..., None]
        lag = np.where(stops, 0.0, burns.late)
        start, late = _with_impulse(state, late - lag), lag
        state, least = _fly_interval(world, around, start, burns.held, node, loss, h)
        met.append(least)
        held.append(burns.held)
        shares.append(np.where(stops[..., 0], loss.time[:, None] / h - node, 1.0))
        missed += burns.missed
    least, miss = reduce(LeastDistances.nearer, met), _with_impulse(state, late) - scenario.goal
    miss = np.where(adrift[..., None], 0.0, miss)
    burned = cost_within(np.stack(held, axis=2), problem.thrust, scenario.limits)
    used = h * (burned * np.stack(shares, axis=2)).sum(axis=(1, 2))
    return {
        **least.columns(problem.collision_radius),
        "goal_error": norm(miss[..., :3]).max(axis=1),
        "goal_velocity_error": norm(miss[..., 3:]).max(axis=1),
        "delta_v": used,
        "missed_burns": missed,
        "lost_craft": loss.craft,
        "lost_time": loss.time,
    }


def _fly_interval(
    world: World,
    around: Surroundings,
    start: Float[Array, "K n 6"],
    held: Float[Array, "K n 3"],
    node: int,
    loss: Loss,
    h: float,
) -> tuple[Float[Array, "K n 6"], LeastDistances]:
    """States at the end of an interval of h s, and the least distances in it.

    Trials in which a craft loses its thrust in the interval are flown in two parts, before and
    after; such swarms have neither obstacles nor corridors.
    """
    arc = world.arc(start.reshape(-1, 6), held.reshape(-1, 3), node)
    arcs = arc.reshape(*start.shape[:2], *arc.shape[1:])
    end, met = plain(arcs[:, :, -1, -1]), around.least_distances(arcs, node)
    for k in np.flatnonzero(loss.node == node + 1).tolist():
        at = float(np.clip(loss.time[k] / h - node, SHORTEST, 1 - SHORTEST))
        after = held[k].copy()
        after[loss.craft[k]] = 0.0
        first = world.arc(start[k], held[k], node, (0.0, at))
        second = world.arc(first[:, -1, -1], after, node, (at, 1.0))
        before = nearest(first[None], node * h, at * h)
        least = smaller_separation(before, nearest(second[None], (node + at) * h, (1 - at) * h))
        end[k] = plain(second[:, -1, -1])
        for name, one in vars(least).items():
            getattr(met.craft, name)[k] = one[0]
    return end, met


def _mask(craft: Int[Array, "K"], n: int) -> Bool[Array, "K n"]:
    """The craft of each trial as a mask; of none where it is -1."""
    return craft[:, None] == np.arange(n)


def _with_impulse(
    state: Float[Array, "K n 6"], impulse: Float[Array, "K n 3"]
) -> Float[Array, "K n 6"]:
    """States with an impulse, m/s, added to their velocities."""
    return np.concatenate([state[..., :3], state[..., 3:] + impulse], axis=-1)
