"""Families of random scenarios, each a function of root seed, n, index and split alone.

The split seeds the draw, so that a test scenario of one dataset is a training scenario of none,
whatever their seeds, sizes and shares. Both formations of every scenario are passively safe: in
free drift over a whole orbit no pair comes within the collision radius. Draws that are not are
drawn again from the same stream.
"""

from collections.abc import Callable
from functools import partial

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.errors import InputError
from pipeline.orbit.approaches import close_approaches, pairs
from pipeline.orbit.arrays import Formation, Marked
from pipeline.orbit.problem import Problem
from pipeline.orbit.rings import pro_states
from pipeline.orbit.separation import drift_separations
from pipeline.orbit.transfer import free_drift
from pipeline.scenario.scenario import MOST_CRAFT, Scenario

SEMI_MAJOR_AXIS = (100.0, 300.0)  # range of ring sizes a, m
TILT = np.deg2rad(45.0)  # largest ring tilt either way, rad
DENSITY_N = 30  # above this many craft the rings grow with n, so that the density stays
REDRAWS = 2000  # tries after which a formation is said not to fit
SPLITS = ("train", "valid", "test")  # their order seeds the draw
# Root seeds, sizes and indices are below this: each is one word of the generator's entropy
SEEDS = 2**32
DENSE = 1.02  # least separation of a dense formation in free drift, in collision radii
# Largest half extent of a dense formation, in collision radii times the square root of n
CROWDED = 1.75

Rng = np.random.Generator
Ends = tuple[Formation, Formation]


def check_family(family: str) -> None:
    """Refuse an unknown family with an InputError."""
    if family not in FAMILIES:
        raise InputError(f"family is {family!r}; expected one of {', '.join(FAMILIES)}.")


def draw(
    family: str, seed: int, n: int, index: int, problem: Problem, split: str = "train"
) -> Scenario:
    """Draw scenario ``index`` of a split of a family, from the arguments alone.

    Args:
        family: of FAMILIES.
        seed: root seed.
        n: number of spacecraft.
        index: number of the scenario within its split.
        problem: orbit, time grid and collision radius.
        split: of SPLITS; no scenario of one is ever drawn for another.

    Raises:
        InputError: for an unknown family or split, n, seed or index out of range, or where no
            passively safe formation of n craft was found.
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
    initial, goal = FAMILIES[family](rng, n, problem)
    return Scenario(problem, initial, goal, family, scenario_id(family, seed, n, index, split))


def scenario_id(family: str, seed: int, n: int, index: int, split: str) -> str:
    """The name of a drawn scenario."""
    return f"{family}-s{seed}-n{n}-{split}-{index:06d}"


def passively_safe(states: Formation, problem: Problem, *, added: Marked | None = None) -> bool:
    """Whether every pair stays further apart than r_col in free drift over a whole orbit.

    Where ``added`` marks craft, pairs of others are known to.
    """
    i, j = pairs(len(states))
    if (np.linalg.norm((states[i] - states[j])[:, :3], axis=1) <= problem.collision_radius).any():
        return False  # most unsafe draws are, from the start; the rest takes longer to see
    drift = free_drift(states, problem)
    found = close_approaches(*drift, within=problem.collision_radius, moved=added)
    return len(found.first) == 0


def _redraw(make: Callable[[], Formation], safe: Callable[[Formation], bool]) -> Formation:
    for _ in range(REDRAWS):
        states = make()
        if safe(states):
            return states
    raise InputError(
        f"no passively safe formation was found in {REDRAWS} draws; expected fewer spacecraft or "
        "a smaller collision_radius, so that they fit."
    )


def _growth(n: int) -> float:
    """Factor of ring sizes."""
    return max(1.0, n / DENSITY_N)


def _sizes(n: int, rings: int) -> list[int]:
    """Numbers of craft of rings as equal as can be."""
    return [n // rings + (k < n % rings) for k in range(rings)]


def _slots(rng: Rng, count: int) -> Float[Array, "count"]:
    """Equally spaced phases from a random start, rad."""
    return rng.uniform(0, 2 * np.pi) + 2 * np.pi * np.arange(count) / max(count, 1)


def _angle(rng: Rng) -> float:
    return float(rng.uniform(0, 2 * np.pi))


def _rings_formation(rng: Rng, n: int, problem: Problem) -> Formation:
    """One or two random rings, with equal probability."""
    rings = []
    for count in _sizes(n, int(rng.integers(1, 3))):
        a = _growth(n) * rng.uniform(*SEMI_MAJOR_AXIS)
        tilt = rng.uniform(-TILT, TILT)
        cross = _angle(rng)
        rings.append(pro_states(a, tilt, _slots(rng, count), cross, problem.mean_motion))
    return np.concatenate(rings)


def rings(rng: Rng, n: int, problem: Problem) -> Ends:
    """One or two random rings at each end, goal slots in random order (the default)."""
    formation = partial(_rings_formation, rng, n, problem)
    safe = partial(passively_safe, problem=problem)
    initial = _redraw(formation, safe)
    return initial, rng.permutation(_redraw(formation, safe))


def dense(rng: Rng, n: int, problem: Problem) -> Ends:
    """Rings as small as passive safety lets them be, goal slots in random order."""

    def formation() -> Formation:
        states = _rings_formation(rng, n, problem)
        if n == 1:  # of the size of the collision radius
            return states * problem.collision_radius / np.abs(states[:, :3]).max()
        # Free drift is linear, so separation grows and shrinks with the formation.
        apart = float(drift_separations(states[None], problem)[0])
        return states * DENSE * problem.collision_radius / max(apart, 1e-9)

    def safe(states: Formation) -> bool:
        most = CROWDED * problem.collision_radius * np.sqrt(n)
        return bool(np.abs(states[:, :3]).max() <= most) and passively_safe(states, problem)

    initial = _redraw(formation, safe)
    return initial, rng.permutation(_redraw(formation, safe))


def _split(
    rng: Rng, n: int, problem: Problem, sizes: tuple[float, float], tilts: tuple[float, float]
) -> Ends:
    """The paper's Figure 1: a flat 200 m ring to two rings of half the craft each."""
    e, growth = problem.mean_motion, _growth(n)

    def ring() -> Formation:
        return pro_states(200.0 * growth, 0.0, _slots(rng, n), 0.0, e)

    def halves() -> Formation:
        cross = _angle(rng)
        both = zip(_sizes(n, 2), sizes, tilts, strict=True)
        return np.concatenate(
            [pro_states(a * growth, tilt, _slots(rng, m), cross, e) for m, a, tilt in both]
        )

    safe = partial(passively_safe, problem=problem)
    initial = _redraw(ring, safe)
    return initial, rng.permutation(_redraw(halves, safe))


def coplanar_split(rng: Rng, n: int, problem: Problem) -> Ends:
    """A 200 m ring to rings of 100 m and 300 m in the same plane (Figure 1, left)."""
    return _split(rng, n, problem, (100.0, 300.0), (0.0, 0.0))


def tilt_split(rng: Rng, n: int, problem: Problem) -> Ends:
    """A 200 m ring to two such rings slanted by ±45° (Figure 1, right)."""
    return _split(rng, n, problem, (200.0, 200.0), (TILT, -TILT))


def independent(rng: Rng, n: int, problem: Problem) -> Ends:
    """Each craft on a random PRO of its own, with an along-track offset of its own."""
    growth = _growth(n)

    def craft() -> Formation:
        a = growth * rng.uniform(*SEMI_MAJOR_AXIS)
        offset = growth * rng.uniform(-SEMI_MAJOR_AXIS[1], SEMI_MAJOR_AXIS[1])
        tilt, phase = rng.uniform(-TILT, TILT), np.array([_angle(rng)])
        return pro_states(a, tilt, phase, _angle(rng), problem.mean_motion, offset)

    def formation() -> Formation:
        placed = craft()
        while len(placed) < n:
            clear = partial(_clear_of, placed=placed, problem=problem)
            placed = np.concatenate([placed, _redraw(craft, clear)])
        return placed

    return formation(), formation()


def _clear_of(one: Float[Array, "1 6"], placed: Formation, problem: Problem) -> bool:
    added = np.arange(len(placed) + 1) == len(placed)
    return passively_safe(np.concatenate([placed, one]), problem, added=added)


def rotation(rng: Rng, n: int, problem: Problem) -> Ends:
    """The same ring at both ends, with its slots shifted or in reversed order."""

    def ends() -> Formation:
        a = _growth(n) * rng.uniform(*SEMI_MAJOR_AXIS)
        tilt, cross = rng.uniform(-TILT, TILT), _angle(rng)
        phases = np.concatenate([_slots(rng, n), _slots(rng, n)])
        return pro_states(a, tilt, phases, cross, problem.mean_motion)

    def safe(both: Formation) -> bool:
        return passively_safe(both[:n], problem) and passively_safe(both[n:], problem)

    initial, goal = np.split(_redraw(ends, safe), 2)
    if rng.random() < 0.5:
        return initial, np.roll(goal, int(rng.integers(1, max(n, 2))), axis=0)
    return initial, goal[::-1].copy()


FAMILIES: dict[str, Callable[[Rng, int, Problem], Ends]] = {
    "rings": rings,
    "coplanar-split": coplanar_split,
    "tilt-split": tilt_split,
    "dense": dense,
    "independent": independent,
    "rotation": rotation,
}
