"""Covariances of craft about their plan in open loop, through the linear model."""

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.errors import check_range
from pipeline.orbit.arrays import Controls, Indices, Values, Vector, Vectors
from pipeline.orbit.bezier import norm
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import transfer_maps

# Largest errors, SI: beyond any with which craft would be flown near each other
MOST = {
    **dict.fromkeys(("position", "position_bias"), 1e3),
    **dict.fromkeys(("velocity", "velocity_bias", "magnitude_fixed", "direction_fixed"), 10.0),
    **dict.fromkeys(("magnitude", "direction"), 0.3),
    "timing": 1e3,
    "missed": 1.0,
}


@dataclass(frozen=True)
class Uncertainty:
    """1-σ errors of navigation and of thrust execution, independent Gaussians.

    A burn is one interval's control. Its errors are Gates's proportional ones (Gates 1963, "A
    simplified model of midcourse maneuver execution errors", JPL TR 32-504): along the burn in its
    size, across it in its direction.

    Attributes:
        position: of each component of a position as it is known, m.
        velocity: of each component of a velocity as it is known, m/s.
        magnitude: of a burn's size, as a share of it.
        direction: of a burn's direction, about each axis across it, rad.
    """

    position: float = 0.0
    velocity: float = 0.0
    magnitude: float = 0.0
    direction: float = 0.0

    def __post_init__(self) -> None:
        """Refuse values out of range."""
        for field in fields(self):
            check_range(field.name, getattr(self, field.name), 0.0, MOST[field.name])


@dataclass(frozen=True, eq=False)
class Dispersion:
    """Errors of each craft's motion in open loop, linear in J = 6 + 3(T-1) standard normals.

    The normals are the six components of a craft's initial state and the three of each burn. Craft
    err independently, so that covariances of a pair's difference are the sums of both craft's.
    """

    state: Float[Array, "n T 6 J"]  # of those normals on each node's state, m and m/s
    burn: Float[Array, "n intervals 3 3"]  # of an interval's three on its control, m/s²

    @cached_property
    def state_covariance(self) -> Float[Array, "n T 6 6"]:
        """Covariance of each craft's state at each node."""
        return self.state @ self.state.mT

    @cached_property
    def burn_covariance(self) -> Float[Array, "n intervals 3 3"]:
        """Covariance of each craft's controls, independent of the state at its start."""
        return self.burn @ self.burn.mT

    def of_pairs(
        self, first: Indices, second: Indices, interval: Indices
    ) -> tuple[Float[Array, "k 6 6"], Float[Array, "k 3 3"]]:
        """Covariances of the difference of two craft: state at an interval's start, and control."""
        state, burn = self.state_covariance, self.burn_covariance
        i, j, k = first, second, interval
        return state[i, k] + state[j, k], burn[i, k] + burn[j, k]

    def most_acceleration(self, problem: Problem) -> Float[Array, "n intervals"]:
        """Upper bound on the root mean square error of the acceleration in each interval, m/s².

        The Frobenius norm, whose square is the mean square, obeys the triangle inequality.
        """
        n, T, _, J = self.state.shape
        columns = np.zeros((n, T - 1, J + 3, 6))
        columns[:, :, :J] = self.state[:, :-1].mT
        push = np.zeros((n, T - 1, J + 3, 3))
        push[:, :, J:] = self.burn.mT
        intervals = np.arange(T - 1)[:, None]
        bound = problem.dynamics.most_acceleration(columns, push, problem.time_step, intervals)
        return norm(bound)

    def most_deviation(self, problem: Problem) -> Float[Array, "n intervals"]:
        """Upper bound on the root mean square distance from the plan in each interval, m.

        Between its ends a column of the map to positions is within h²/8 max|p̈| of its chord.
        """
        at_nodes = np.sqrt(np.square(self.state[:, :, :3]).sum(axis=(2, 3)))
        bend = self.most_acceleration(problem) * problem.time_step**2 / 8
        return np.maximum(at_nodes[:, :-1], at_nodes[:, 1:]) + bend


def dispersion(controls: Controls, problem: Problem, uncertainty: Uncertainty) -> Dispersion:
    """The dispersion of craft that fly some controls (m/s²), whatever states they start from."""
    maps, n, (T, m) = transfer_maps(problem), len(controls), (problem.nodes, problem.intervals)
    known = np.repeat([uncertainty.position, uncertainty.velocity], 3)
    burn = burn_deviation(controls, uncertainty)
    state = np.empty((n, T, 6, 6 + 3 * m))
    state[..., :6] = maps.drift * known
    reach = maps.reach.reshape(T, 6, m, 3).transpose(0, 2, 1, 3)
    state[..., 6:] = (reach @ burn[:, None]).swapaxes(2, 3).reshape(n, T, 6, 3 * m)
    return Dispersion(state, burn)


def burn_deviation(controls: Vector, uncertainty: Uncertainty) -> Float[Array, "*batch 3 3"]:
    """The symmetric square root of a burn's covariance, by Gates's proportional model, m/s².

    ‖u‖ (σd I + (σm - σd) û ûᵀ): along the burn σm ‖u‖, about each axis across it σd ‖u‖.
    """
    size = norm(controls)[..., None, None]
    along = controls[..., :, None] * controls[..., None, :] / np.where(size > 0, size, 1.0)
    across = uncertainty.direction
    return across * size * np.eye(3) + (uncertainty.magnitude - across) * along


def deviation_along(
    normal: Vectors,
    maps: tuple[Float[Array, "k 3 6"], Float[Array, "k 3 3"]],
    covariances: tuple[Float[Array, "k 6 6"], Float[Array, "k 3 3"]],
) -> Values:
    """Standard deviation of a relative position along unit vectors, m, by its maps."""
    rows = [np.vecmat(normal, one) for one in maps]
    return np.sqrt(
        sum(np.vecdot(np.vecmat(row, one), row) for row, one in zip(rows, covariances, strict=True))
    )
