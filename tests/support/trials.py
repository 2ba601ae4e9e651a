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
        return np.sqrt(np.square(self.trials).sum(axis=-1).min(axis=-1))

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
    size = np.linalg.norm(controls, axis=-1, keepdims=True)
    along = np.divide(controls, size, out=np.zeros_like(controls), where=size > 0)
    helper = np.eye(3)[np.abs(along).argmin(axis=-1)]
    across = np.cross(along, helper)
    length = np.linalg.norm(across, axis=-1, keepdims=True)
    across = np.divide(across, length, out=np.zeros_like(across), where=length > 0)
    axes = np.stack([along, across, np.cross(along, across)], axis=-1)
    share = errors.thrust * rng.normal(size=(trials, n, intervals, 3))
    return starts, controls + np.einsum("niab,knib->knia", size[..., None] * axes, share)


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
    planned = _positions(problem, fly(problem, initial, controls), controls)
    i, j = np.triu_indices(len(initial), 1)
    apart = np.linalg.norm(planned[i] - planned[j], axis=-1).min(axis=-1)
    starts, pushes = drawn(initial, controls, errors, trials, rng)
    shape = (trials * len(initial), problem.nodes - 1, 3)
    states = fly(problem, starts.reshape(-1, 6), pushes.reshape(shape))
    tracks = _positions(problem, states, pushes.reshape(shape))
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
    within: float = 60.0,
) -> int:
    """In how many trials any pair comes within the collision radius."""
    hit = np.zeros(trials, dtype=bool)
    for pair in pairs_flown(problem, initial, controls, errors, trials, seed, within):
        hit |= pair.least() < problem.radius
    return int(hit.sum())


def wilson(hits: int, trials: int, z: float = 3.3) -> tuple[float, float]:
    """Wilson's interval of a probability; at z = 3.3 it misses one time in a thousand."""
    share, extra = hits / trials, z**2 / trials
    middle = (share + extra / 2) / (1 + extra)
    half = z / (1 + extra) * np.sqrt(share * (1 - share) / trials + extra / trials / 4)
    return middle - half, middle + half


def _positions(problem: Case, states: np.ndarray, controls: np.ndarray) -> np.ndarray:
    """Positions at PIECES times an interval, and the last."""
    offsets = problem.step / PIECES * np.arange(1, PIECES + 1)
    maps = [exact_step(problem.rate, float(at)) for at in offsets]
    free, forced = (np.stack([one[k][:3] for one in maps]) for k in (0, 1))
    inside = np.einsum("qab,ntb->ntqa", free, states[:, :-1], optimize=True)
    inside += np.einsum("qab,ntb->ntqa", forced, controls, optimize=True)
    flat = inside.reshape(len(states), -1, 3)
    return np.concatenate([states[:, :1, :3], flat], axis=1)
