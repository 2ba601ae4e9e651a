"""What a network learns from: solved instances as arrays."""

from dataclasses import dataclass

from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.orbit.problem import Problem


@dataclass(frozen=True, eq=False)
class Examples:
    """Solved scenarios of one problem and one swarm size.

    Attributes:
        problem: the problem that they share.
        initial: initial states (N, n, 6), m and m/s.
        goal: goal states (N, n, 6).
        states: the expert's node states (N, n, T, 6).
    """

    problem: Problem
    initial: Float[Array, "N n 6"]
    goal: Float[Array, "N n 6"]
    states: Float[Array, "N n T 6"]

    def __len__(self) -> int:
        """Number of instances."""
        return len(self.initial)

    @property
    def n(self) -> int:
        """Number of spacecraft in each instance."""
        return self.initial.shape[1]
