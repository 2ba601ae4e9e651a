"""Of several plans from where craft seem to be, the one that is flown."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.arrays import Array
from pipeline.orbit.approaches import side_by_side
from pipeline.orbit.problem import Problem
from pipeline.orbit.separation import least_separations, node_distances
from pipeline.orbit.thrust_loss import least_after_loss
from pipeline.orbit.transfer import fly
from pipeline.plan import AT_ALL_TIMES, Plan, Requirements
from pipeline.plan.planned import POSITION_TOLERANCE, VELOCITY_TOLERANCE

SomeControls = Float[Array, "K n left 3"]


class Choice:
    """Of several plans for each of K trials, the one that is flown.

    Attributes:
        controls: of the best so far, (K, n, intervals, 3), m/s².
        separation: no pair comes closer than this on them, from the estimate, (K,), m: at any time
            or at the nodes, and after a loss of thrust, as is required.
        open: whether none of them is both safe and to the goal, (K,).
    """

    def __init__(
        self,
        problem: Problem,
        estimate: Float[Array, "K n 6"],
        under_way: SomeControls,
        allowance: float = np.inf,
        requirements: Requirements = AT_ALL_TIMES,
    ) -> None:
        """Begin with what is under way, corrected for the goal.

        Args:
            problem: of what is left.
            estimate: states, as they are known, m and m/s.
            under_way: its controls, m/s².
            allowance: fuel beyond its own which more separation than r_col may cost, m/s².
            requirements: what separation is required.
        """
        self._problem, self._estimate, self._requirements = problem, estimate, requirements
        self.controls = self._within_limit(under_way)
        self._most = _fuel(self.controls) + allowance
        self.separation = self._separation(slice(None), self.controls)
        self.open = np.ones(len(estimate), dtype=bool)
        self._to_goal = np.abs(under_way).max(axis=(1, 2, 3)) <= problem.most_control

    def offer(self, which: Int[Array, "k"], plans: Sequence[Plan], radius: float) -> None:
        """Close trials whose new plan, or the one under way, is safe: the cheaper of both.

        Where neither is, the one remains that keeps craft further apart; but one that misses the
        goal does not take the place of one that meets it. Where a margin has a price that is out of
        all proportion, as where all craft must turn round for it, the plan counts as none.

        Args:
            which: trials, all of them open.
            plans: for each of them.
            radius: separation that was asked for, m.
        """
        controls = self._within_limit(np.stack([plan.controls for plan in plans]))
        separation = self._separation(which, controls)
        to_goal = np.array([_is_at_goal(plan, self._problem) for plan in plans])
        worth = (_fuel(controls) <= self._most[which]) | (radius <= self._problem.collision_radius)
        safe = worth & to_goal & (separation > radius)
        kept = self._to_goal[which] & (self.separation[which] > radius)
        cheaper = _fuel(controls) < _fuel(self.controls[which])
        further = worth & (separation > self.separation[which]) & (to_goal | ~self._to_goal[which])
        better = np.where(safe & kept, cheaper, np.where(safe | kept, safe, further))
        taken = which[better]
        self.controls[taken], self.separation[taken] = controls[better], separation[better]
        self._to_goal[taken] = to_goal[better]
        self.open[which] = ~(safe | kept)

    def safe(self, radius: float) -> Bool[Array, "K"]:
        """Whether what is flown meets the goal and is safe from the estimate, m."""
        return self._to_goal & (self.separation > radius)

    def offer_end(self, controls: SomeControls) -> None:
        """Take controls of the last interval where they are safe, or no less so than others."""
        limited = self._within_limit(controls)
        separation = self._separation(slice(None), limited)
        safe = separation > self._problem.collision_radius
        better = safe | (separation >= self.separation)
        self.controls = np.where(better[:, None, None, None], limited, self.controls)
        self.separation = np.where(better, separation, self.separation)

    def _within_limit(self, controls: SomeControls) -> SomeControls:
        limit = self._problem.max_acceleration
        return np.array(controls) if limit is None else np.clip(controls, -limit, limit)

    def _separation(
        self, which: Int[Array, "k"] | slice, controls: SomeControls
    ) -> Float[Array, "k"]:
        trials, n, intervals, _ = controls.shape
        initial, flat = self._estimate[which].reshape(-1, 6), controls.reshape(-1, intervals, 3)
        states = _nodes(initial, flat, self._problem)
        if self._requirements.at_nodes:
            each = states.reshape(trials, n, *states.shape[1:])
            return node_distances(each).min(axis=(1, 2), initial=np.inf)
        swarms = side_by_side((n,) * trials)
        found = least_separations(states, flat, self._problem, swarms)
        bounds = np.array([one.bound for one in found])
        orbits = self._requirements.passive_safety
        if orbits is None or n == 1:
            return bounds
        adrift = least_after_loss(states, flat, self._problem, orbits, swarms)
        return np.minimum(bounds, [np.inf if one is None else one.bound for one in adrift])


def _nodes(
    initial: Float[Array, "N 6"], controls: Float[Array, "N intervals 3"], problem: Problem
) -> Float[Array, "N T 6"]:
    """Node states of what controls fly, of however few intervals."""
    if controls.shape[1] == problem.intervals:
        return fly(initial, controls, problem)
    A, B = problem.dynamics.step(problem.time_step)
    return np.stack([initial, np.matvec(A, initial) + np.matvec(B, controls[:, 0])], axis=1)


def _is_at_goal(plan: Plan, problem: Problem) -> bool:
    """Whether a plan, safe or not, meets the goal and keeps to the thrust limit."""
    missed = plan.certificate.goal_error, plan.certificate.goal_velocity_error
    within = float(np.abs(plan.controls).max()) <= problem.most_control
    return within and missed[0] <= POSITION_TOLERANCE and missed[1] <= VELOCITY_TOLERANCE


def _fuel(controls: SomeControls) -> Float[Array, "K"]:
    return np.abs(controls).sum(axis=(1, 2, 3))
