"""Kalman filter of each craft's state from navigation estimates and commanded controls.

Navigation errors are new at every node, in part or in whole, and guidance that corrects all of them
burns fuel for noise. A prediction from earlier estimates and the controls commanded since is often
more accurate. So both are combined by their covariances (R. Kalman, "A new approach to linear
filtering and prediction problems", Journal of Basic Engineering 82, 1960). The filter's state also
has the bias and the correlated noise of navigation, and the biases of a craft's thrusters, all as
standard normal variables. The standard deviations of errors are known.

After an estimate that is implausible under the prediction, as after a missed burn, the filter of
that craft is initialized anew from this estimate.
"""

import numpy as np

from pipeline.arrays import Array, Float
from pipeline.orbit.arrays import norm
from pipeline.orbit.covariance import (
    Uncertainty,
    burn_covariance,
    navigation_roots,
    thruster_deviation,
)
from pipeline.orbit.problem import Problem

STATE, BIAS, NOISE, THRUSTER = slice(0, 6), slice(6, 12), slice(12, 18), slice(18, 22)
SIZE = 22  # of the filter's state
# Squared Mahalanobis distance of an estimate from the predicted one, of six components, beyond
# which one in 200,000 is by itself
SURPRISE = 35.0
# Standard deviation of the relative acceleration that the linear model leaves out, as a share of
# e² times the distance from the reference: of J2 and an eccentricity of 0.001
UNMODELLED = 5e-3
# Share added to variances of innovations: where no estimate has noise of its own, and burns err in
# three components of six, their covariance is singular but for rounding
ROUNDING = 1e-12
FLOOR = 1e-9  # least standard deviation of an estimate, m; of velocities e times it

Known = tuple[Float[Array, "N size"], Float[Array, "N size size"]]  # mean and covariance


class Filter:
    """The Kalman filter of each craft of K trials of n craft."""

    def __init__(self, problem: Problem, errors: Uncertainty) -> None:
        """Begin without any estimate, with known standard deviations of errors."""
        self.errors, self._problem = errors, problem
        self._noise, self._bias = navigation_roots(errors, problem)
        self._exact = not (self._noise.any() or self._bias.any())
        memory = errors.navigation_time
        self._kept = np.exp(-problem.time_step / memory) if memory > 0 else 0.0
        self._floor = np.diag(FLOOR * np.repeat([1.0, problem.mean_motion], 3)) ** 2
        self._known: Known | None = None
        self._burnt: Float[Array, "N 3"] | None = None  # commanded, whose errors an estimate has

    @property
    def covariance(self) -> Float[Array, "N 6 6"]:
        """Covariance of each craft's state error at the last node, m and m/s."""
        assert self._known is not None
        return self._known[1][:, STATE, STATE]

    def __call__(
        self, node: int, estimate: Float[Array, "K n 6"], commanded: Float[Array, "K n 3"] | None
    ) -> Float[Array, "K n 6"]:
        """Filtered states, m and m/s, from the estimate at a node and the last controls commanded.

        Controls, m/s², are None at the first node. Where states are known late, estimates are those
        of the node before, propagated with the commanded controls.
        """
        seen, late = estimate.reshape(-1, 6), bool(self.errors.latency)
        observed = self._measurement_matrix(node, late)
        held = None if commanded is None else commanded.reshape(-1, 3)
        burnt, self._burnt = (self._burnt, held) if late else (held, None)
        if self._known is None or burnt is None or held is None or self._exact:
            self._known = _initialized(seen, observed)
            return estimate
        mean, covariance = self._predicted(node, held, burnt, late)
        gain = covariance @ observed.T
        off = seen - np.matvec(observed, mean)
        both = np.concatenate([off[..., None], gain.mT], axis=-1)
        innovation = observed @ gain + self._floor
        innovation[:, range(6), range(6)] *= 1 + ROUNDING
        weighed = np.linalg.solve(innovation, both)
        mean = mean + np.matvec(gain, weighed[..., 0])
        covariance = covariance - gain @ weighed[..., 1:]
        covariance = (covariance + covariance.mT) / 2
        surprising = np.vecdot(off, weighed[..., 0]) > SURPRISE
        mean[surprising], covariance[surprising] = _initialized(seen[surprising], observed)
        self._known = mean, covariance
        return mean[:, STATE].reshape(estimate.shape)

    def _measurement_matrix(self, node: int, late: bool) -> Float[Array, "6 size"]:
        """The measurement matrix: estimates at a node as a linear map of the filter's state."""
        observed = np.zeros((6, SIZE))
        observed[:, BIAS], observed[:, NOISE] = self._bias, self._noise
        if late and node > 0:
            observed = self._step(node - 1)[0] @ observed
        observed[:, STATE] = np.eye(6)
        return observed

    def _step(self, interval: int) -> tuple[Float[Array, "6 6"], Float[Array, "6 3"]]:
        return self._problem.dynamics.step(self._problem.time_step, interval)

    def _predicted(
        self, node: int, held: Float[Array, "N 3"], burnt: Float[Array, "N 3"], late: bool
    ) -> Known:
        """Mean and covariance at a node, by the controls of the interval before it, m/s².

        ``burnt`` are those whose errors the state has since: where it is known late, without those
        of that interval, they are the ones before.
        """
        assert self._known is not None
        mean, covariance = self._known
        problem, errors = self._problem, self.errors
        A, B = self._step(node - 1)
        through = A @ self._step(node - 2)[1] if late else B
        move = np.tile(np.eye(SIZE), (len(mean), 1, 1))
        move[:, STATE, STATE] = A
        move[:, STATE, THRUSTER] = through @ thruster_deviation(burnt[:, None], errors)[:, 0]
        move[:, NOISE, NOISE] *= self._kept
        burns = burn_covariance(burnt[:, None], problem, errors)[:, 0]
        left_out = UNMODELLED * problem.mean_motion**2 * norm(mean[:, :3])
        covariance = move @ covariance @ move.mT
        covariance[:, STATE, STATE] += through @ burns @ through.T
        covariance[:, STATE, STATE] += left_out[:, None, None] ** 2 * (B @ B.T)
        covariance[:, NOISE, NOISE] += (1 - self._kept**2) * np.eye(6)
        mean = np.matvec(move, mean)
        mean[:, STATE] += np.matvec(B, held)
        return mean, covariance


def _initialized(seen: Float[Array, "N 6"], observed: Float[Array, "6 size"]) -> Known:
    """Mean and covariance from estimates alone: states are estimates minus their errors."""
    mean = np.zeros((len(seen), SIZE))
    mean[:, STATE] = seen
    root = np.eye(SIZE)
    root[STATE] = -observed
    root[STATE, STATE] = 0.0
    return mean, np.tile(root @ root.T, (len(seen), 1, 1))
