"""Linear covariance analysis of craft about their plan, in open or closed loop."""

from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np

from pipeline.arrays import Array, Float, fields_as_python
from pipeline.errors import InputError, check_range
from pipeline.orbit.arrays import Controls, Indices, Values, norm
from pipeline.orbit.feedback import Responses, closed_loop_responses, open_loop_responses
from pipeline.orbit.problem import Problem

AT_ONCE = 4_000_000  # products of responses that are computed at once, which bounds memory
NO_ERROR = 1e-100  # standard deviation in place of 0, SI
# Added to scaled variances, of at most 1, so that with rounding matrices are positive definite
ROUNDING = 1e-9
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
    """Covariances of each craft's motion about its plan.

    Errors are linear in standard normal variables: those of the errors of navigation, three for
    each burn and four for a craft's thrusters. Errors of craft are independent: covariances of a
    difference are sums.
    """

    # of the state at each node, m and m/s, and of the control in the interval that begins there,
    # m/s², which has none at the last node
    covariance: Float[Array, "n T 9 9"]
    correction_covariance: Float[Array, "n intervals 3 3"]  # of what feedback adds to controls
    pair_normals: int  # variables in which the errors of a pair's difference are linear

    def of_pairs(self, first: Indices, second: Indices, node: Indices) -> Float[Array, "k 9 9"]:
        """Covariance of the difference of two craft: state at a node, and control from there."""
        return self.covariance[first, node] + self.covariance[second, node]

    def acceleration_bound(self, problem: Problem) -> Float[Array, "n intervals"]:
        """Upper bound on the root mean square error of the acceleration in each interval, m/s²."""
        # Errors are a root of the covariance times independent variables; the Frobenius norm, whose
        # square is the mean square, obeys the triangle inequality.
        covariance, intervals = self.covariance[:, :-1], np.arange(problem.intervals)[:, None]
        largest = np.diagonal(covariance, axis1=2, axis2=3).max(axis=(0, 1))
        scale = np.sqrt(largest)[:, None] + NO_ERROR
        root = np.linalg.cholesky(covariance / (scale * scale.T) + ROUNDING * np.eye(9))
        columns = (scale * root).mT
        parts = columns[..., :6], columns[..., 6:]
        return norm(problem.dynamics.acceleration_bound(*parts, problem.time_step, intervals))

    def deviation_bound(self, problem: Problem) -> Float[Array, "n intervals"]:
        """Upper bound on the root mean square distance from the plan in each interval, m."""
        # Between its ends an error of the position is within h²/8 max|p̈| of its chord.
        at_nodes = np.sqrt(np.trace(self.covariance[..., :3, :3], axis1=2, axis2=3))
        bend = self.acceleration_bound(problem) * problem.time_step**2 / 8
        return np.maximum(at_nodes[:, :-1], at_nodes[:, 1:]) + bend


def dispersion(
    controls: Controls, problem: Problem, uncertainty: Uncertainty, closed_loop: bool = False
) -> Dispersion:
    """Linear covariance analysis: dispersions about the trajectories of controls, m/s².

    They do not depend on initial states. In open loop, or with ``pipeline.orbit.feedback``.
    """
    navigation, normals = _navigation(problem, uncertainty, closed_loop)
    to = _responses(problem, uncertainty, closed_loop)
    burn = burn_deviation(controls, problem, uncertainty)
    thruster = thruster_deviation(controls, uncertainty)
    correction = np.zeros((*controls.shape, 3))
    if closed_loop:
        corrected = navigation[:-1, 6:, 6:], to.control_to_burns
        first = _covariance(*corrected, burn, thruster)
        burn = burn_deviation(controls, problem, uncertainty, first)
        correction = _covariance(*corrected, burn, thruster)
    covariance = _covariance(navigation, _joint_to_burns(to), burn, thruster)
    normals += 3 * problem.intervals + (8 if thruster.any() else 0)  # four of each craft
    return Dispersion(covariance, correction, normals)


def _responses(problem: Problem, uncertainty: Uncertainty, closed_loop: bool) -> Responses:
    if closed_loop:
        return closed_loop_responses(problem, bool(uncertainty.latency))
    return open_loop_responses(problem)


@lru_cache(maxsize=32)
def _navigation(
    problem: Problem, uncertainty: Uncertainty, closed_loop: bool
) -> tuple[Float[Array, "T 9 9"], int]:
    """Covariance of states and controls by errors of navigation, and the number of these."""
    noise, bias = navigation_roots(uncertainty, problem)
    to = _responses(problem, uncertainty, closed_loop)
    if closed_loop:
        from scipy.linalg import block_diag  # slow to import, and only closed loops need it

        known = block_diag(bias, np.kron(correlation_root(uncertainty, problem), noise))
    else:
        known = np.concatenate([noise, bias], axis=1)  # a root of the sum of both covariances
    root = _with_controls(to.state_to_navigation, to.control_to_navigation) @ known
    return root @ root.mT, len(known)


def _with_controls(
    states: Float[Array, "T 6 J"], controls: Float[Array, "intervals 3 J"]
) -> Float[Array, "T 9 J"]:
    """Responses of each node's state and of the control from there, none at the last node."""
    joint = np.zeros((len(states), 9, states.shape[2]))
    joint[:, :6], joint[:-1, 6:] = states, controls
    return joint


def _joint_to_burns(to: Responses) -> Float[Array, "T 9 m"]:
    """Responses of states and controls to burns; a control has the error of its own burn too."""
    controls = to.control_to_burns.copy()
    own = np.arange(3 * len(controls)).reshape(-1, 3)
    controls[np.arange(len(controls))[:, None], np.arange(3), own] += 1.0
    return _with_controls(to.state_to_burns, controls)


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


def _covariance(
    navigation: Float[Array, "K s s"],
    to_burns: Float[Array, "K s _"],
    burn: Float[Array, "n intervals 3 3"],
    thruster: Float[Array, "n intervals 3 4"],
) -> Float[Array, "n K s s"]:
    """Covariances by all errors at once: of navigation, of each burn and of thrusters.

    That of a burn, Q, adds G Q Gᵀ, which for all craft and burns is one product with G ⊗ G.
    """
    (K, s, _), (n, m) = to_burns.shape, burn.shape[:2]
    each, of_burn = to_burns.reshape(K, s, m, 3), (burn @ burn.mT).reshape(n, 9 * m)
    found = np.empty((n, K, s, s))
    for some in np.array_split(np.arange(K), 1 + K * s * s * 9 * m // AT_ONCE):
        part = each[some]
        products = part[:, :, None, :, :, None] * part[:, None, :, :, None, :]
        by_burns = of_burn @ products.reshape(-1, 9 * m).T
        found[:, some] = navigation[some] + by_burns.reshape(n, len(some), s, s)
    if thruster.any():
        biased = to_burns @ thruster.reshape(n, 1, 3 * m, 4)
        found += biased @ biased.mT
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
