"""Transfers as linear maps: states from controls, least energy, projection, fuel, free drift."""

import math
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Array, Bool, Float
from pipeline.errors import InputError
from pipeline.orbit.arrays import (
    AnyControls,
    AnyState,
    AnyStates,
    Controls,
    Formation,
    Scalar,
    States,
    mapped,
)
from pipeline.orbit.problem import MOST_NODES, RANGES, Problem, once_per_motion

COAST = 1e-7  # share of a craft's largest control below which a control is rounding, no burn
UNCHANGED = 1e-9  # change of a final state that counts as zero, m; velocities over e
REGULAR = 1e9  # condition number up to which a map counts as invertible
AT_ONCE = 64  # intervals of a block, flown by one product, whose size grows with their square
ORBIT_INTERVALS = 16  # least number of intervals into which an orbit of free drift is cut


@dataclass(frozen=True, eq=False)
class TransferMaps:
    """Constants of a problem: s[t] = drift[t] s[1] + reach[t] u, with u flattened by time."""

    drift: Float[Array, "T 6 6"]  # state transition matrices, powers of A about a circle
    reach: Float[Array, "T 6 m"]  # from flattened controls to each node's state, m = 3(T-1)
    to_goal: Float[Array, "m 6"]  # pseudo-inverse of reach[T], which gives least-energy controls
    within: Float[Array, "T 6 6"]  # as drift, but from the block's first node


@once_per_motion
def transfer_maps(problem: Problem) -> TransferMaps:
    """State transition matrices and control maps of all nodes, cached by orbit and time grid."""
    A, B = step_maps(problem)
    T, weight = problem.nodes, state_weight(problem)
    reach, within = np.zeros((T, 6, 3 * (T - 1))), np.zeros((T, 6, 6))
    for t in range(1, T):
        within[t] = A[t - 1] @ within[t - 1] if (t - 1) % AT_ONCE else A[t - 1]
        reach[t] = A[t - 1] @ reach[t - 1]
        reach[t, :, 3 * (t - 1) : 3 * t] = B[t - 1]
    to_goal = np.linalg.pinv(weight[:, None] * reach[-1]) * weight
    return TransferMaps(_powers(problem), reach, to_goal, within)


@once_per_motion
def _projection(problem: Problem) -> Float[Array, "m _"]:
    """Map from node states, 6T, to the best-fitting controls that keep the final state.

    By dynamic programming, as the linear-quadratic regulator that tracks these states at no cost of
    controls: the cost to go from each node, backwards, and the controls from the first node on.
    """
    (A, B), weight, K = step_maps(problem), state_weight(problem), problem.intervals
    A, B = weight[:, None] * A / weight, weight[:, None] * B
    gain, push = np.empty((K, 3, 6)), np.empty((K, 3, 6 * problem.nodes))
    one = np.eye(6)
    cost, slope = one, np.zeros((6, 6 * problem.nodes))  # to go from z: zᵀ cost z / 2 + zᵀ slope
    slope[:, -6:] = -one
    for t in reversed(range(K)):
        best = -np.linalg.solve(B[t].T @ cost @ B[t], B[t].T)
        gain[t], push[t] = best @ cost @ A[t], best @ slope
        kept = A[t] + B[t] @ gain[t]
        cost, slope = one + A[t].T @ cost @ kept, kept.T @ slope
        slope[:, 6 * t : 6 * t + 6] -= one
    state = np.zeros_like(slope)
    for t in range(K):
        push[t] += gain[t] @ state
        state = A[t] @ state + B[t] @ push[t]
    controls = push.reshape(3 * K, -1)
    # Controls depend on the final state that is tracked: the one for which it does not change acts
    # as the Lagrange multiplier of that constraint.
    controls -= controls[:, -6:] @ (np.linalg.pinv(state[:, -6:]) @ state)
    controls *= np.tile(weight, problem.nodes)
    return controls


@once_per_motion
def _powers(problem: Problem) -> Float[Array, "T 6 6"]:
    """A from the first node to each: powers of A about a circle."""
    if problem.orbit is not None:
        return problem.dynamics.drift(0, np.arange(problem.nodes))
    A, _ = problem.dynamics.step(problem.time_step)
    return np.stack([np.linalg.matrix_power(A, t) for t in range(problem.nodes)])


def step_maps(problem: Problem) -> tuple[Float[Array, "K 6 6"], Float[Array, "K 6 3"]]:
    """A and B of Eq. 2 of each interval."""
    (A, B), K = _step(problem), problem.intervals
    return np.broadcast_to(A, (K, 6, 6)), np.broadcast_to(B, (K, 6, 3))


@once_per_motion
def _step(problem: Problem) -> tuple[Float[Array, "*K 6 6"], Float[Array, "*K 6 3"]]:
    """A and B of Eq. 2, for each interval where they differ."""
    return problem.dynamics.step(problem.time_step, np.arange(problem.intervals))


def has_one_plan(problem: Problem) -> bool:
    """Whether any two states are joined by exactly one sequence of controls."""
    # Two intervals have six components, as many as a state; singular at special steps only.
    reach = transfer_maps(problem).reach[-1] * state_weight(problem)[:, None]
    return reach.shape == (6, 6) and float(np.linalg.cond(reach)) < REGULAR


def state_weight(problem: Problem) -> Float[Array, "6"]:
    """Weights of a state's components: a velocity of 1 m/s counts as a position of 1/e m."""
    return np.repeat([1.0, 1.0 / problem.mean_motion], 3)


def fly(initial: AnyState, controls: AnyControls, problem: Problem) -> AnyStates:
    """Node states (m, m/s) from initial states and controls (m/s²), by Eq. 2."""
    # Row by row, since what a matrix product rounds depends on how many rows there are.
    maps = transfer_maps(problem)
    free = np.matvec(maps.drift.reshape(-1, 6), initial)
    return free.reshape(*initial.shape[:-1], problem.nodes, 6) + _pushed(controls, maps)


def _pushed(controls: AnyControls, maps: TransferMaps) -> AnyStates:
    """Forced response: node states from controls, m/s², where the initial state is zero."""
    batch, intervals = controls.shape[:-2], controls.shape[-2]
    found = np.zeros((*batch, intervals + 1, 6))
    for k in range(0, intervals, AT_ONCE):
        last = min(k + AT_ONCE, intervals)
        own = maps.reach[k : last + 1, :, 3 * k : 3 * last].reshape(-1, 3 * (last - k))
        led = np.matvec(own, controls[..., k:last, :].reshape(*batch, 3 * (last - k)))
        led = led.reshape(*batch, last + 1 - k, 6)[..., 1:, :]
        if k:
            led += np.matvec(maps.within[k + 1 : last + 1], found[..., k, None, :])
        found[..., k + 1 : last + 1, :] = led
    return found


def free_drift(
    states: Formation, problem: Problem, orbits: float = 1.0, start: float = 0.0
) -> tuple[States, Controls, Problem]:
    """Free drift over some orbits: node states, zero controls and the problem they belong to.

    It starts a time, s, after the first node, which matters about a reference orbit. InputError
    where it takes longer than any transfer may.
    """
    time, longest = orbits * 2 * np.pi / problem.mean_motion, RANGES["time_step"][1]
    if time > longest * (MOST_NODES - 1):
        raise InputError(
            f"mean_motion is {problem.mean_motion:g} rad/s, by which a free drift of {orbits:g} "
            f"orbits takes {time:.3g} s; expected at most {longest * (MOST_NODES - 1):.3g} s: "
            "give a larger mean_motion, or fewer orbits."
        )
    intervals = min(max(2, math.ceil(orbits * ORBIT_INTERVALS)), MOST_NODES - 1)
    intervals = max(intervals, math.ceil(time / longest))  # about orbits far above the Earth
    step = time / intervals
    orbit = problem.orbit and problem.orbit.later(start)
    drift = Problem(problem.mean_motion, step, intervals + 1, orbit=orbit)
    idle = np.zeros((len(states), intervals, 3))
    # Bit for bit as ``fly``, without its maps of controls, which have 200 MB for 1250 nodes.
    flown = np.matvec(_powers(drift).reshape(-1, 6), states)
    return flown.reshape(len(states), drift.nodes, 6), idle, drift


def dynamics_defect(
    states: AnyStates, controls: AnyControls, problem: Problem
) -> Float[Array, "*batch intervals 6"]:
    """Violation of Eq. 2: s[t+1] - A s[t] - B u[t], m and m/s."""
    A, B = _step(problem)
    return states[..., 1:, :] - mapped(A, states[..., :-1, :]) - mapped(B, controls)


def fuel(controls: Float[Array, "*batch n intervals 3"]) -> Scalar:
    """f_fuel = Σₜ Σᵢ ‖uᵢ[t]‖₁ in m/s², Eq. 4, of controls in m/s²."""
    return np.asarray(np.abs(controls).sum(axis=(-3, -2, -1)))


def implied_controls(states: AnyStates, problem: Problem) -> AnyControls:
    """Least-squares controls of node states, B⁺(s[t+1] - A s[t]), m/s².

    For states that violate Eq. 2, as a network's may, they can cost less than any real transfer.
    """
    A, B = _step(problem)
    return mapped(np.linalg.pinv(B), states[..., 1:, :] - mapped(A, states[..., :-1, :]))


def meet_goal(
    initial: AnyState, controls: AnyControls, goal: AnyState, problem: Problem
) -> AnyControls:
    """The controls plus the least-energy correction after which the goal is met exactly."""
    maps = transfer_maps(problem)
    flat = controls.reshape(*controls.shape[:-2], 3 * problem.intervals)
    miss = goal - np.matvec(maps.drift[-1], initial) - np.matvec(maps.reach[-1], flat)
    return controls + np.matvec(maps.to_goal, miss).reshape(controls.shape)


def minimum_energy(initial: AnyState, goal: AnyState, problem: Problem) -> AnyControls:
    """Controls of least Σ‖u‖₂² from one state to another, without other craft, in closed form."""
    idle = np.zeros((*initial.shape[:-1], problem.intervals, 3))
    return meet_goal(initial, idle, goal, problem)


def project_to_flyable(
    states: AnyStates, initial: AnyState, goal: AnyState, problem: Problem
) -> AnyControls:
    """Controls of the trajectory nearest to ``states`` that obeys Eq. 2 and both ends exactly.

    Nearest in the sum of squares over all nodes, with velocities divided by e.
    """
    # Such trajectories are an affine set, so this is one product for each craft.
    controls = minimum_energy(initial, goal, problem)
    rest = states - fly(initial, controls, problem)
    flat = np.matvec(_projection(problem), rest.reshape(*rest.shape[:-2], 6 * problem.nodes))
    return meet_goal(initial, controls + flat.reshape(controls.shape), goal, problem)


def straight_line(initial: AnyState, goal: AnyState, nodes: int) -> AnyStates:
    """Node states on the straight line between two states, which ignores the dynamics."""
    share = np.linspace(0.0, 1.0, nodes)[:, None]
    return (1 - share) * initial[..., None, :] + share * goal[..., None, :]


def with_coasts(controls: Controls, problem: Problem) -> Controls:
    """The controls with exact zeros where only rounding is left; final states stay as they are.

    A craft's other controls compensate for what is dropped. Where they cannot, or one would become
    rounding itself, nothing is dropped; so what is set to zero once leaves nothing to set to zero.
    """
    burns = _are_burns(controls, problem)
    kept = np.where(burns, controls, 0.0)
    reach, weight = transfer_maps(problem).reach[-1], state_weight(problem)
    dropped = (controls - kept).reshape(len(controls), -1)
    change = weight * np.matvec(reach, dropped)
    for k in np.flatnonzero(np.abs(change).max(axis=1) > UNCHANGED).tolist():
        columns = weight[:, None] * reach[:, burns[k].ravel()]
        added = np.linalg.lstsq(columns, change[k])[0]
        kept[k][burns[k]] += added
        same = np.abs(columns @ added - change[k]).max() <= UNCHANGED
        if not same or (_are_burns(kept[k : k + 1], problem) != burns[k]).any():
            kept[k] = controls[k]
    return kept


def _are_burns(controls: Controls, problem: Problem) -> Bool[Array, "n intervals 3"]:
    """Mask of the controls that are more than rounding beside the largest of their craft."""
    size = np.abs(controls)
    largest = np.maximum(size.max(axis=(1, 2), keepdims=True), problem.evasive_control)
    return np.asarray(size > COAST * largest)


def track(
    states: States, controls: Controls, problem: Problem, steps: int
) -> Float[Array, "n _ 3"]:
    """Positions, m, along a trajectory, ``steps`` for each interval and the last node."""
    times, intervals = problem.time_step / steps * np.arange(steps), np.arange(problem.intervals)
    A, B = (maps[..., :3, :] for maps in problem.dynamics.step(times, intervals[:, None]))
    between = np.matvec(A, states[:, :-1, None]) + np.matvec(B, controls[:, :, None])
    return np.concatenate([between.reshape(len(states), -1, 3), states[:, -1:, :3]], axis=1)
