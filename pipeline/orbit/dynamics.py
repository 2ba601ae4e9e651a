"""The seam behind which the dynamics are: all that transfers and proofs need to know of them."""

from typing import Protocol, runtime_checkable

from jaxtyping import Float

from pipeline.arrays import Array


@runtime_checkable
class Dynamics(Protocol):
    """Linear relative motion, the same in every interval of constant control.

    States are x y z vx vy vz in m and m/s, controls in m/s². What holds for states and controls
    of craft holds for differences of both, since the motion is linear.
    """

    def __hash__(self) -> int:
        """Dynamics are values, by which maps are kept."""
        ...

    def step(
        self, time: float | Float[Array, "*batch"]
    ) -> tuple[Float[Array, "*batch 6 6"], Float[Array, "*batch 6 3"]]:
        """A and B of s(t) = A s(0) + B u, so long after an interval's start, s: Eq. 2."""
        ...

    def most_acceleration(
        self, start: Float[Array, "*batch 6"], control: Float[Array, "*batch 3"], time: float
    ) -> Float[Array, "*batch"]:
        """A bound on ‖p̈‖ for so long after an interval's start, m/s²."""
        ...

    def most_fourth_derivative(
        self, start: Float[Array, "*batch 6"], control: Float[Array, "*batch 3"]
    ) -> Float[Array, "*batch"]:
        """A bound on ‖p⁗‖ for all times, m/s⁴: how far positions may be from a cubic."""
        ...
