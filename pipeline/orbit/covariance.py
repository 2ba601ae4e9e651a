"""Linear covariance analysis of craft about their plan, in open or closed loop."""

from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np

from pipeline.arrays import Array, Bool, Float, fields_as_python
from pipeline.errors import InputError, check_range
from pipeline.orbit.arrays import Controls, Indices, Node, Values, Vector, norm
from pipeline.orbit.feedback import ErrorMaps, error_maps
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import step_maps

NO_ERROR = 1e-100  # standard deviation in place of 0, SI
# Added to scaled variances, of at most 1, so that with rounding matrices are positive definite
ROUNDING = 1e-9
# A control of at most this acceleration, m/s², which in an interval moves a craft by at most this
# much, m, is rounding error and no burn
NO_BURN, NO_MOTION = 1e-9, 1e-5

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

    @property
    def correction_sigma(self) -> Float[Array, "n intervals 3"]:
        """Standard deviation of each component of what feedback adds to controls, m/s²."""
        variance = np.diagonal(self.correction_covariance, axis1=2, axis2=3)
        return np.sqrt(np.maximum(variance, 0.0))  # of 0, rounding may be below it

    def of_pairs(self, first: Indices, second: Indices, node: Node) -> Float[Array, "k 9 9"]:
        """Covariance of two craft's relative state at a node and relative control from there on."""
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
        square = np.trace(self.covariance[..., :3, :3], axis1=2, axis2=3)
        at_nodes = np.sqrt(np.maximum(square, 0.0))
        bend = self.acceleration_bound(problem) * problem.time_step**2 / 8
        return np.maximum(at_nodes[:, :-1], at_nodes[:, 1:]) + bend


@np.errstate(under="ignore")
def dispersion(
    controls: Controls, problem: Problem, uncertainty: Uncertainty, closed_loop: bool = False
) -> Dispersion:
    """Linear covariance analysis: dispersions about the trajectories of controls, m/s².

    They are those of flight in open loop or, in ``closed_loop``, with the feedback of
    ``pipeline.orbit.feedback``, and do not depend on initial states.
    """
    maps = error_maps(problem, closed_loop, bool(uncertainty.latency))
    navigation = _by_navigation(problem, uncertainty, closed_loop)
    burn = burn_covariance(controls, problem, uncertainty)
    thruster = thruster_deviation(controls, uncertainty)
    covariance, correction = _covariances(problem, maps, navigation, burn, thruster)
    if closed_loop:
        burn = burn_covariance(controls, problem, uncertainty, correction)
        covariance, correction = _covariances(problem, maps, navigation, burn, thruster)
    known = 1 + problem.intervals if closed_loop else 1  # states, or with feedback bias and noises
    normals = 6 * known + 3 * problem.intervals + (8 if thruster.any() else 0)  # four of each craft
    return Dispersion(covariance, correction, normals)


@lru_cache(maxsize=32)
def _by_navigation(
    problem: Problem, uncertainty: Uncertainty, closed_loop: bool
) -> Float[Array, "T 9 9"]:
    """Covariance of states and commanded controls due to navigation errors.

    Estimates have a bias and noise, which are linear in standard normal variables, six of each.
    The first estimate is the planned state.
    """
    maps = error_maps(problem, closed_loop, bool(uncertainty.latency))
    (A, _), memory = step_maps(problem), uncertainty.navigation_time
    noise, bias = navigation_roots(uncertainty, problem)
    known = np.concatenate([bias, noise], axis=1)
    kept = np.repeat([1.0, np.exp(-problem.time_step / memory) if memory > 0 else 0.0], 6)
    d = len(maps.enter)
    move = np.zeros((problem.intervals, d + 12, d + 12))
    joint = np.zeros((problem.nodes, 9, d + 12))
    move[:, :d, :d], move[:, d:, d:] = maps.move, np.diag(kept)
    move[:, :d, d:] = maps.enter @ (known * kept - A @ known)
    joint[..., :d], joint[:, :6, d:] = maps.joint, -known
    new = np.concatenate([maps.enter @ known, np.eye(12)]) * np.sqrt(1 - kept**2)
    begin, added = np.diag(np.repeat([0.0, 1.0], (d, 12))), np.broadcast_to(new @ new.T, move.shape)
    return joint @ _propagated(begin, move, added) @ joint.mT


def _covariances(
    problem: Problem,
    maps: ErrorMaps,
    navigation: Float[Array, "T 9 9"],
    burn: Float[Array, "n K 3 3"],
    thruster: Float[Array, "n K 3 4"],
) -> tuple[Float[Array, "n T 9 9"], Float[Array, "n K 3 3"]]:
    """Covariances of states and flown controls, and of feedback corrections, due to all errors.

    Burns have independent errors, of given covariances, and those by biases of thrusters.
    """
    push = maps.enter @ step_maps(problem)[1]
    n, d = len(burn), len(maps.enter)
    by_burns = _propagated(np.zeros((n, d, d)), maps.move, push @ burn @ push.mT)
    found = maps.joint @ by_burns @ maps.joint.mT + navigation
    correction = found[:, :-1, 6:, 6:].copy()
    found[:, :-1, 6:, 6:] += burn
    if thruster.any():
        x, pushed = np.zeros((*found.shape[:2], d, 4)), push @ thruster
        for k, move in enumerate(maps.move):
            x[:, k + 1] = move @ x[:, k] + pushed[:, k]
        biased = maps.joint @ x
        correction += biased[:, :-1, 6:] @ biased[:, :-1, 6:].mT
        biased[:, :-1, 6:] += thruster
        found += biased @ biased.mT
    return found, correction


def _propagated(
    begin: Float[Array, "*n d d"], move: Float[Array, "K d d"], added: Float[Array, "*n K d d"]
) -> Float[Array, "*n T d d"]:
    """Covariances at all nodes: P[k+1] = M P[k] Mᵀ + Q, from the first node's on."""
    found = np.empty((len(move) + 1, *begin.shape))
    found[0] = begin
    for k, each in enumerate(move):
        found[k + 1] = each @ found[k] @ each.T + added[..., k, :, :]
    return np.moveaxis(found, 0, -3)


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


def thruster_deviation(
    controls: Controls, uncertainty: Uncertainty
) -> Float[Array, "n intervals 3 4"]:
    """Effect of a magnitude bias and a rotation of a craft's thrusters on its controls, m/s²."""
    found = np.zeros((*controls.shape, 4))
    found[..., 0] = uncertainty.magnitude_bias * controls
    found[..., 1:] = uncertainty.direction_bias * np.cross(np.eye(3), controls[..., None, :]).mT
    return found


def burn_covariance(
    controls: Controls,
    problem: Problem,
    uncertainty: Uncertainty,
    correction: Float[Array, "n intervals 3 3"] | None = None,
) -> Float[Array, "n intervals 3 3"]:
    """Covariance of each burn's error, by Gates's model, m²/s⁴.

    σd² (‖u‖² I - u uᵀ) + σm² u uᵀ: along the burn (σm ‖u‖)², about each axis across it (σd ‖u‖)².
    Where a control has the covariance ``correction`` C itself, u uᵀ + C takes the place of u uᵀ,
    and its trace that of ‖u‖²; the larger of both fixed errors is taken along every axis.
    """
    along, across = uncertainty.magnitude, uncertainty.direction
    fixed = max(uncertainty.magnitude_fixed, uncertainty.direction_fixed) / problem.time_step
    square = controls[..., :, None] * controls[..., None, :]
    counts = is_burn(controls, problem.time_step)
    if correction is not None:
        square, counts = square + correction, np.ones_like(counts)
    total = across**2 * np.trace(square, axis1=-2, axis2=-1) + fixed**2 * counts
    return total[..., None, None] * np.eye(3) + (along**2 - across**2) * square


def is_burn(controls: Vector, time_step: float) -> Bool[Array, "*batch"]:
    """Mask of the controls, m/s², that are burns in an interval of ``time_step`` s."""
    return norm(controls) > min(NO_BURN, NO_MOTION / time_step**2)


def standard_deviation(rows: Float[Array, "k d"], covariance: Float[Array, "k d d"]) -> Values:
    """Standard deviations of linear functionals (rows) of errors with given covariances."""
    return np.sqrt(np.maximum(np.vecdot(np.vecmat(rows, covariance), rows), 0.0))
