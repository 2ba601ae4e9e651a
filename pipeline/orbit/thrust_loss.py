"""What follows a loss of thrust: a craft adrift among others that fly their plan, soundly.

At a node one craft loses its thrust and drifts on from there; the others fly their plan to its end
and then drift on from their goals. All of it is linear motion under controls that are constant over
intervals, so two craft are closest where two that fly would be: nothing is sampled.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.arrays import Array
from pipeline.errors import InputError
from pipeline.orbit.approaches import (
    Swarms,
    close_approaches,
    least_of_each,
    passes,
    rounding,
    side_by_side,
)
from pipeline.orbit.bezier import norm
from pipeline.orbit.drift import free_drift
from pipeline.orbit.dynamics import Dynamics
from pipeline.orbit.problem import RANGES, Problem

MOST_ORBITS = 100.0
"""Longest drift that is looked at; over so many orbits linear motion says little of the real."""

AT_ONCE = 1_000_000
"""Pairs and intervals that are compared at once, which bounds the memory that it takes."""

NO_LENGTH = 1e-9
"""A rest of an interval below this share of it is rounding."""

SHORTEST = 2 * RANGES["time_step"][0]
"""Drift in s below which nothing is proven of the ends alone; plans are held to it all the same."""

Ball = tuple[Float[Array, "*batch 3"], Float[Array, "*batch"]]
"""Middle and radius, m."""

Which = tuple[Int[Array, "k"], Int[Array, "k"], Int[Array, "k"], Int[Array, "k"]]
"""The craft adrift, the node at which it lost its thrust, the other craft, and the interval."""


def check_orbits(orbits: float) -> None:
    """Refuse what is no length of a drift.

    Raises:
        InputError: with what was given and what was expected.
    """
    if not 0 < orbits <= MOST_ORBITS:  # nor what is no number
        raise InputError(
            f"passive safety is asked for over {orbits:g} orbits; expected a number above 0 and at "
            f"most {MOST_ORBITS:g}."
        )


@dataclass(frozen=True, eq=False)
class Encounters:
    """Where a craft adrift and one that flies on are closest within an interval, one entry each.

    Attributes:
        lost: the craft adrift.
        node: at which it lost its thrust; the last one, where it has none left to lose.
        other: the craft that flies on.
        interval: which interval, counted from the first node, and on beyond the last one.
        offset: time since the interval's start, s.
        distance: separation at that time, m.
        bound: no separation of the two in the interval is below this, m.
        free: from a state at the interval's start to the position then, (k, 3, 6).
        pushed: the same of the control in the interval, (k, 3, 3).
    """

    lost: Int[Array, "k"]
    node: Int[Array, "k"]
    other: Int[Array, "k"]
    interval: Int[Array, "k"]
    offset: Float[Array, "k"]
    distance: Float[Array, "k"]
    bound: Float[Array, "k"]
    free: Float[Array, "k 3 6"]
    pushed: Float[Array, "k 3 3"]

    def where(self, keep: Bool[Array, "k"]) -> "Encounters":
        """Some of them."""
        return Encounters(*(part[keep] for part in vars(self).values()))


_NONE, _EMPTY = np.zeros(0, dtype=int), np.zeros(0)
NO_ENCOUNTERS = Encounters(
    *(_NONE,) * 4, *(_EMPTY,) * 3, free=np.zeros((0, 3, 6)), pushed=np.zeros((0, 3, 3))
)


@dataclass(frozen=True)
class LossSeparation:
    """The least separation of a craft adrift and another.

    Attributes:
        distance: the separation attained, m.
        bound: no craft adrift is ever closer to another than this, m.
        pair: the craft adrift and the one that it meets.
        node: at which the first lost its thrust; the last one: both drift on from their goals.
        time: when, s since the first node.
    """

    distance: float
    bound: float
    pair: tuple[int, int]
    node: int
    time: float


def loss_encounters(
    states: Float[Array, "n T 6"],
    controls: Float[Array, "n intervals 3"],
    problem: Problem,
    orbits: float,
    within: float | Float[Array, "swarms"],
    *,
    swarms: Swarms | None = None,
    moved: Bool[Array, "n"] | None = None,
) -> Encounters:
    """Where craft adrift may come within a distance of others, at any time of so many orbits.

    Args:
        states: node states, m and m/s.
        controls: constant over each interval, m/s².
        problem: dynamics and time step.
        orbits: how long a craft drifts, from every node on.
        within: distance of interest, m, of all swarms or of each.
        swarms: which craft belong together; by default all of them.
        moved: leave out what the controls of the craft marked here have no say in.

    Returns:
        An entry for each craft adrift, node, other craft and interval whose lower bound is at
        most ``within``.
    """
    swarms = swarms or side_by_side((len(states),))
    reach = np.broadcast_to(within, len(swarms.sizes))[swarms.label]
    flight = _Flight.of(states, controls, problem, orbits)
    looked = _Looked(flight.last, swarms, moved)
    found = []
    for length, since in flight.pieces:
        near = list(_candidates(flight, length, since, reach, looked))
        if near:
            lost, node, other, interval = map(np.concatenate, zip(*near, strict=True))
            found.append(_closest(flight, length, reach, (lost, node, other, interval)))
    if not found:
        return NO_ENCOUNTERS
    return Encounters(*map(np.concatenate, zip(*found, strict=True)))


def least_after_loss(
    states: Float[Array, "n T 6"],
    controls: Float[Array, "n intervals 3"],
    problem: Problem,
    orbits: float,
    swarms: Swarms,
) -> list[LossSeparation | None]:
    """The least distance of a craft adrift to another, of each swarm; None for a craft alone.

    As in ``least_separations``, the least at the time steps of the drifts bounds it from above, and
    is the least where rounding hides it from the search.
    """
    closest = _closest_at_steps(_Flight.of(states, controls, problem, orbits), swarms)
    within = np.array([0.0 if one is None else one.distance for one in closest])
    found = loss_encounters(states, controls, problem, orbits, within, swarms=swarms)
    time = found.interval * problem.time_step + found.offset
    label, begin = swarms.label[found.lost], swarms.starts
    bound = np.full(len(closest), np.inf)
    np.minimum.at(bound, label, found.bound)
    for swarm, k in np.transpose(least_of_each(found.distance, label)).tolist():
        closest[swarm] = LossSeparation(
            distance=float(found.distance[k]),
            bound=float(bound[swarm]),
            pair=(int(found.lost[k] - begin[swarm]), int(found.other[k] - begin[swarm])),
            node=int(found.node[k]),
            time=float(time[k]),
        )
    return closest


def unavoidable(
    initial: Float[Array, "n 6"], goal: Float[Array, "n 6"], problem: Problem, orbits: float
) -> LossSeparation | None:
    """The closest that craft adrift come to others by the ends alone, where that is too close.

    A craft that loses its thrust at the first node drifts on from its start, and after the plan the
    others drift on from their goals: no plan has a say in either. Nor has it after the last node,
    when all drift on from their goals.

    Args:
        initial: states at the first node, m and m/s.
        goal: states at the last.
        problem: dynamics, duration and collision radius.
        orbits: how long a craft drifts.
    """
    met = [_met_adrift(goal, problem, orbits, problem.nodes - 1, len(goal))]
    longer = orbits - problem.duration * problem.mean_motion / (2 * np.pi)
    if _is_drift(longer, problem):
        A, _ = problem.dynamics.step(problem.duration)
        both = np.concatenate([initial @ A.T, goal])  # where they are when the plan ends
        met.append(_met_adrift(both, problem, longer, 0, len(goal)))
    return min(filter(None, met), key=lambda one: one.distance, default=None)


def forced_goals(
    initial: Float[Array, "n 6"], goal: Float[Array, "n 6"], problem: Problem, orbits: float
) -> Bool[Array, "n n"]:
    """Which goals craft may take, by craft and goal, where goals are not given out yet.

    Who drifts from its start into one that drifts on from some goal must take that goal itself;
    none may take any where two goals drift into each other.

    Args:
        initial: states at the first node, m and m/s.
        goal: states at the last.
        problem: dynamics, duration and collision radius.
        orbits: how long a craft drifts.
    """
    n = len(goal)
    allowed = np.ones((n, n), dtype=bool)
    if _met_adrift(goal, problem, orbits, problem.nodes - 1, n) is not None:
        return ~allowed
    longer = orbits - problem.duration * problem.mean_motion / (2 * np.pi)
    if _is_drift(longer, problem):
        A, _ = problem.dynamics.step(problem.duration)
        flown, idle, drift = free_drift(np.concatenate([initial @ A.T, goal]), problem, longer)
        found = close_approaches(flown, idle, drift, problem.collision_radius)
        met = (found.distance <= problem.collision_radius) & (found.first < n) & (found.second >= n)
        for craft, taken in zip(found.first[met], found.second[met] - n, strict=True):
            allowed[craft] &= np.arange(n) == taken
    return allowed


def _met_adrift(
    states: Float[Array, "k 6"], problem: Problem, orbits: float, node: int, n: int
) -> LossSeparation | None:
    """Who drifts into whom from the plan's end on: of n craft, or the first n into the next."""
    if not _is_drift(orbits, problem):
        return None
    flown, idle, drift = free_drift(states, problem, orbits)
    found = close_approaches(flown, idle, drift, problem.collision_radius)
    hit = found.distance <= problem.collision_radius
    if len(states) > n:
        hit &= (found.first < n) & (found.second >= n) & (found.second - n != found.first)
    if not hit.any():
        return None
    k = np.flatnonzero(hit)[found.distance[hit].argmin()]
    return LossSeparation(
        distance=float(found.distance[k]),
        bound=float(found.bound[k]),
        pair=(int(found.first[k]), int(found.second[k]) % n),
        node=node,
        time=float(problem.duration + found.interval[k] * drift.time_step + found.offset[k]),
    )


def _is_drift(orbits: float, problem: Problem) -> bool:
    """Whether a drift is long enough that something is proven of it alone."""
    return orbits * 2 * np.pi / problem.mean_motion >= SHORTEST


@dataclass(frozen=True, eq=False)
class _Flight:
    """A plan flown to its end, with the drift from the goals that follows.

    Attributes:
        states: at nodes, and at every further time step of the drift, (n, T + M, 6), m and m/s.
        controls: zero after the plan, (n, T + M, 3), m/s².
        problem: the plan's.
        drift: powers of A, (M + 1, 6, 6).
        rest: what is left of a drift after M time steps, s.
    """

    states: Float[Array, "n _ 6"]
    controls: Float[Array, "n _ 3"]
    problem: Problem
    drift: Float[Array, "_ 6 6"]
    rest: float

    @classmethod
    def of(
        cls,
        states: Float[Array, "n T 6"],
        controls: Float[Array, "n intervals 3"],
        problem: Problem,
        orbits: float,
    ) -> "_Flight":
        """The flight of which every drift takes so many orbits."""
        h = problem.time_step
        steps = orbits * 2 * np.pi / problem.mean_motion / h
        whole = int(steps + NO_LENGTH)
        drift, _ = problem.dynamics.step(h * np.arange(whole + 1))
        after = np.matvec(drift[1:], states[:, -1:])
        idle = np.zeros((len(states), whole + 1, 3))
        return cls(
            np.concatenate([states, after], axis=1),
            np.concatenate([controls, idle], axis=1),
            problem,
            drift,
            rest=max(0.0, (steps - whole) * h),
        )

    @property
    def last(self) -> int:
        """The last node of the plan, or of what is left of it."""
        return self.states.shape[1] - len(self.drift)

    @property
    def pieces(self) -> Iterator[tuple[float, Int[Array, "steps"]]]:
        """Intervals of one length, s, and how many time steps after the loss they begin."""
        whole = len(self.drift) - 1
        if whole:
            yield self.problem.time_step, np.arange(whole)
        if self.rest > NO_LENGTH * self.problem.time_step or not whole:
            yield self.rest, np.array([whole])


def _balls(
    start: Float[Array, "*batch 6"],
    controls: Float[Array, "*batch 3"],
    dynamics: Dynamics,
    h: float,
) -> Ball:
    """A ball about the middle of the chord that each craft stays in over an interval of h s."""
    A, B = dynamics.step(h)
    begin, end = start[..., :3], start @ A[:3].T + controls @ B[:3].T
    sag = dynamics.most_acceleration(start, controls, h) * h**2 / 8
    return (begin + end) / 2, norm(end - begin) / 2 + sag


def _candidates(
    flight: _Flight,
    length: float,
    since: Int[Array, "steps"],
    reach: Float[Array, "n"],
    looked: "_Looked",
) -> Iterator[Which]:
    """Craft adrift and others whose balls over an interval are within a distance, by node."""
    dynamics = flight.problem.dynamics
    middle, radius = _balls(flight.states, flight.controls, dynamics, length)
    for node in range(flight.last + 1):
        adrift = np.matvec(flight.drift[since], flight.states[:, node, None])
        centre, size = _balls(adrift, np.zeros((*adrift.shape[:2], 3)), dynamics, length)
        for i, j, steps in looked.at(node, since):
            at = slice(node + since[steps.start], node + since[steps.stop - 1] + 1)
            apart = norm(centre[i, steps] - middle[j, at])
            near = apart <= size[i, steps] + radius[j, at] + reach[i, None]
            pair, step = np.nonzero(near)
            yield i[pair], np.full(len(pair), node), j[pair], at.start + step


@dataclass(frozen=True, eq=False)
class _Looked:
    """What is looked at: all, or that in which the controls of moved craft have a say.

    Attributes:
        last: the last node.
        swarms: which craft belong together.
        moved: craft of interest, or None for all, those at their fixed ends too.
    """

    last: int
    swarms: Swarms
    moved: Bool[Array, "n"] | None

    def at(
        self, node: int, since: Int[Array, "steps"]
    ) -> Iterator[tuple[Int[Array, "p"], Int[Array, "p"], slice]]:
        """Craft adrift from a node, others, and steps of their drift, not too many at once."""
        last, count = self.last, len(since)
        one, other = self.swarms.pairs
        lost, met = np.concatenate([one, other]), np.concatenate([other, one])
        if self.moved is None:
            windows = [(np.ones(len(lost), dtype=bool), 0, count)]
        else:  # from the first node and the last a drift is fixed, and so is one from a goal
            flying = int(np.clip(last - node - since[0], 0, count))
            lost_moved = self.moved[lost] & (0 < node < last)
            windows = [(lost_moved | self.moved[met], 0, flying), (lost_moved, flying, count)]
        for wanted, begin, end in windows:
            chosen = np.flatnonzero(wanted)
            if begin == end or len(chosen) == 0:
                continue
            for part in np.array_split(chosen, 1 + len(chosen) * (end - begin) // AT_ONCE):
                yield lost[part], met[part], slice(begin, end)


def _closest(
    flight: _Flight, length: float, reach: Float[Array, "n"], which: Which
) -> tuple[Array, ...]:
    """The fields of the encounters among candidates."""
    lost, node, other, interval = which
    held = flight.controls[other, interval]
    adrift = np.matvec(flight.drift[interval - node], flight.states[lost, node])
    start = adrift - flight.states[other, interval]
    dynamics = flight.problem.dynamics
    A, B = dynamics.step(length)
    end = np.matvec(A, start) - np.matvec(B, held)
    found = passes(start, end, -held, dynamics, length, reach[lost])
    closest = found.offset, found.distance, found.bound, found.free, found.pushed
    return *(part[found.which] for part in which), *closest


def _closest_at_steps(flight: _Flight, swarms: Swarms) -> list[LossSeparation | None]:
    """The closest that a craft adrift is to another at any time step of a drift, of each swarm.

    The bound is lower by what rounding may hide; None for a craft alone.
    """
    closest: list[LossSeparation | None] = [None] * len(swarms.sizes)
    since = np.arange(len(flight.drift))
    looked = _Looked(flight.last, swarms, None)
    slack = rounding(flight.states)
    for node in range(flight.last + 1):
        adrift = np.matvec(flight.drift, flight.states[:, node, None])[..., :3]
        for i, j, _ in looked.at(node, since):
            apart = norm(adrift[i] - flight.states[j, node : node + len(since), :3])
            least, label = apart.min(axis=1), swarms.label[i]
            for swarm, k in np.transpose(least_of_each(least, label)).tolist():
                distance, best, begin = float(least[k]), closest[swarm], swarms.starts[swarm]
                if best is None or not best.distance <= distance:
                    pair = int(i[k] - begin), int(j[k] - begin)
                    time = float(node + apart[k].argmin()) * flight.problem.time_step
                    closest[swarm] = LossSeparation(distance, distance - slack, pair, node, time)
    return closest
