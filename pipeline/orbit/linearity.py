"""How far the linear model is off: estimates of what it leaves out, without flying anything."""

from dataclasses import dataclass

from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.orbit.bezier import norm
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import J2, R_EARTH, radius_at


@dataclass(frozen=True)
class ModelError:
    """By how much craft miss their goals outside the linear model, on a circular orbit.

    Attributes:
        reach: largest distance of a craft from the origin, m.
        curvature: estimated miss by the terms of gravity that the model leaves out, m.
        oblateness: estimated miss by the Earth's J2, m.
    """

    reach: float
    curvature: float
    oblateness: float

    @property
    def total(self) -> float:
        """Both together, m."""
        return self.curvature + self.oblateness


def model_error(states: Float[Array, "*batch 6"], problem: Problem) -> ModelError:
    """The order of magnitude of the linear model's error over a transfer.

    At a distance ρ the first neglected term of gravity is some (3/2) e² ρ²/r₀, and the pull of J2
    differs by some 4 J2 (R/r₀)² e² ρ from that at the origin. Held for a time t, an acceleration a
    moves a craft by a t²/2, and on relative orbits, from about half a revolution on, along-track
    by 2 a t/e. `prolearn fly` integrates instead.

    Args:
        states: of craft, in m and m/s; what matters is the one furthest from the origin.
        problem: orbit and length of the transfer.
    """
    radius, angle = radius_at(problem.mean_motion), problem.mean_motion * problem.duration
    growth = min(angle**2 / 2, 2 * angle)
    reach = float(norm(states[..., :3]).max())
    return ModelError(
        reach,
        curvature=1.5 * reach**2 / radius * growth,
        oblateness=4 * J2 * (R_EARTH / radius) ** 2 * reach * growth,
    )
