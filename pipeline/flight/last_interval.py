"""Controls of the last interval that keep craft apart: the least changes of those nearest the goal.

Two craft whose goals are close are pushed together by what is left of their errors: the control
that leaves the least ‖Δp‖² + ‖Δv/e‖² gives up positions for velocities. Pairs that would come too
near are moved apart along the line between both at that time, by changes of their controls that
add the least to that sum.
"""

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Array, Bool, Float
from pipeline.orbit.approaches import PROVABLE, Approaches, close_approaches, swarm_partition
from pipeline.orbit.arrays import Formation, Indices, Values, Vectors
from pipeline.orbit.bezier import norm
from pipeline.orbit.covariance import Uncertainty, burn_deviation, standard_deviation
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import state_weight

ROUNDS = 8  # of pushing pairs apart: a craft of two pairs is pushed by both
Held = Float[Array, "N 3"]  # controls of the craft of all trials, m/s²

EARLY = 0.1  # share of the interval up to which no control of it moves a pair to speak of
CLOSE = 5.0  # beyond the collision radius, m, up to which pairs are looked at


@dataclass(frozen=True, eq=False)
class LastInterval:
    """The last interval of K trials of n craft."""

    problem: Problem  # that begins with it
    estimate: Float[Array, "K n 6"]  # states at its start, m and m/s
    covariance: Float[Array, "K n 6 6"]  # of their errors
    goal: Formation  # m and m/s
    uncertainty: Uncertainty  # of burns
    sigmas: float  # standard deviations of a separation to be kept beyond the collision radius
    adrift: Bool[Array, "K n"]  # craft that have no thrust

    def kept_apart(self, controls: Float[Array, "K n 3"]) -> Float[Array, "K n 3"]:
        """The controls, m/s², changed where pairs would come too near; no more than they can."""
        (trials, n, _), problem = self.estimate.shape, self.problem
        held, swarms = controls.reshape(-1, 3), swarm_partition((n,) * trials)
        within, most = problem.collision_radius + CLOSE, problem.most_control
        for _ in range(ROUNDS):
            states = flown_interval(self.estimate.reshape(-1, 6), held, problem)
            found = close_approaches(states, held[:, None], problem, within, swarms=swarms)
            push = self._pushed(found, held)
            if not push.any():
                break
            held = np.clip(held + push, -most, most)
        return held.reshape(controls.shape)

    def _pushed(self, found: Approaches, held: Held) -> Held:
        """Changes of controls that take each pair as far apart as it is to be, m/s²."""
        problem, i, j = self.problem, found.first, found.second
        begin = self.estimate.reshape(-1, 6)
        gap = np.matvec(found.state_map, begin[i] - begin[j]) + np.matvec(
            found.control_map, held[i] - held[j]
        )
        apart = norm(gap)
        normal = gap / np.maximum(apart, PROVABLE)[:, None]
        short = self._wanted(found, normal, held) - found.bound
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
        push = np.zeros_like(held)
        np.add.at(push, i, change * able[i][:, None])
        np.add.at(push, j, -change * able[j][:, None])
        return push

    def _wanted(self, found: Approaches, normal: Vectors, held: Held) -> Values:
        """How far apart pairs are to be, m: no more deviations than they have at either end."""
        i, j, problem = found.first, found.second, self.problem
        n, radius = self.estimate.shape[1], problem.collision_radius
        begin, goal = self.estimate.reshape(-1, 6)[:, :3], self.goal[:, :3]
        A, B = problem.dynamics.step(np.array([0.0, problem.time_step]))
        ends = norm(begin[i] - begin[j]), norm(goal[i % n] - goal[j % n])
        sigmas = np.full(len(i), self.sigmas)
        for apart, free, pushed in zip(ends, A[:, :3], B[:, :3], strict=True):
            maps = np.broadcast_to(free, (len(i), 3, 6)), np.broadcast_to(pushed, (len(i), 3, 3))
            sigma = self._deviation(i, j, normal, maps, held)
            most = (apart - radius - 2 * PROVABLE) / np.maximum(sigma, PROVABLE)
            sigmas = np.clip(most, 0.0, sigmas)
        sigma = self._deviation(i, j, normal, (found.state_map, found.control_map), held)
        return radius + 2 * PROVABLE + sigmas * sigma

    def _deviation(
        self,
        first: Indices,
        second: Indices,
        normal: Vectors,
        maps: tuple[Float[Array, "k 3 6"], Float[Array, "k 3 3"]],
        held: Held,
    ) -> Values:
        """Standard deviations of pairs' separations along unit vectors, m."""
        known = self.covariance.reshape(-1, 6, 6)
        burns = burn_deviation(held[:, None], self.problem, self.uncertainty)[:, 0]
        burns = burns @ burns.mT
        along = [
            standard_deviation(np.vecmat(normal, one), each[first] + each[second])
            for one, each in zip(maps, (known, burns), strict=True)
        ]
        return np.hypot(*along)


def flown_interval(
    begin: Float[Array, "N 6"], held: Held, problem: Problem
) -> Float[Array, "N 2 6"]:
    """States at both ends of a problem's first interval, m and m/s."""
    A, B = problem.dynamics.step(problem.time_step)
    return np.stack([begin, np.matvec(A, begin) + np.matvec(B, held)], axis=1)
