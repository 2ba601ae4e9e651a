"""The least separation of each of several trials, over arcs as a world flies them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from pipeline.arrays import Array
from pipeline.flight.world import World
from pipeline.orbit.approaches import side_by_side
from pipeline.orbit.problem import Problem
from pipeline.orbit.separation import least_separations


@dataclass(frozen=True, eq=False)
class Least:
    """The least separation of any pair in K trials.

    Attributes:
        distance: m; infinite without a pair.
        first: the pair's first craft, or -1.
        second: its second craft, or -1.
        time: when, s since the first node; not a number without a pair.
    """

    distance: Float[Array, "K"]
    first: Int[Array, "K"]
    second: Int[Array, "K"]
    time: Float[Array, "K"]

    @classmethod
    def none(cls, trials: int) -> "Least":
        """Before anything is flown."""
        nobody = np.full(trials, -1)
        return cls(np.full(trials, np.inf), nobody, nobody, np.full(trials, np.nan))

    def or_less(self, other: "Least") -> "Least":
        """The lesser of both in each trial; this one where they are equal."""
        less = other.distance < self.distance
        mine, theirs = vars(self), vars(other)
        return Least(**{name: np.where(less, theirs[name], mine[name]) for name in mine})


def least_of_arcs(
    world: World,
    start: Float[Array, "K n 6"],
    controls: Float[Array, "K n 3"],
    time: float,
    problem: Problem,
) -> tuple[Float[Array, "K n 6"], Least]:
    """States at the end of an interval's arc, and the least separation over it.

    Args:
        world: that they are flown in.
        start: states at the arc's start, m and m/s.
        controls: held over it, m/s².
        time: of its start, s since the first node.
        problem: whose time step it lasts.
    """
    trials, n, _ = start.shape
    states, flat = start.reshape(-1, 6), controls.reshape(-1, 3)
    flown = world.arc(states, flat, time, problem.time_step, 1)
    swarms = side_by_side((n,) * trials)
    found = least_separations(flown, flat[:, None], problem, swarms)
    pairs = np.array([one.pair or (-1, -1) for one in found])
    offset = np.array([np.nan if one.time is None else one.time for one in found])
    distance = np.array([one.distance for one in found])
    least = Least(distance, pairs[:, 0], pairs[:, 1], time + offset)
    return flown[:, -1].reshape(start.shape), least
