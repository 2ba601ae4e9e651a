"""Trials of a plan flown with errors in the linear model: numpy and the judge's exponentials alone.

What is drawn, and how it moves, is written out here anew, so that a claimed risk can be held
against how often craft really come too close.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from judge import Case, exact_step, fly

PIECES = 40
"""Looks at each interval."""


@dataclass(frozen=True)
class Errors:
    """Standard deviations: a position's, m, a velocity's, m/s, and a burn's, as a share and rad."""

    position: float
    velocity: float
    thrust: float


@dataclass(frozen=True)
class Flown:
    """Relative positions of one pair, m: as planned (times, 3), and in each trial."""

    planned: np.ndarray
    trials: np.ndarray

    def least(self) -> np.ndarray:
        """The least distance in each trial."""
        return np.sqrt(np.einsum("ktc,ktc->kt", self.trials, self.trials).min(axis=-1))

    def passages(self, radius: float) -> np.ndarray:
        """How often n·Δp falls below a radius in each trial, n the planned direction; a trial that
        begins below counts once more."""
        normal = self.planned / np.linalg.norm(self.planned, axis=-1, keepdims=True)
        above = np.einsum("tc,ktc->kt", normal, self.trials) > radius
        return (above[:, :-1] & ~above[:, 1:]).sum(axis=1) + ~above[:, 0]


def drawn(
    initial: np.ndarray,
    controls: np.ndarray,
    errors: Errors,
    trials: int,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Initial states (trials, n, 6) and controls (trials, n, T-1, 3) with their errors.

    A burn errs by a share of its size along it, and by that share to two sides across it.
    """
    n, intervals, _ = controls.shape
    deviation = np.repeat([errors.position, errors.velocity], 3)
    starts = initial + deviation * rng.normal(size=(trials, n, 6))
    return starts, made(controls, errors.thrust, rng.normal(size=(trials, n, intervals, 3)))


def made(controls: np.ndarray, share: float, draws: np.ndarray) -> np.ndarray:
    """Burns that err by a share of their size along them, and to two sides across, (..., 3)."""
    size = np.linalg.norm(controls, axis=-1, keepdims=True)
    along = np.divide(controls, size, out=np.zeros_like(controls), where=size > 0)
    helper = np.eye(3)[np.abs(along).argmin(axis=-1)]
    across = np.cross(along, helper)
    length = np.linalg.norm(across, axis=-1, keepdims=True)
    across = np.divide(across, length, out=np.zeros_like(across), where=length > 0)
    axes = np.stack([along, across, np.cross(along, across)], axis=-1)
    return controls + share * size * np.einsum("...ab,...b->...a", axes, draws)


def corrected(
    problem: Case,
    states: np.ndarray,
    controls: np.ndarray,
    errors: Errors,
    trials: int,
    seed: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Node states, controls that were asked for and those made, of plans corrected at each node.

    From the second node on states are known with new errors, and the deviation is to be gone after
    0.15 orbits, or at the end, with the least energy; in the last interval the least of
    ‖Δp‖² + ‖Δv/e‖² is to be left.
    """
    rng, (n, intervals, _) = np.random.default_rng(seed), controls.shape
    A, B = exact_step(problem.rate, problem.step)
    deviation = np.repeat([errors.position, errors.velocity], 3)
    state = states[:, 0] + deviation * rng.normal(size=(trials, n, 6))
    nodes, asked, flown = [state], [], []
    ahead = max(2, int(np.ceil(0.15 * 2 * np.pi / problem.rate / problem.step)))
    for k in range(intervals):
        left = min(ahead, intervals - k)
        reach = np.hstack([np.linalg.matrix_power(A, left - 1 - j) @ B for j in range(left)])
        weight = np.diag(np.repeat([1.0, 1.0 / problem.rate], 3))
        drift = np.linalg.matrix_power(A, left)
        gain = -np.linalg.lstsq(weight @ reach, weight @ drift, rcond=None)[0][:3]
        off = state + deviation * rng.normal(size=state.shape) - states[:, k]
        command = controls[:, k] + (off @ gain.T if k else np.zeros((trials, n, 3)))
        push = made(command, errors.thrust, rng.normal(size=command.shape))
        state = state @ A.T + push @ B.T
        nodes.append(state)
        asked.append(command)
        flown.append(push)
    return np.stack(nodes, 2), np.stack(asked, 2), np.stack(flown, 2)


def frequency_corrected(
    problem: Case,
    states: np.ndarray,
    controls: np.ndarray,
    errors: Errors,
    trials: int,
    seed: int = 0,
) -> int:
    """In how many trials any pair comes within the collision radius, corrected at each node."""
    nodes, _, flown = corrected(problem, states, controls, errors, trials, seed)
    return _hits(problem, nodes, flown, states, controls)


def _hits(
    problem: Case,
    states: np.ndarray,
    made: np.ndarray,
    planned: np.ndarray,
    controls: np.ndarray,
) -> int:
    """In how many trials any pair comes within the radius, of node states and controls flown.

    A pair is looked at when some trial's craft may err far enough from the plan's to meet.
    """
    flow = _flow(problem, np.arange(PIECES + 1))
    flown = np.concatenate([states[..., :-1, :], made], axis=-1)
    plan = np.concatenate([planned[:, :-1], controls], axis=-1)
    tracks = (plan @ flow.reshape(-1, 9).T).reshape(*plan.shape[:2], -1, 3)
    # Largest errors of positions, velocities and burns, and what each comes to at most later on.
    wrong = (flown - plan).reshape(*flown.shape[:-1], 3, 3)
    errors = np.sqrt(np.vecdot(wrong, wrong).max(axis=0))
    growth = np.linalg.norm(flow.reshape(-1, 3, 3, 3).swapaxes(1, 2), ord=2, axis=(-2, -1))
    off = errors @ growth.T  # (n, T-1, times)
    i, j = np.triu_indices(len(plan), 1)
    gap = tracks[i] - tracks[j]
    near = np.sqrt(np.vecdot(gap, gap)) < problem.radius + off[i] + off[j]
    hit = np.zeros(len(flown), dtype=bool)
    for pair, k in np.argwhere(near.any(axis=-1)):
        apart = flown[:, i[pair], k] - flown[:, j[pair], k]
        gap = apart @ flow[near[pair, k]].reshape(-1, 9).T
        gap = gap.reshape(len(gap), -1, 3)
        hit |= (np.einsum("ktc,ktc->kt", gap, gap) < problem.radius**2).any(axis=1)
    return int(hit.sum())


def pairs_flown(
    problem: Case,
    initial: np.ndarray,
    controls: np.ndarray,
    errors: Errors,
    trials: int,
    seed: int,
    within: float,
) -> Iterator[Flown]:
    """Every pair that is planned to come within a distance, m, with its relative motion."""
    rng = np.random.default_rng(seed)
    planned = positions(problem, fly(problem, initial, controls), controls)
    i, j = np.triu_indices(len(initial), 1)
    apart = np.linalg.norm(planned[i] - planned[j], axis=-1).min(axis=-1)
    starts, pushes = drawn(initial, controls, errors, trials, rng)
    shape = (trials * len(initial), problem.nodes - 1, 3)
    states = fly(problem, starts.reshape(-1, 6), pushes.reshape(shape))
    tracks = positions(problem, states, pushes.reshape(shape))
    tracks = tracks.reshape(trials, len(initial), -1, 3)
    for one, other in zip(i[apart < within], j[apart < within], strict=True):
        yield Flown(planned[one] - planned[other], tracks[:, one] - tracks[:, other])


def frequency(
    problem: Case,
    initial: np.ndarray,
    controls: np.ndarray,
    errors: Errors,
    trials: int,
    seed: int = 0,
) -> int:
    """In how many trials any pair comes within the collision radius."""
    starts, pushes = drawn(initial, controls, errors, trials, np.random.default_rng(seed))
    flat = starts.reshape(-1, 6), pushes.reshape(-1, problem.nodes - 1, 3)
    states = fly(problem, *flat).reshape(*starts.shape[:2], problem.nodes, 6)
    return _hits(problem, states, pushes, fly(problem, initial, controls), controls)


def wilson(hits: int, trials: int, z: float = 3.3) -> tuple[float, float]:
    """Wilson's interval of a probability; at z = 3.3 it misses one time in a thousand."""
    share, extra = hits / trials, z**2 / trials
    middle = (share + extra / 2) / (1 + extra)
    half = z / (1 + extra) * np.sqrt(share * (1 - share) / trials + extra / trials / 4)
    return middle - half, middle + half


def positions(problem: Case, states: np.ndarray, controls: np.ndarray) -> np.ndarray:
    """Positions at PIECES times an interval, and the last."""
    flow = _flow(problem, np.arange(1, PIECES + 1)).reshape(-1, 9)
    inside = np.concatenate([states[:, :-1], controls], axis=2).reshape(-1, 9) @ flow.T
    return np.concatenate([states[:, :1, :3], inside.reshape(len(states), -1, 3)], axis=1)


def _flow(problem: Case, pieces: np.ndarray) -> np.ndarray:
    """From a node's state and the burn that is held to positions after some pieces, (k, 3, 9)."""
    maps = [exact_step(problem.rate, float(at)) for at in problem.step / PIECES * pieces]
    free, forced = (np.stack([one[k][:3] for one in maps]) for k in (0, 1))
    return np.concatenate([free, forced], axis=2)
