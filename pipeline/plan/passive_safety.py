"""What a certificate says of a loss of thrust, where that was asked for."""

from dataclasses import dataclass

from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.orbit.approaches import Swarms
from pipeline.orbit.passive_safety import least_after_loss
from pipeline.orbit.problem import Problem


@dataclass(frozen=True)
class PassiveSafety:
    """How close a craft that has lost its thrust comes to another, whoever it is and whenever.

    Attributes:
        orbits: how long it drifts, from every node on; the others fly their plan and drift on.
        min_separation: least distance of a craft adrift to another at any time, m; None without a
            pair.
        min_separation_bound: proven lower bound on it, m.
        pair: the craft adrift and the one that it meets, or None.
        node: at which the first of them loses its thrust, or None; at the last node it has none
            left to lose, and both drift on from their goals.
        time: when they are closest, s since the first node, or None.
    """

    orbits: float
    min_separation: float | None = None
    min_separation_bound: float | None = None
    pair: tuple[int, int] | None = None
    node: int | None = None
    time: float | None = None


def passive_safety(
    states: Float[Array, "N T 6"],
    controls: Float[Array, "N intervals 3"],
    problem: Problem,
    orbits: float,
    swarms: Swarms,
) -> list[PassiveSafety]:
    """Of each of several swarms, craft after craft.

    Args:
        states: node states, m and m/s.
        controls: m/s².
        problem: the problem.
        orbits: how long a craft drifts.
        swarms: which craft belong together.
    """
    return [
        PassiveSafety(orbits)
        if least is None
        else PassiveSafety(orbits, least.distance, least.bound, least.pair, least.node, least.time)
        for least in least_after_loss(states, controls, problem, orbits, swarms)
    ]
