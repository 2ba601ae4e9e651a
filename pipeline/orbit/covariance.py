"""Linear covariance analysis of craft about their plan, in open or closed loop."""

from dataclasses import dataclass, fields

import numpy as np

from pipeline.arrays import Array, Float, fields_as_python
from pipeline.errors import InputError, check_range
from pipeline.orbit.arrays import Controls, Indices, Values, norm
from pipeline.orbit.feedback import Responses, closed_loop_responses, open_loop_responses
from pipeline.orbit.problem import Problem

NO_BURN = 1e-9  # acceleration, m/s², up to which a control is rounding error and no burn

# Largest errors that are accepted, SI: no swarm would be flown with larger ones
MAX_ERRORS = {
    **dict.fromkeys(("position", "position_bias", "semi_major_axis", "timing"), 1e3),
    **dict.fromkeys(("velocity", "velocity_bias", "magnitude_fixed", "direction_fixed"), 10.0),
    **dict.fromkeys(("magnitude", "direction", "magnitude_bias", "direction_bias"), 0.3),
    **dict.fromkeys(("latency", "impulse_bit", "missed", "lost"), 1.0),
    "navigation_time": 1e7,
}


@dataclass(frozen=True)
class Uncertainty:
    """1-σ errors of navigation and of thrust execution, independent Gaussians.

    A burn is the control of one interval. Its errors are Gates's proportional and fixed ones
    (Gates 1963, "A simplified model of midcourse maneuver execution errors", JPL TR 32-504): along
    the burn in magnitude, across it in direction.

    Attributes:
        position: of each component of an estimated position, m.
        velocity: of each component of an estimated velocity, m/s.
        magnitude: of a burn's magnitude, as a share of it.
        direction: of a burn's direction, about each axis across it, rad.
        position_bias: of an estimated position, over a whole transfer, m.
        velocity_bias: of an estimated velocity, over a whole transfer, m/s.
        magnitude_fixed: of a burn's Δv along it, whatever its size, m/s.
        direction_fixed: of a burn's Δv along each axis across it, m/s.
        magnitude_bias: of the magnitude of all burns of a craft in a transfer, as a share.
        direction_bias: about each axis, of a common rotation of all burns of a craft, rad.
        semi_major_axis: of the estimated relative semi-major axis, m, where a filter knows it
            better than position and velocity errors imply: then ẏ = -2e x + e δa / 2. Above 0 it
            replaces the error of the velocity along y.
        navigation_time: correlation time of errors of navigation (Gauss-Markov), s.
        latency: delay of estimated states in intervals, 0 or 1.
    """

    position: float = 0.0
    velocity: float = 0.0
    magnitude: float = 0.0
    direction: float = 0.0
    position_bias: float = 0.0
    velocity_bias: float = 0.0
    magnitude_fixed: float = 0.0
    direction_fixed: float = 0.0
    magnitude_bias: float = 0.0
    direction_bias: float = 0.0
    semi_major_axis: float = 0.0
    navigation_time: float = 0.0
    latency: float = 0.0

    def __post_init__(self) -> None:
        fields_as_python(self)
        for name, value in vars(self).items():
            check_range(name, value, 0.0, MAX_ERRORS[name])
        if self.latency not in (0, 1):
            raise InputError(
                f"latency is {self.latency:g}; expected 0 or 1, the intervals by which states are "
                "known late."
            )

    def gaussian(self, time_step: float) -> "Uncertainty":
        """The Gaussian errors alone; a subclass may have others. The time step is in s."""
        return Uncertainty(**{f.name: getattr(self, f.name) for f in fields(Uncertainty)})


@dataclass(frozen=True, eq=False)
class Dispersion:
    """Errors of each craft's motion about its plan, linear in J standard normal variables.

    The variables are those of the errors of navigation, three for each burn and four for a craft's
    thrusters. Errors of craft are independent: covariances of a difference are sums.
    """

    state: Float[Array, "n T 6 J"]  # effect on each node's state, m and m/s
    control: Float[Array, "n intervals 3 J"]  # effect on each interval's control, m/s²
    correction_covariance: Float[Array, "n intervals 3 3"]  # of what feedback adds to controls
    thruster_normals: int = 0  # variables of a craft's thrusters; a pair has those of both craft

    def covariance(self, craft: Indices, interval: Indices) -> Float[Array, "k 9 9"]:
        """Covariance of craft's states at the starts of intervals and of their controls there."""
        state, control = self.state[craft, interval], self.control[craft, interval]
        both = np.concatenate([state, control], axis=1)
        return both @ both.mT

    def of_pairs(self, first: Indices, second: Indices, interval: Indices) -> Float[Array, "k 9 9"]:
        """Covariance of the difference of two craft: state at an interval's start, and control."""
        intervals = self.control.shape[1]
        each, place = np.unique(
            np.stack([first, second]) * intervals + interval, return_inverse=True
        )
        covariance = self.covariance(*np.divmod(each, intervals))
        return covariance[place[0]] + covariance[place[1]]

    def acceleration_bound(self, problem: Problem) -> Float[Array, "n intervals"]:
        """Upper bound on the root mean square error of the acceleration in each interval, m/s²."""
        # The Frobenius norm, whose square is the mean square, obeys the triangle inequality.
        intervals = np.arange(problem.intervals)[:, None]
        columns = self.state[:, :-1].mT, self.control.mT
        return norm(problem.dynamics.acceleration_bound(*columns, problem.time_step, intervals))

    def deviation_bound(self, problem: Problem) -> Float[Array, "n intervals"]:
        """Upper bound on the root mean square distance from the plan in each interval, m."""
        # Between its ends a column of the map to positions is within h²/8 max|p̈| of its chord.
        at_nodes = np.sqrt(np.square(self.state[:, :, :3]).sum(axis=(2, 3)))
        bend = self.acceleration_bound(problem) * problem.time_step**2 / 8
        return np.maximum(at_nodes[:, :-1], at_nodes[:, 1:]) + bend


def dispersion_size(n: int, intervals: int, *, closed_loop: bool = False) -> int:
    """Memory that the dispersion of n craft takes, bytes."""
    normals = (9 if closed_loop else 3) * intervals + 10
    return 8 * n * (9 * intervals + 6) * normals


def dispersion(
    controls: Controls, problem: Problem, uncertainty: Uncertainty, closed_loop: bool = False
) -> Dispersion:
    """Linear covariance analysis: dispersions about the trajectories of controls, m/s².

    They do not depend on initial states. In open loop, or with ``pipeline.orbit.feedback``.
    """
    noise, bias = navigation_roots(uncertainty, problem)
    burn = burn_deviation(controls, problem, uncertainty)
    thruster = thruster_deviation(controls, uncertainty)
    if not closed_loop:
        return _driven(open_loop_responses(problem), _joint(noise, bias), burn, thruster)
    from scipy.linalg import block_diag  # slow to import, and only closed loops need it

    known = block_diag(bias, np.kron(correlation_root(uncertainty, problem), noise))
    to = closed_loop_responses(problem, bool(uncertainty.latency))
    first = _effects(to.control_to_navigation, to.control_to_burns, known, burn, thruster)
    burn = burn_deviation(controls, problem, uncertainty, first @ first.mT)
    return _driven(to, known, burn, thruster)


def navigation_roots(
    uncertainty: Uncertainty, problem: Problem
) -> tuple[Float[Array, "6 6"], Float[Array, "6 6"]]:
    """Square roots of covariances of estimated states, m and m/s: noise at a node, and bias."""
    noise = np.diag(np.repeat([uncertainty.position, uncertainty.velocity], 3))
    bias = np.diag(np.repeat([uncertainty.position_bias, uncertainty.velocity_bias], 3))
    size, rate = uncertainty.semi_major_axis, problem.mean_motion
    if size > 0:
        noise[4, [0, 4]] = -2 * rate * uncertainty.position, rate * size / 2
    return noise, bias


def _joint(one: Float[Array, "6 6"], other: Float[Array, "6 6"]) -> Float[Array, "6 6"]:
    """A square root of the sum of two covariances, given by square roots."""
    if not other.any():
        return one
    values, vectors = np.linalg.eigh(one @ one.T + other @ other.T)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def correlation_root(uncertainty: Uncertainty, problem: Problem) -> Float[Array, "m m"]:
    """Square root of the correlation matrix of navigation errors at all nodes but the last."""
    nodes = np.arange(problem.intervals)
    if uncertainty.navigation_time == 0:
        return np.eye(len(nodes))
    lag = np.abs(nodes[:, None] - nodes) * problem.time_step
    return np.linalg.cholesky(np.exp(-lag / uncertainty.navigation_time))


def thruster_deviation(
    controls: Controls, uncertainty: Uncertainty
) -> Float[Array, "n intervals 3 4"]:
    """Effect of a magnitude bias and a rotation of a craft's thrusters on its controls, m/s²."""
    found = np.zeros((*controls.shape, 4))
    found[..., 0] = uncertainty.magnitude_bias * controls
    found[..., 1:] = uncertainty.direction_bias * np.cross(np.eye(3), controls[..., None, :]).mT
    return found


def _driven(
    to: Responses,
    known: Float[Array, "J_s J_s"],
    burn: Float[Array, "n intervals 3 3"],
    thruster: Float[Array, "n intervals 3 4"],
) -> Dispersion:
    """The dispersion from linear responses to errors and square roots of their covariances."""
    errors, count = (known, burn, thruster), len(known)
    state = _effects(to.state_to_navigation, to.state_to_burns, *errors)
    control = _effects(to.control_to_navigation, to.control_to_burns, *errors)
    correction = control @ control.mT
    for k in range(burn.shape[1]):
        control[:, k, :, count + 3 * k : count + 3 * k + 3] += burn[:, k]
    control[..., -4:] += thruster
    own = 4 if thruster.any() else 0
    used = slice(None if own else -4)
    return Dispersion(state[..., used], control[..., used], correction, own)


def _effects(
    to_navigation: Float[Array, "T size J_s"],
    to_burns: Float[Array, "T size _"],
    known: Float[Array, "J_s J_s"],
    burn: Float[Array, "n intervals 3 3"],
    thruster: Float[Array, "n intervals 3 4"],
) -> Float[Array, "n T size J"]:
    """Linear maps from standard normal variables to deviations of states, or of controls."""
    (T, size, _), (n, m), count = to_navigation.shape, burn.shape[:2], len(known)
    found = np.empty((n, T, size, count + 3 * m + 4))
    found[..., :count] = to_navigation @ known
    each = found[..., count:-4].reshape(n, T * size, m, 3, copy=False)
    np.matmul(to_burns.reshape(T * size, m, 3).swapaxes(0, 1), burn, out=each.swapaxes(1, 2))
    found[..., -4:] = to_burns @ thruster.reshape(n, 1, 3 * m, 4)
    return found


def burn_deviation(
    controls: Controls,
    problem: Problem,
    uncertainty: Uncertainty,
    correction: Float[Array, "n intervals 3 3"] | None = None,
) -> Float[Array, "n intervals 3 3"]:
    """The symmetric square root of each burn's covariance, by Gates's model, m/s².

    ‖u‖ (σd I + (σm - σd) û ûᵀ): along the burn σm ‖u‖, about each axis across it σd ‖u‖. Where a
    control has the covariance ``correction`` C itself, its error has σd² (tr C I - C) + σm² C more;
    the larger of both fixed errors is taken along every axis.
    """
    size = norm(controls)[..., None, None]
    along, across = uncertainty.magnitude, uncertainty.direction
    unit = controls[..., :, None] * controls[..., None, :] / np.where(size > 0, size, 1.0)
    root = across * size * np.eye(3) + (along - across) * unit
    fixed = max(uncertainty.magnitude_fixed, uncertainty.direction_fixed) / problem.time_step
    if correction is None and fixed == 0:
        return root
    counts = size > NO_BURN if correction is None else True
    covariance = root @ root + fixed**2 * np.eye(3) * counts
    if correction is not None:
        total = np.trace(correction, axis1=-2, axis2=-1)[..., None, None]
        covariance += across**2 * total * np.eye(3) + (along**2 - across**2) * correction
    values, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :] @ vectors.mT


def standard_deviation(rows: Float[Array, "k d"], covariance: Float[Array, "k d d"]) -> Values:
    """Standard deviations of linear functionals (rows) of errors with given covariances."""
    return np.sqrt(np.maximum(np.vecdot(np.vecmat(rows, covariance), rows), 0.0))
