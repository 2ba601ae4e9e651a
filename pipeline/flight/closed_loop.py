"""The loop closed: at each node craft are planned anew from where they seem to be.

The goal stays. What is flown is the cheapest of two plans that are safe from the estimate, the
planner's new one and the one under way, corrected for the goal: so an undisturbed swarm pays no
more than its plan. Where neither is safe, the planner is asked for less and less separation, and
of all that is known then the plan flies that keeps craft furthest apart.

Two intervals before the end the goal determines all controls: six for six components of a state.
In the last one three are left, and the goal can only be met in part: the control is flown that
leaves the least ‖Δp‖² + ‖Δv/e‖², which is about the size of the orbit that the error becomes.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.flight.choice import Choice
from pipeline.flight.margin import apart_at
from pipeline.orbit.approaches import TOLERANCE
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import meet_goal
from pipeline.plan import Plan
from pipeline.planners.planner import Planner
from pipeline.scenario import Scenario

DETERMINED = 2
"""Intervals left in which the goal determines all controls, so that nobody need be asked."""

GRAIN = 1 / 60
"""Share of r_col to which separations asked for are rounded down, so that many trials share one."""

LESS = (0.02, 0.1, 0.3)
"""Shares of r_col by which less is asked for, in turn, where no safe plan is found."""


class ClosedLoop:
    """Trials side by side, each planned anew at every node but the first; a ``Guidance``.

    Attributes:
        unsafe: nodes of each trial at which no plan to the goal was found that keeps from the
            estimate what the planner is required to, so that the least unsafe one was flown, (K,).
        seconds: what each trial's plan took at each node, (K, intervals); not a number where no
            planner was asked: at the first node, and with one or two intervals left.
    """

    def __init__(
        self,
        scenario: Scenario,
        controls: Float[Array, "n intervals 3"],
        planner: Planner,
        trials: int,
        margin: float = 0.0,
    ) -> None:
        """Begin with a plan.

        Args:
            scenario: what the swarm is to do.
            controls: of the plan that is under way from the first node on, m/s².
            planner: plans anew.
            trials: how many.
            margin: asked for beyond the collision radius, m, where estimates allow it.
        """
        self._scenario, self._planner, self._margin = scenario, planner, margin
        self._allowance = float(np.abs(controls).sum())
        self._ahead = np.broadcast_to(controls, (trials, *controls.shape))
        self.unsafe = np.zeros(trials, dtype=int)
        self.seconds = np.full((trials, scenario.problem.intervals), np.nan)

    def commanded(self, node: int, estimate: Float[Array, "K n 6"]) -> Float[Array, "K n 3"]:
        """Controls of the interval that begins at a node, m/s², as in ``Guidance``."""
        problem = self._scenario.problem
        left = problem.intervals - node
        if node > 0:
            self._ahead = self._ahead[:, :, 1:]
            if left == 1:
                self._end(estimate)
            else:
                self._plan_anew(node, estimate, replace(problem, nodes=left + 1))
        return self._ahead[:, :, 0]

    def _plan_anew(self, node: int, estimate: Float[Array, "K n 6"], problem: Problem) -> None:
        goal = np.broadcast_to(self._scenario.goal, estimate.shape)
        corrected = meet_goal(estimate, self._ahead, goal, problem)
        required = self._planner.requirements
        choice = Choice(problem, estimate, corrected, self._allowance, required)
        if problem.intervals > DETERMINED:
            self._ask(choice, node, estimate, problem)
        self._ahead = choice.controls
        self.unsafe += ~choice.safe(problem.collision_radius)

    def _ask(
        self, choice: "Choice", node: int, estimate: Float[Array, "K n 6"], problem: Problem
    ) -> None:
        """Ask the planner, for less separation each time where it finds nothing safe."""
        self.seconds[:, node] = 0.0
        for asked in _asked(problem, apart_at(estimate), self._margin):
            for radius in np.unique(asked[choice.open & (asked > 0)]).tolist():
                which = np.flatnonzero(choice.open & (asked == radius))
                told = replace(problem, collision_radius=radius)
                plans = self._planner.plan(
                    [replace(self._scenario, problem=told, initial=estimate[k]) for k in which]
                )
                choice.offer(which, plans, radius)
                self.seconds[which, node] += [_seconds(plan) for plan in plans]

    def _end(self, estimate: Float[Array, "K n 6"]) -> None:
        """With one interval left, the nearest to the goal; or as planned, where that is safer."""
        problem = self._scenario.problem
        A, B = problem.dynamics.step(problem.time_step)
        weight = np.repeat([1.0, 1.0 / problem.mean_motion], 3)
        nearest = np.linalg.pinv(weight[:, None] * B) * weight
        miss = self._scenario.goal - np.matvec(A, estimate)
        choice = Choice(problem, estimate, self._ahead, requirements=self._planner.requirements)
        choice.offer_end(np.matvec(nearest, miss)[:, :, None])
        self._ahead = choice.controls
        self.unsafe += choice.separation <= problem.collision_radius


def _asked(
    problem: Problem, apart: Float[Array, "K"], margin: float
) -> Iterator[Float[Array, "K"]]:
    """Separations to ask for in turn, m, of each trial; 0 where there is nothing more to ask.

    No more than craft have already; then r_col alone; then less.
    """
    radius = problem.collision_radius
    grains = np.floor((np.minimum(apart, 2 * radius + margin) - 2 * TOLERANCE) / (GRAIN * radius))
    most = np.minimum(radius + margin, radius * (grains * GRAIN))
    least = np.minimum(most, radius)
    yield most
    yield np.where(least < most, least, 0.0)
    for share in LESS:
        yield least * (1 - share)


def _seconds(plan: Plan) -> float:
    return plan.timing.get("plan", 0.0) + plan.timing.get("certificate", 0.0)
