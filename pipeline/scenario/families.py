"""Families of random scenarios, each a function of root seed, n, index and split alone.

The split seeds the draw, so that a test scenario of one dataset is a training scenario of none,
whatever their seeds, sizes and shares. Both formations of every scenario are passively safe: in
free drift over a whole orbit no pair comes within the collision radius. Draws that are not are
drawn again from the same stream. Formations of all scenarios are checked by one call on arrays.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from pipeline.arrays import Array, Bool, Float
from pipeline.errors import InputError, check_choice, check_kind, check_whole
from pipeline.orbit.approaches import close_approaches
from pipeline.orbit.arrays import CraftMask, Formation
from pipeline.orbit.partition import MOST_PAIRS, swarm_partition
from pipeline.orbit.problem import Problem
from pipeline.orbit.rings import ring_states
from pipeline.orbit.separation import drift_separations, node_collisions
from pipeline.orbit.transfer import free_drift
from pipeline.scenario.scenario import MOST_CRAFT, Scenario

SEMI_MAJOR_AXIS = (100.0, 300.0)  # range of ring sizes a, m
TILT = np.deg2rad(45.0)  # largest ring tilt either way, rad
DENSITY_N = 30  # above this many craft the rings grow with n, so that the density stays
REDRAWS = 2000  # unsafe draws in a row after which drawing fails
SPLITS = ("train", "valid", "test")  # their order seeds the draw
SEEDS = 2**32  # bound of seeds, sizes and indices: each is one word of entropy
DENSE = 1.02  # least separation of a dense formation in free drift, in collision radii
CROWDED = 1.75  # largest half extent of a dense formation, in collision radii times √n
CACHES = 15  # pairs compared at once are so many times fewer than fit in memory, to fit in caches

EndFormations = tuple[Formation, Formation]
RingElements = Float[Array, "_ 5"]
"""Of craft on rings, a row each: a (m), tilt, phase, cross phase (rad) and offset (m)."""

Formations = Float[Array, "_ _ 6"]
"""A formation of each of several draws, m and m/s."""


def draw(
    family: str, seed: int, n: int, index: int, problem: Problem, split: str = "train"
) -> Scenario:
    """Draw scenario ``index`` of a split of a family, for n craft, from the arguments alone.

    InputErrors are those of ``draw_many``.
    """
    return draw_many(family, seed, n, [(split, index)], problem)[0]


def draw_many(
    family: str, seed: int, n: int, which: Sequence[tuple[str, int]], problem: Problem
) -> list[Scenario]:
    """Draw scenarios by split and index, each as ``draw`` does, in a fraction of the time.

    InputError for an unknown family or split, n, seed or index out of range, or where no passively
    safe formation of n craft was found.
    """
    check_choice("family", family, FAMILIES)
    check_kind("problem", problem, Problem)
    check_whole("n", n, 1, MOST_CRAFT)
    check_whole("seed", seed, 0, SEEDS - 1)
    for split, index in which:
        check_choice("split", split, SPLITS)
        check_whole("index", index, 0, SEEDS - 1)
    # As Python's integers, since numpy's overflow
    seed, n, which = int(seed), int(n), [(split, int(index)) for split, index in which]
    found, portion = [], max(1, MOST_PAIRS // (CACHES * n**2))
    for first in range(0, len(which), portion):
        some = which[first : first + portion]
        entropy = [[seed, n, k, SPLITS.index(split)] for split, k in some]
        draws = [_Draw(np.random.default_rng(words), n) for words in entropy]
        drawn = FAMILIES[family](draws, (problem, problem.starting_at(problem.intervals)))
        for (split, k), (initial, goal) in zip(some, drawn, strict=True):
            name = scenario_id(family, seed, n, k, split)
            found.append(Scenario(problem, initial, goal, family, name))
    return found


def scenario_id(family: str, seed: int, n: int, index: int, split: str) -> str:
    """The name of a drawn scenario."""
    return f"{family}-s{seed}-n{n}-{split}-{index:06d}"


@dataclass(frozen=True)
class _Draw:
    """The random stream of a scenario, and what is drawn of rings for its n craft."""

    rng: np.random.Generator
    n: int

    @property
    def growth(self) -> float:
        """Factor of ring sizes in swarms of more than DENSITY_N craft."""
        return max(1.0, self.n / DENSITY_N)

    def angle(self) -> float:
        """Any angle, rad."""
        return float(self.rng.uniform(0, 2 * np.pi))

    def slots(self, count: int) -> Float[Array, "count"]:
        """Equally spaced phases from a random start, rad."""
        return self.rng.uniform(0, 2 * np.pi) + 2 * np.pi * np.arange(count) / max(count, 1)

    def sizes(self, rings: int) -> list[int]:
        """Craft of each of some rings, as equal as possible."""
        return [self.n // rings + (k < self.n % rings) for k in range(rings)]

    def ring_shape(self) -> tuple[float, float, float]:
        """Semi-major axis (m), tilt and cross phase (rad) of a random ring."""
        a = self.growth * self.rng.uniform(*SEMI_MAJOR_AXIS)
        return a, self.rng.uniform(-TILT, TILT), self.angle()

    def rings(self) -> RingElements:
        """One or two random rings, with equal probability."""
        rings = []
        for count in self.sizes(int(self.rng.integers(1, 3))):
            a, tilt, cross = self.ring_shape()
            rings.append(_ring(a, tilt, self.slots(count), cross))
        return np.concatenate(rings)


_Draws = Sequence[_Draw]
Make = Callable[[_Draw], RingElements]
Safe = Callable[[Formations, Problem], Bool[Array, "b"]]
Problems = tuple[Problem, Problem]  # with the reference orbit as at the first and last node


def _ring(
    a: float, tilt: float, phases: Float[Array, "m"], cross: float = 0.0, offset: float = 0.0
) -> RingElements:
    return np.stack(np.broadcast_arrays(a, tilt, phases, cross, offset), axis=1)


def _states(elements: Sequence[RingElements], problem: Problem) -> Formations:
    """States of the craft of several draws, m and m/s."""
    return ring_states(problem, *np.concatenate(elements).T).reshape(len(elements), -1, 6)


def _safe(states: Formations, problem: Problem, added: CraftMask | None = None) -> Bool[Array, "b"]:
    """Whether all pairs, or all pairs of added craft, stay beyond r_col in free drift."""
    n, radius = states.shape[1], problem.collision_radius
    # Most unsafe draws are, from the start; the rest takes longer to see.
    safe = node_collisions(states[:, :, None], radius) == 0
    left = np.flatnonzero(safe)
    if len(left):
        swarms = swarm_partition((n,) * len(left))
        drift = free_drift(states[left].reshape(-1, 6), problem)
        moved = None if added is None else np.tile(added, len(left))
        found = close_approaches(*drift, within=radius, swarms=swarms, moved=moved)
        safe[left[swarms.label[found.first]]] = False
    return safe


def _first_safe(
    count: int, make: Callable[[list[int]], Formations], safe: Callable[[Formations], CraftMask]
) -> Formations:
    """The first safe formation of each draw; ``make`` draws one for each of the given indices."""
    found: dict[int, Formation] = {}
    for _ in range(REDRAWS):
        left = [k for k in range(count) if k not in found]
        states = make(left)
        found |= {left[k]: states[k] for k in np.flatnonzero(safe(states))}
        if len(found) == count:
            return np.stack([found[k] for k in range(count)])
    raise InputError(
        f"no passively safe formation was found in {REDRAWS} draws; expected fewer spacecraft or "
        "a smaller collision_radius, so that they fit."
    )


def _both_ends(
    draws: _Draws,
    problems: Problems,
    initial: Make,
    goal: Make,
    states: Callable[[Sequence[RingElements], Problem], Formations] = _states,
    safe: Safe = _safe,
) -> list[EndFormations]:
    """Two formations of each draw, the goal's slots in random order."""

    def formations(elements: Make, problem: Problem) -> Formations:
        def make(left: list[int]) -> Formations:
            return states([elements(draws[k]) for k in left], problem)

        return _first_safe(len(draws), make, lambda states: safe(states, problem))

    start, end = map(formations, (initial, goal), problems)
    return [(start[k], draw.rng.permutation(end[k])) for k, draw in enumerate(draws)]


def _rings(draws: _Draws, problems: Problems) -> list[EndFormations]:
    """One or two random rings at each end, goal slots in random order (the default)."""
    return _both_ends(draws, problems, _Draw.rings, _Draw.rings)


def _dense(draws: _Draws, problems: Problems) -> list[EndFormations]:
    """Rings as small as passive safety lets them be, goal slots in random order."""
    n, radius = draws[0].n, problems[0].collision_radius

    def scaled(elements: Sequence[RingElements], problem: Problem) -> Formations:
        states = _states(elements, problem)
        if n == 1:  # of the size of the collision radius
            return states * radius / np.abs(states[..., :3]).max(axis=(1, 2), keepdims=True)
        # Free drift is linear, so separation grows and shrinks with the formation.
        apart = np.maximum(drift_separations(states, problem), 1e-9)
        return states * DENSE * radius / apart[:, None, None]

    def safe(states: Formations, problem: Problem) -> Bool[Array, "b"]:
        fine = np.abs(states[..., :3]).max(axis=(1, 2)) <= CROWDED * radius * np.sqrt(n)
        fine[fine] = _safe(states[fine], problem)
        return fine

    return _both_ends(draws, problems, _Draw.rings, _Draw.rings, scaled, safe)


def _split(
    draws: _Draws, problems: Problems, sizes: tuple[float, float], tilts: tuple[float, float]
) -> list[EndFormations]:
    """The paper's Figure 1: a flat 200 m ring to two rings of half the craft each."""

    def ring(draw: _Draw) -> RingElements:
        return _ring(200.0 * draw.growth, 0.0, draw.slots(draw.n))

    def halves(draw: _Draw) -> RingElements:
        cross = draw.angle()
        both = zip(draw.sizes(2), sizes, tilts, strict=True)
        rings = [_ring(a * draw.growth, tilt, draw.slots(m), cross) for m, a, tilt in both]
        return np.concatenate(rings)

    return _both_ends(draws, problems, ring, halves)


def _coplanar_split(draws: _Draws, problems: Problems) -> list[EndFormations]:
    """A 200 m ring to rings of 100 m and 300 m in the same plane (Figure 1, left)."""
    return _split(draws, problems, (100.0, 300.0), (0.0, 0.0))


def _tilt_split(draws: _Draws, problems: Problems) -> list[EndFormations]:
    """A 200 m ring to two such rings of tilt ±45° (at a cross phase of 0: Figure 1, right)."""
    return _split(draws, problems, (200.0, 200.0), (TILT, -TILT))


def _independent(draws: _Draws, problems: Problems) -> list[EndFormations]:
    """Each craft on a random PRO of its own, with an along-track offset of its own."""

    def craft(draw: _Draw) -> RingElements:
        rng, growth = draw.rng, draw.growth
        a = growth * rng.uniform(*SEMI_MAJOR_AXIS)
        offset = growth * rng.uniform(-SEMI_MAJOR_AXIS[1], SEMI_MAJOR_AXIS[1])
        tilt, phase = rng.uniform(-TILT, TILT), np.array([draw.angle()])
        return _ring(a, tilt, phase, draw.angle(), offset)

    def with_next(states: Formations, problem: Problem, left: list[int]) -> Formations:
        return np.hstack([states[left], _states([craft(draws[k]) for k in left], problem)])

    def formations(problem: Problem) -> Formations:
        states = _states([craft(draw) for draw in draws], problem)
        while (placed := states.shape[1]) < draws[0].n:
            added = np.arange(placed + 1) == placed
            safe = partial(_safe, problem=problem, added=added)
            states = _first_safe(len(draws), partial(with_next, states, problem), safe)
        return states

    return [*zip(*map(formations, problems), strict=True)]


def _rotation(draws: _Draws, problems: Problems) -> list[EndFormations]:
    """The same ring at both ends, with its slots shifted or in reversed order."""
    n = draws[0].n

    def rings(draw: _Draw) -> list[RingElements]:
        a, tilt, cross = draw.ring_shape()
        return [_ring(a, tilt, draw.slots(n), cross) for _ in problems]

    def ends(left: list[int]) -> Formations:
        both = zip(*[rings(draws[k]) for k in left], strict=True)
        return np.hstack([*map(_states, both, problems)])

    def safe(both: Formations) -> CraftMask:
        fine = _safe(both[:, :n], problems[0])
        fine[fine] = _safe(both[fine, n:], problems[1])
        return fine

    def permuted(draw: _Draw, goal: Formation) -> Formation:
        if draw.rng.random() < 0.5:
            return np.roll(goal, int(draw.rng.integers(1, max(n, 2))), axis=0)
        return goal[::-1].copy()

    found = _first_safe(len(draws), ends, safe)
    return [(both[:n], permuted(draw, both[n:])) for draw, both in zip(draws, found, strict=True)]


# Whose docstrings dataset cards show
FAMILIES: dict[str, Callable[[_Draws, Problems], list[EndFormations]]] = {
    "rings": _rings,
    "coplanar-split": _coplanar_split,
    "tilt-split": _tilt_split,
    "dense": _dense,
    "independent": _independent,
    "rotation": _rotation,
}
