"""A plan's controls flown in a world, one after the other and without a look at where it leads."""

from dataclasses import dataclass
from functools import reduce

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.flight.nearest import nearer, nearest, pieces_for
from pipeline.flight.world import World
from pipeline.orbit.problem import Problem
from pipeline.orbit.separation import Separation


@dataclass(frozen=True, eq=False)
class Flight:
    """What became of a swarm.

    Attributes:
        states: at the nodes, (n, T, 6), LVLH, m and m/s.
        nearest: the least separation of any pair at any time.
    """

    states: Float[Array, "n T 6"]
    nearest: Separation


def fly_controls(
    world: World,
    initial: Float[Array, "n 6"],
    controls: Float[Array, "n intervals 3"],
    problem: Problem,
) -> Flight:
    """Fly controls (m/s²) from initial states, each over its interval."""
    e, step = problem.mean_motion, problem.time_step
    pieces, nodes, closest = pieces_for(step, e), [initial], []
    for k, control in enumerate(controls.swapaxes(0, 1)):
        arc = world.arc(nodes[-1], control, k * step, step, pieces)
        nodes.append(arc[:, -1])
        closest.append(nearest(arc[None], k * step, step, e))
    return Flight(np.stack(nodes, axis=1), reduce(nearer, closest).separation())
