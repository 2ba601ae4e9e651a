"""Families of random scenarios, each a function of root seed, n, index and split alone.

The split seeds the draw, so that a test scenario of one dataset is a training scenario of none,
whatever their seeds, sizes and shares. Both formations of every scenario are passively safe: in
free drift over a whole orbit no pair comes within the collision radius. Draws that are not are
drawn again from the same stream.

A family is a generator of one scenario: it draws numbers, yields what is to be computed from them
and is sent the answer. So scenarios are drawn side by side, and those that ask for the same are
answered by one call on arrays.
"""

from collections.abc import Callable, Generator, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Bool, Float

from pipeline.arrays import Array
from pipeline.errors import InputError
from pipeline.orbit.approaches import MOST_PAIRS, close_approaches, side_by_side
from pipeline.orbit.arrays import Formation, Marked
from pipeline.orbit.problem import Problem
from pipeline.orbit.relative_elements import ring_states
from pipeline.orbit.separation import drift_separations, node_collisions
from pipeline.orbit.transfer import free_drift
from pipeline.scenario.scenario import MOST_CRAFT, Scenario

SEMI_MAJOR_AXIS = (100.0, 300.0)  # range of ring sizes a, m
TILT = np.deg2rad(45.0)  # largest ring tilt either way, rad
DENSITY_N = 30  # above this many craft the rings grow with n, so that the density stays
REDRAWS = 2000  # tries after which a formation is said not to fit
SPLITS = ("train", "valid", "test")  # their order seeds the draw
SEEDS = 2**32  # bound of seeds, sizes and indices: each is one word of entropy
DENSE = 1.02  # least separation of a dense formation in free drift, in collision radii
CROWDED = 1.75  # largest half extent of a dense formation, in collision radii times √n
BESIDE = (
    15  # of the most pairs that fit in memory, the part that is compared at once: so fit caches
)

Ends = tuple[Formation, Formation]
Elements = Float[Array, "_ 5"]
"""Of craft on rings, a row each: a (m), tilt, phase, cross phase (rad) and offset (m)."""

T = TypeVar("T")
Drawing = Generator["_Asked", Any, T]
"""A draw on its way to a value: it yields what it asks, and is sent the answers."""


def check_family(family: str) -> None:
    """Refuse an unknown family with an InputError."""
    if family not in FAMILIES:
        raise InputError(f"family is {family!r}; expected one of {', '.join(FAMILIES)}.")


def draw(
    family: str, seed: int, n: int, index: int, problem: Problem, split: str = "train"
) -> Scenario:
    """Draw scenario ``index`` of a split of a family, for n craft, from the arguments alone.

    Errors are those of ``draw_many``.
    """
    return draw_many(family, seed, n, [(split, index)], problem)[0]


def draw_many(
    family: str, seed: int, n: int, which: Sequence[tuple[str, int]], problem: Problem
) -> list[Scenario]:
    """Draw scenarios by split and index, each as ``draw`` does, in a fraction of the time.

    InputError for an unknown family or split, n, seed or index out of range, or where no passively
    safe formation of n craft was found.
    """
    check_family(family)
    if not 1 <= n <= MOST_CRAFT:
        raise InputError(f"n is {n}; expected 1 to {MOST_CRAFT} spacecraft.")
    for split, index in which:
        if split not in SPLITS:
            raise InputError(f"split is {split!r}; expected one of {', '.join(SPLITS)}.")
        if not (0 <= seed < SEEDS and 0 <= index < SEEDS):
            raise InputError(
                f"seed is {seed} and index {index}; expected neither to be negative or above "
                f"{SEEDS - 1}."
            )
    found, portion = [], max(1, MOST_PAIRS // (BESIDE * n**2))
    for first in range(0, len(which), portion):
        some = which[first : first + portion]
        drawings = [
            FAMILIES[family](_Draw(_stream(seed, n, k, split), n, problem.collision_radius))
            for split, k in some
        ]
        for (split, k), (initial, goal) in zip(some, _drawn(drawings, problem), strict=True):
            name = scenario_id(family, seed, n, k, split)
            found.append(Scenario(problem, initial, goal, family, name))
    return found


def scenario_id(family: str, seed: int, n: int, index: int, split: str) -> str:
    """The name of a drawn scenario."""
    return f"{family}-s{seed}-n{n}-{split}-{index:06d}"


def _stream(seed: int, n: int, index: int, split: str) -> np.random.Generator:
    """The random numbers of a scenario."""
    return np.random.default_rng([seed, n, index, SPLITS.index(split)])


@dataclass(frozen=True)
class _Asked:
    """What a draw wants to know of one end's craft.

    Attributes:
        answer: the function that answers this of several draws at once.
        rows: states or elements of the craft.
        at_goal: whether the reference is at the last node, or at the first.
        added: craft whose pairs alone are asked about, or None.
    """

    answer: "Callable[[Sequence[_Asked], Problem], Iterable[Any]]"
    rows: Float[Array, "n _"]
    at_goal: bool
    added: Marked | None = None


def _drawn(drawings: Sequence[Drawing[Ends]], problem: Problem) -> list[Ends]:
    """Run draws side by side to their ends, questions of one kind answered together."""
    problems = problem, problem.starting_at(problem.intervals)
    ends: dict[int, Ends] = {}
    asked: dict[int, _Asked] = {}

    def go_on(k: int, answer: Any) -> None:
        try:
            asked[k] = drawings[k].send(answer)
        except StopIteration as done:
            ends[k] = done.value

    for k in range(len(drawings)):
        go_on(k, None)
    while asked:
        alike: dict[Any, list[int]] = {}
        for k, one in asked.items():
            alike.setdefault((one.answer, one.at_goal, len(one.rows)), []).append(k)
        for (answer, at_goal, _), which in alike.items():
            answers = answer([asked.pop(k) for k in which], problems[at_goal])
            for k, one in zip(which, answers, strict=True):
                go_on(k, one)
    return [ends[k] for k in range(len(drawings))]


def _states(asked: Sequence[_Asked], problem: Problem) -> list[Formation]:
    """States of craft on rings, m and m/s."""
    elements = np.concatenate([one.rows for one in asked])
    return np.split(ring_states(problem, *elements.T), len(asked))


def _safe(asked: Sequence[_Asked], problem: Problem) -> Bool[Array, "N"]:
    """Whether pairs, or those of added craft, stay further apart than r_col in free drift."""
    states, radius = np.stack([one.rows for one in asked]), problem.collision_radius
    # Most unsafe draws are, from the start; the rest takes longer to see.
    safe = node_collisions(states[:, :, None], radius) == 0
    left = np.flatnonzero(safe)
    if len(left):
        swarms = side_by_side((states.shape[1],) * len(left))
        marks = [one.added for k, one in enumerate(asked) if safe[k] and one.added is not None]
        drift = free_drift(states[left].reshape(-1, 6), problem)
        added = np.concatenate(marks) if marks else None
        found = close_approaches(*drift, within=radius, swarms=swarms, moved=added)
        safe[left[swarms.label[found.first]]] = False
    return safe


def _separations(asked: Sequence[_Asked], problem: Problem) -> Float[Array, "N"]:
    """The least separation of each formation in free drift, m."""
    return drift_separations(np.stack([one.rows for one in asked]), problem)


@dataclass(frozen=True)
class _Draw:
    """A random stream, and the end of a swarm that it draws formations for."""

    rng: np.random.Generator
    n: int
    radius: float  # collision radius, m
    at_goal: bool = False

    @property
    def goal(self) -> "_Draw":
        """The same where the reference is at the last node."""
        return replace(self, at_goal=True)

    @property
    def growth(self) -> float:
        """Factor of ring sizes."""
        return max(1.0, self.n / DENSITY_N)

    def angle(self) -> float:
        """Any angle, rad."""
        return float(self.rng.uniform(0, 2 * np.pi))

    def slots(self, count: int) -> Float[Array, "count"]:
        """Equally spaced phases from a random start, rad."""
        return self.rng.uniform(0, 2 * np.pi) + 2 * np.pi * np.arange(count) / max(count, 1)

    def sizes(self, rings: int) -> list[int]:
        """Numbers of craft of rings as equal as can be."""
        return [self.n // rings + (k < self.n % rings) for k in range(rings)]

    def ring_shape(self) -> tuple[float, float, float]:
        """Semi-major axis (m), tilt and cross phase (rad) of a random ring."""
        a = self.growth * self.rng.uniform(*SEMI_MAJOR_AXIS)
        return a, self.rng.uniform(-TILT, TILT), self.angle()

    def states(self, *rings: Elements) -> Drawing[Formation]:
        """States of the craft of some rings, m and m/s."""
        return (yield _Asked(_states, np.concatenate(rings), self.at_goal))

    def rings(self) -> Drawing[Formation]:
        """One or two random rings, with equal probability."""
        rings = []
        for count in self.sizes(int(self.rng.integers(1, 3))):
            a, tilt, cross = self.ring_shape()
            rings.append(_ring(a, tilt, self.slots(count), cross))
        return (yield from self.states(*rings))

    def is_safe(self, states: Formation, added: Marked | None = None) -> Drawing[bool]:
        """Whether pairs, or those of ``added`` craft, stay further apart than r_col in drift."""
        return bool((yield _Asked(_safe, states, self.at_goal, added)))

    def ends(self, initial: "Make", goal: "Make", safe: "Safe | None" = None) -> Drawing[Ends]:
        """Two formations, the goal's slots in random order."""
        both = []
        for make, draw in ((initial, self), (goal, self.goal)):
            both.append(
                (yield from _redrawn(partial(make, draw), partial(safe or _Draw.is_safe, draw)))
            )
        start, end = both
        return start, self.rng.permutation(end)


Make = Callable[[_Draw], Drawing[Formation]]
Safe = Callable[[_Draw, Formation], Drawing[bool]]


def _ring(
    a: float, tilt: float, phases: Float[Array, "m"], cross: float = 0.0, offset: float = 0.0
) -> Elements:
    """Elements of craft on one ring."""
    elements = np.empty((len(phases), 5))
    elements[:] = a, tilt, 0.0, cross, offset
    elements[:, 2] = phases
    return elements


def _redrawn(
    make: Callable[[], Drawing[Formation]], safe: Callable[[Formation], Drawing[bool]]
) -> Drawing[Formation]:
    """The first formation that is safe."""
    for _ in range(REDRAWS):
        states = yield from make()
        if (yield from safe(states)):
            return states
    raise InputError(
        f"no passively safe formation was found in {REDRAWS} draws; expected fewer spacecraft or "
        "a smaller collision_radius, so that they fit."
    )


def _rings(draw: _Draw) -> Drawing[Ends]:
    """One or two random rings at each end, goal slots in random order (the default)."""
    return draw.ends(_Draw.rings, _Draw.rings)


def _dense(draw: _Draw) -> Drawing[Ends]:
    """Rings as small as passive safety lets them be, goal slots in random order."""

    def formation(draw: _Draw) -> Drawing[Formation]:
        states = yield from draw.rings()
        if draw.n == 1:  # of the size of the collision radius
            return states * draw.radius / np.abs(states[:, :3]).max()
        # Free drift is linear, so separation grows and shrinks with the formation.
        apart = float((yield _Asked(_separations, states, draw.at_goal)))
        return states * DENSE * draw.radius / max(apart, 1e-9)

    def safe(draw: _Draw, states: Formation) -> Drawing[bool]:
        most = CROWDED * draw.radius * np.sqrt(draw.n)
        return np.abs(states[:, :3]).max() <= most and (yield from draw.is_safe(states))

    return draw.ends(formation, formation, safe)


def _split(draw: _Draw, sizes: tuple[float, float], tilts: tuple[float, float]) -> Drawing[Ends]:
    """The paper's Figure 1: a flat 200 m ring to two rings of half the craft each."""
    growth = draw.growth

    def ring(draw: _Draw) -> Drawing[Formation]:
        return draw.states(_ring(200.0 * growth, 0.0, draw.slots(draw.n)))

    def halves(draw: _Draw) -> Drawing[Formation]:
        cross = draw.angle()
        both = zip(draw.sizes(2), sizes, tilts, strict=True)
        rings = [_ring(a * growth, tilt, draw.slots(m), cross) for m, a, tilt in both]
        return draw.states(*rings)

    return draw.ends(ring, halves)


def _coplanar_split(draw: _Draw) -> Drawing[Ends]:
    """A 200 m ring to rings of 100 m and 300 m in the same plane (Figure 1, left)."""
    return _split(draw, (100.0, 300.0), (0.0, 0.0))


def _tilt_split(draw: _Draw) -> Drawing[Ends]:
    """A 200 m ring to two such rings slanted by ±45° (Figure 1, right)."""
    return _split(draw, (200.0, 200.0), (TILT, -TILT))


def _independent(draw: _Draw) -> Drawing[Ends]:
    """Each craft on a random PRO of its own, with an along-track offset of its own."""
    rng, growth = draw.rng, draw.growth

    def craft(draw: _Draw) -> Drawing[Formation]:
        a = growth * rng.uniform(*SEMI_MAJOR_AXIS)
        offset = growth * rng.uniform(-SEMI_MAJOR_AXIS[1], SEMI_MAJOR_AXIS[1])
        tilt, phase = rng.uniform(-TILT, TILT), np.array([draw.angle()])
        return draw.states(_ring(a, tilt, phase, draw.angle(), offset))

    def formation(draw: _Draw) -> Drawing[Formation]:
        placed = yield from craft(draw)
        while len(placed) < draw.n:
            one = yield from _redrawn(partial(craft, draw), partial(clear_of, draw, placed))
            placed = np.concatenate([placed, one])
        return placed

    def clear_of(draw: _Draw, placed: Formation, one: Float[Array, "1 6"]) -> Drawing[bool]:
        added = np.arange(len(placed) + 1) == len(placed)
        return draw.is_safe(np.concatenate([placed, one]), added)

    return (yield from formation(draw)), (yield from formation(draw.goal))


def _rotation(draw: _Draw) -> Drawing[Ends]:
    """The same ring at both ends, with its slots shifted or in reversed order."""
    rng, n = draw.rng, draw.n

    def ends() -> Drawing[Formation]:
        a, tilt, cross = draw.ring_shape()
        rings = [(one, _ring(a, tilt, one.slots(n), cross)) for one in (draw, draw.goal)]
        both = []
        for one, ring in rings:
            both.append((yield from one.states(ring)))
        return np.concatenate(both)

    def safe(both: Formation) -> Drawing[bool]:
        return (yield from draw.is_safe(both[:n])) and (yield from draw.goal.is_safe(both[n:]))

    initial, goal = np.split((yield from _redrawn(ends, safe)), 2)
    if rng.random() < 0.5:
        return initial, np.roll(goal, int(rng.integers(1, max(n, 2))), axis=0)
    return initial, goal[::-1].copy()


# Whose docstrings dataset cards show
FAMILIES: dict[str, Callable[[_Draw], Drawing[Ends]]] = {
    "rings": _rings,
    "coplanar-split": _coplanar_split,
    "tilt-split": _tilt_split,
    "dense": _dense,
    "independent": _independent,
    "rotation": _rotation,
}
