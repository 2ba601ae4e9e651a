"""Controls of the last interval that keep craft apart: those nearest the goal, changed least.

Remaining errors can bring two craft together whose goals are close: the control that minimizes
‖Δp‖² + ‖Δv/e‖² trades position errors for velocity errors. Pairs that would come too near are moved
apart along the line between both at that time, by changes of their controls that add the least to
that sum.
"""

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Array, Bool, Float
from pipeline.flight.world import HeldControls
from pipeline.orbit.approaches import PROVABLE, Approaches, close_approaches
from pipeline.orbit.arrays import Formation, PositionMaps, Values, Vectors, norm
from pipeline.orbit.covariance import Uncertainty, burn_covariance, standard_deviation
from pipeline.orbit.partition import swarm_partition
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import state_weight

ROUNDS = 8  # iterations: a craft may belong to several pairs, each of which moves it
EARLY = 0.1  # share of the interval up to which its controls hardly move a pair
CLOSE = 5.0  # least distance beyond the collision radius, m, up to which pairs are considered


@dataclass(frozen=True, eq=False)
class LastInterval:
    """The last interval of K trials of n craft."""

    problem: Problem  # that begins with it
    estimate: Float[Array, "K n 6"]  # states at its start, m and m/s
    covariance: Float[Array, "K n 6 6"]  # of their errors
    goal: Formation  # m and m/s
    uncertainty: Uncertainty  # of burns
    sigmas: float  # standard deviations of a separation to be kept beyond the collision radius
    adrift: Bool[Array, "K n"]  # craft without thrust

    def kept_apart(self, controls: Float[Array, "K n 3"]) -> Float[Array, "K n 3"]:
        """The controls, m/s², changed within their limit where pairs would come too near."""
        (trials, n, _), problem = self.estimate.shape, self.problem
        held, swarms = controls.reshape(-1, 3), swarm_partition((n,) * trials)
        within, most = self._considered_distances(held), problem.most_control
        for _ in range(ROUNDS):
            states = flown_interval(self.estimate.reshape(-1, 6), held, problem)
            widest = float(within.max())
            found = close_approaches(states, held[:, None], problem, widest, swarms=swarms)
            # Whether others in the batch have larger ones makes no difference.
            change = self._changes(found[found.bound < within[found.first // n]], held)
            if not change.any():
                break
            held = np.clip(held + change, -most, most)
        return held.reshape(controls.shape)

    def _considered_distances(self, held: HeldControls) -> Float[Array, "K"]:
        """Distances, m, up to which pairs of each trial may need to be moved apart."""
        A, B = self.problem.dynamics.step(np.array([0.0, self.problem.time_step]))
        burns = burn_covariance(held[:, None], self.problem, self.uncertainty)
        known, free, pushed = self.covariance.reshape(-1, 1, 6, 6), A[:, :3], B[:, :3]
        positions = free @ known @ free.mT + pushed @ burns @ pushed.mT
        variance = np.trace(positions, axis1=2, axis2=3).reshape(len(self.estimate), -1)
        margin = self.sigmas * np.sqrt(2 * variance.max(axis=1))
        return np.asarray(self.problem.collision_radius + np.maximum(margin, CLOSE))

    def _changes(self, found: Approaches, held: HeldControls) -> HeldControls:
        """Changes of controls, m/s², that give each pair the required separation."""
        problem, i, j = self.problem, found.first, found.second
        begin = self.estimate.reshape(-1, 6)
        gap = np.matvec(found.state_map, begin[i] - begin[j])
        gap += np.matvec(found.control_map, held[i] - held[j])
        apart = norm(gap)
        normal = gap / np.maximum(apart, PROVABLE)[:, None]
        short = self._required_separation(found, normal, held) - found.bound
        able = ~self.adrift.ravel()
        most = found.offset > EARLY * problem.time_step
        wanting = (short > 0) & most & (able[i] | able[j])
        _, B = problem.dynamics.step(problem.time_step)
        weighed = state_weight(problem)[:, None] * B
        row = np.vecmat(normal, found.control_map)  # of a control on the separation, m per m/s²
        # Row by row, since what a matrix product rounds depends on how many rows there are.
        cheapest = np.matvec(np.linalg.inv(weighed.T @ weighed), row)
        share = np.vecdot(row, cheapest) * (able[i].astype(float) + able[j])
        change = cheapest * np.where(wanting, short / np.where(wanting, share, 1.0), 0.0)[:, None]
        total = np.zeros_like(held)
        np.add.at(total, i, change * able[i][:, None])
        np.add.at(total, j, -change * able[j][:, None])
        return total

    def _required_separation(
        self, found: Approaches, normal: Vectors, held: HeldControls
    ) -> Values:
        """Required separations of pairs, m: in standard deviations at most those at either end."""
        i, j, problem = found.first, found.second, self.problem
        n, radius = self.estimate.shape[1], problem.collision_radius
        begin, goal = self.estimate.reshape(-1, 6)[:, :3], self.goal[:, :3]
        A, B = problem.dynamics.step(np.array([0.0, problem.time_step]))
        ends = norm(begin[i] - begin[j]), norm(goal[i % n] - goal[j % n])
        sigmas = np.full(len(i), self.sigmas)
        for apart, free, pushed in zip(ends, A[:, :3], B[:, :3], strict=True):
            maps = np.broadcast_to(free, (len(i), 3, 6)), np.broadcast_to(pushed, (len(i), 3, 3))
            sigma = self._deviation(found, normal, maps, held)
            most = (apart - radius - 2 * PROVABLE) / np.maximum(sigma, PROVABLE)
            sigmas = np.clip(most, 0.0, sigmas)
        sigma = self._deviation(found, normal, (found.state_map, found.control_map), held)
        return radius + 2 * PROVABLE + sigmas * sigma

    def _deviation(
        self, found: Approaches, normal: Vectors, maps: PositionMaps, held: HeldControls
    ) -> Values:
        """Standard deviations of pairs' separations along unit vectors, m, where maps lead."""
        known = self.covariance.reshape(-1, 6, 6)
        burns = burn_covariance(held[:, None], self.problem, self.uncertainty)[:, 0]
        along = [
            standard_deviation(np.vecmat(normal, one), each[found.first] + each[found.second])
            for one, each in zip(maps, (known, burns), strict=True)
        ]
        return np.hypot(*along)


def flown_interval(
    begin: Float[Array, "N 6"], held: HeldControls, problem: Problem
) -> Float[Array, "N 2 6"]:
    """States at both ends of a problem's first interval, m and m/s."""
    A, B = problem.dynamics.step(problem.time_step)
    return np.stack([begin, np.matvec(A, begin) + np.matvec(B, held)], axis=1)
