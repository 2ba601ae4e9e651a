"""Families of random scenarios, each a function of root seed, n, index and split alone.

The split seeds the draw, so that a test scenario of one dataset is a training scenario of none,
whatever their seeds, sizes and shares. Both formations of every scenario are passively safe: in
free drift over a whole orbit no pair comes within the collision radius. Draws that are not are
drawn again from the same stream.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.errors import InputError
from pipeline.orbit.approaches import close_approaches, pairs
from pipeline.orbit.arrays import Formation, Marked
from pipeline.orbit.problem import Problem
from pipeline.orbit.relative_elements import ring_states
from pipeline.orbit.separation import drift_separations
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

Ends = tuple[Formation, Formation]


def check_family(family: str) -> None:
    """Refuse an unknown family with an InputError."""
    if family not in FAMILIES:
        raise InputError(f"family is {family!r}; expected one of {', '.join(FAMILIES)}.")


def draw(
    family: str, seed: int, n: int, index: int, problem: Problem, split: str = "train"
) -> Scenario:
    """Draw scenario ``index`` of a split of a family, for n craft, from the arguments alone.

    InputError for an unknown family or split, n, seed or index out of range, or where no passively
    safe formation of n craft was found.
    """
    check_family(family)
    if split not in SPLITS:
        raise InputError(f"split is {split!r}; expected one of {', '.join(SPLITS)}.")
    if not 1 <= n <= MOST_CRAFT:
        raise InputError(f"n is {n}; expected 1 to {MOST_CRAFT} spacecraft.")
    if not (0 <= seed < SEEDS and 0 <= index < SEEDS):
        raise InputError(
            f"seed is {seed} and index {index}; expected neither to be negative or above "
            f"{SEEDS - 1}."
        )
    rng = np.random.default_rng([seed, n, index, SPLITS.index(split)])
    initial, goal = FAMILIES[family](_Draw(rng, n, problem))
    return Scenario(problem, initial, goal, family, scenario_id(family, seed, n, index, split))


def scenario_id(family: str, seed: int, n: int, index: int, split: str) -> str:
    """The name of a drawn scenario."""
    return f"{family}-s{seed}-n{n}-{split}-{index:06d}"


@dataclass(frozen=True)
class _Draw:
    """A random stream, and the swarm that it draws formations of."""

    rng: np.random.Generator
    n: int
    problem: Problem

    @property
    def goal(self) -> "_Draw":
        """The same where the reference is at the last node."""
        return replace(self, problem=self.problem.starting_at(self.problem.intervals))

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

    def rings(self) -> Formation:
        """One or two random rings, with equal probability."""
        rings = []
        for count in self.sizes(int(self.rng.integers(1, 3))):
            a, tilt, cross = self.ring_shape()
            rings.append(ring_states(self.problem, a, tilt, self.slots(count), cross))
        return np.concatenate(rings)

    def is_safe(self, states: Formation, added: Marked | None = None) -> bool:
        """Whether pairs, or those of ``added`` craft, stay further apart than r_col in drift."""
        radius, (i, j) = self.problem.collision_radius, pairs(len(states))
        if (np.linalg.norm((states[i] - states[j])[:, :3], axis=1) <= radius).any():
            return False  # most unsafe draws are, from the start; the rest takes longer to see
        found = close_approaches(*free_drift(states, self.problem), within=radius, moved=added)
        return len(found.first) == 0

    def ends(self, initial: "Make", goal: "Make", safe: "Safe | None" = None) -> Ends:
        """Two formations, the goal's slots in random order."""
        start, end = (
            _redraw(partial(make, draw), partial(safe or _Draw.is_safe, draw))
            for make, draw in ((initial, self), (goal, self.goal))
        )
        return start, self.rng.permutation(end)


Make = Callable[[_Draw], Formation]
Safe = Callable[[_Draw, Formation], bool]


def _redraw(make: Callable[[], Formation], safe: Callable[[Formation], bool]) -> Formation:
    for _ in range(REDRAWS):
        states = make()
        if safe(states):
            return states
    raise InputError(
        f"no passively safe formation was found in {REDRAWS} draws; expected fewer spacecraft or "
        "a smaller collision_radius, so that they fit."
    )


def _rings(draw: _Draw) -> Ends:
    """One or two random rings at each end, goal slots in random order (the default)."""
    return draw.ends(_Draw.rings, _Draw.rings)


def _dense(draw: _Draw) -> Ends:
    """Rings as small as passive safety lets them be, goal slots in random order."""
    radius = draw.problem.collision_radius

    def formation(draw: _Draw) -> Formation:
        states = draw.rings()
        if draw.n == 1:  # of the size of the collision radius
            return states * radius / np.abs(states[:, :3]).max()
        # Free drift is linear, so separation grows and shrinks with the formation.
        apart = float(drift_separations(states[None], draw.problem)[0])
        return states * DENSE * radius / max(apart, 1e-9)

    def safe(draw: _Draw, states: Formation) -> bool:
        most = CROWDED * radius * np.sqrt(draw.n)
        return bool(np.abs(states[:, :3]).max() <= most) and draw.is_safe(states)

    return draw.ends(formation, formation, safe)


def _split(draw: _Draw, sizes: tuple[float, float], tilts: tuple[float, float]) -> Ends:
    """The paper's Figure 1: a flat 200 m ring to two rings of half the craft each."""
    growth = draw.growth

    def ring(draw: _Draw) -> Formation:
        return ring_states(draw.problem, 200.0 * growth, 0.0, draw.slots(draw.n))

    def halves(draw: _Draw) -> Formation:
        cross, about = draw.angle(), draw.problem
        both = zip(draw.sizes(2), sizes, tilts, strict=True)
        return np.concatenate(
            [ring_states(about, a * growth, tilt, draw.slots(m), cross) for m, a, tilt in both]
        )

    return draw.ends(ring, halves)


def _coplanar_split(draw: _Draw) -> Ends:
    """A 200 m ring to rings of 100 m and 300 m in the same plane (Figure 1, left)."""
    return _split(draw, (100.0, 300.0), (0.0, 0.0))


def _tilt_split(draw: _Draw) -> Ends:
    """A 200 m ring to two such rings slanted by ±45° (Figure 1, right)."""
    return _split(draw, (200.0, 200.0), (TILT, -TILT))


def _independent(draw: _Draw) -> Ends:
    """Each craft on a random PRO of its own, with an along-track offset of its own."""
    rng, growth = draw.rng, draw.growth

    def craft(draw: _Draw) -> Formation:
        a = growth * rng.uniform(*SEMI_MAJOR_AXIS)
        offset = growth * rng.uniform(-SEMI_MAJOR_AXIS[1], SEMI_MAJOR_AXIS[1])
        tilt, phase = rng.uniform(-TILT, TILT), np.array([draw.angle()])
        return ring_states(draw.problem, a, tilt, phase, draw.angle(), offset)

    def formation(draw: _Draw) -> Formation:
        placed = craft(draw)
        while len(placed) < draw.n:
            one = _redraw(partial(craft, draw), partial(clear_of, draw, placed))
            placed = np.concatenate([placed, one])
        return placed

    def clear_of(draw: _Draw, placed: Formation, one: Float[Array, "1 6"]) -> bool:
        added = np.arange(len(placed) + 1) == len(placed)
        return draw.is_safe(np.concatenate([placed, one]), added)

    return formation(draw), formation(draw.goal)


def _rotation(draw: _Draw) -> Ends:
    """The same ring at both ends, with its slots shifted or in reversed order."""
    rng, n = draw.rng, draw.n

    def ends() -> Formation:
        a, tilt, cross = draw.ring_shape()
        both = [(one, one.slots(n)) for one in (draw, draw.goal)]
        rings = [ring_states(one.problem, a, tilt, slots, cross) for one, slots in both]
        return np.concatenate(rings)

    def safe(both: Formation) -> bool:
        return draw.is_safe(both[:n]) and draw.goal.is_safe(both[n:])

    initial, goal = np.split(_redraw(ends, safe), 2)
    if rng.random() < 0.5:
        return initial, np.roll(goal, int(rng.integers(1, max(n, 2))), axis=0)
    return initial, goal[::-1].copy()


# Whose docstrings dataset cards show
FAMILIES: dict[str, Callable[[_Draw], Ends]] = {
    "rings": _rings,
    "coplanar-split": _coplanar_split,
    "tilt-split": _tilt_split,
    "dense": _dense,
    "independent": _independent,
    "rotation": _rotation,
}
