"""The closest approach of every pair at any time, in brackets that no pass slips through.

On a stretch of h seconds a function is nowhere below the lesser of its ends by more than
h²/8 times its largest second derivative. The squared distance has q'' = 2|v|² + 2 r·a, and
on a short stretch |r|, |v| and |a| have bounds that hold each other up: each grows by at most
h times the next, and |a| ≤ 3e²|r| + 2e|v| + |u| by the equations of motion. Stretches that this
does not rule out are halved.
"""

from dataclasses import dataclass

import numpy as np

from judge.motion import Case, after

SHORT = 0.05
"""Longest stretch, in radians of the orbit; the bounds need far less than 1/3."""

RELATIVE, ABSOLUTE = 5e-6, 1e-6
"""Width of a bracket: a share of the distance, or in m."""


@dataclass(frozen=True)
class Approaches:
    """The closest approach of every pair; arrays over pairs, in m and s.

    The least distance is between ``low`` and ``high``, which is attained at ``time``.
    """

    first: np.ndarray
    second: np.ndarray
    low: np.ndarray
    high: np.ndarray
    time: np.ndarray


def closest_approaches(
    problem: Case, states: np.ndarray, controls: np.ndarray, pairs: np.ndarray | None = None
) -> Approaches:
    """Closest approaches of pairs, (2, k) or all, from node states (n, T, 6) and controls."""
    rate, intervals = problem.rate, problem.nodes - 1
    first, second = np.triu_indices(len(states), 1) if pairs is None else pairs
    high, time = np.full((2, len(first)), np.inf)
    begin = (states[first] - states[second])[:, :-1].reshape(-1, 6)
    held = (controls[first] - controls[second]).reshape(-1, 3)
    pair = np.repeat(np.arange(len(first)), intervals)
    since = np.tile(problem.step * np.arange(intervals), len(first))
    h = problem.step

    while len(pair):
        end = after(rate, h, begin, held)
        for state, when in ((begin, since), (end, since + h)):
            _attain(high, time, pair, np.linalg.norm(state[:, :3], axis=1), when)
        wanted = np.maximum(high - _width(high), 0.0)[pair]
        open_ = (wanted > 0) & (_least_square(rate, h, begin, end, held) < wanted**2)
        pair, since, begin, held = pair[open_], since[open_], begin[open_], held[open_]
        h /= 2
        pair, held = np.tile(pair, 2), np.tile(held, (2, 1))
        begin = np.concatenate([begin, after(rate, h, begin, held[: len(begin)])])
        since = np.concatenate([since, since + h])
    return Approaches(first, second, np.maximum(high - _width(high), 0.0), high, time)


def distance_at(
    problem: Case, states: np.ndarray, controls: np.ndarray, pair: tuple[int, int], time: float
) -> float:
    """Distance of two craft at a time, m."""
    k = int(np.clip(time // problem.step, 0, problem.nodes - 2))
    i, j = pair
    state, held = states[i, k] - states[j, k], controls[i, k] - controls[j, k]
    return float(np.linalg.norm(after(problem.rate, time - k * problem.step, state, held)[:3]))


def _width(high: np.ndarray) -> np.ndarray:
    return np.maximum(RELATIVE * high, ABSOLUTE)


def _attain(
    high: np.ndarray, time: np.ndarray, pair: np.ndarray, found: np.ndarray, when: np.ndarray
) -> None:
    """Lower each pair's least distance so far to what is found, in place."""
    order = np.lexsort((found, pair))
    one, where = np.unique(pair[order], return_index=True)
    best = order[where]
    better = found[best] < high[one]
    high[one[better]], time[one[better]] = found[best][better], when[best][better]


def _least_square(
    rate: float, h: float, begin: np.ndarray, end: np.ndarray, held: np.ndarray
) -> np.ndarray:
    """A lower bound on the squared distance over stretches; none where they are too long."""
    if rate * h > SHORT:
        return np.full(len(begin), -np.inf)
    r, v = (np.linalg.norm(begin[:, k : k + 3], axis=1) for k in (0, 3))
    pushed = 3 * rate**2 * (r + h * v) + 2 * rate * v + np.linalg.norm(held, axis=1)
    most_a = pushed / (1 - 3 * (rate * h) ** 2 - 2 * rate * h)
    most_v = v + h * most_a
    curvature = 2 * (most_v**2 + (r + h * most_v) * most_a)
    ends = np.minimum(*(np.square(state[:, :3]).sum(axis=1) for state in (begin, end)))
    return ends - curvature * h**2 / 8
