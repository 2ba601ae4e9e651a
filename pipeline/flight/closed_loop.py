"""Receding-horizon guidance: at each node craft are replanned from their estimated states.

The goal stays. What is flown is the cheapest of two plans that are safe from the estimate, the
planner's new one and the one under way, corrected for the goal: so an undisturbed swarm pays no
more than its plan. Where neither is safe, the planner is asked for less and less separation, and
of all known plans the one is flown that keeps craft furthest apart.

Two intervals before the end the goal determines all controls: six for six components of a state.
In the last one three are left, and the goal can only be met in part: the control is flown that
leaves the least ‖Δp‖² + ‖Δv/e‖², which is about the size of the orbit that the error becomes.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import compress

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.arrays import Array
from pipeline.expert import BackOff, Trajectory, keeps_back_off, with_back_off
from pipeline.orbit.approaches import TOLERANCE, pairs, side_by_side
from pipeline.orbit.bezier import norm
from pipeline.orbit.feedback import last_control
from pipeline.orbit.passive_safety import least_after_loss
from pipeline.orbit.problem import Problem
from pipeline.orbit.separation import least_separations, node_distances
from pipeline.orbit.transfer import fly, meet_goal
from pipeline.plan import SOLVED, Plan, Requirements
from pipeline.plan.judge import POSITION_TOLERANCE, VELOCITY_TOLERANCE
from pipeline.planners.planner import Planner
from pipeline.scenario import Scenario

DETERMINED = 2  # intervals left in which the goal determines all controls; no planner is asked
# Share of r_col to which separations asked for are rounded down, so that many trials share one
GRAIN = 1 / 60
LESS = (0.02, 0.1, 0.3)  # of r_col, by which less is asked for where no safe plan is found

SomeControls = Float[Array, "K n left 3"]
EachTrial = Float[Array, "K"]


class ClosedLoop:
    """Guidance of trials side by side, each replanned at every node but the first.

    Attributes:
        unsafe: number of nodes of each trial at which no known plan to the goal keeps from the
            estimate what the planner is required to, (K,).
        seconds: of planning for each trial at each node, (K, intervals); NaN at the first node and
            with one or two intervals left, where no planner is asked.
    """

    def __init__(
        self,
        scenario: Scenario,
        controls: Float[Array, "n intervals 3"],
        planner: Planner,
        trials: int,
        back_off: BackOff | None = None,
    ) -> None:
        """Begin with a plan's controls, m/s²; keep a back-off too where that is not too dear."""
        self._scenario, self._planner, self._back_off = scenario, planner, back_off
        self._allowance = float(np.abs(controls).sum())
        self._ahead = np.broadcast_to(controls, (trials, *controls.shape))
        self.unsafe = np.zeros(trials, dtype=int)
        self.seconds = np.full((trials, scenario.problem.intervals), np.nan)

    def __call__(self, node: int, estimate: Float[Array, "K n 6"]) -> Float[Array, "K n 3"]:
        """Controls, m/s², for the interval after a node, from the states estimated there."""
        problem = self._scenario.problem
        left = problem.intervals - node
        if node > 0:
            self._ahead = self._ahead[:, :, 1:]
            if left == 1:
                self._end(estimate)
            else:
                rest = replace(problem.starting_at(node), nodes=left + 1)
                self._replan(node, estimate, rest)
        return self._ahead[:, :, 0]

    def _replan(self, node: int, estimate: Float[Array, "K n 6"], problem: Problem) -> None:
        goal = np.broadcast_to(self._scenario.goal, estimate.shape)
        corrected = meet_goal(estimate, self._ahead, goal, problem)
        required = self._planner.requirements
        choice = Choice(problem, estimate, corrected, required, self._allowance)
        if problem.intervals > DETERMINED:
            self._ask(choice, node, estimate, problem)
        self._ahead = choice.controls
        self.unsafe += ~choice.safe(problem.collision_radius)

    def _ask(
        self, choice: "Choice", node: int, estimate: Float[Array, "K n 6"], problem: Problem
    ) -> None:
        """Ask the planner, for less separation each time where it finds nothing safe."""
        self.seconds[:, node] = 0.0
        for asked in _asked(problem, apart_at(estimate)):
            for radius in np.unique(asked[choice.open & (asked > 0)]).tolist():
                which = np.flatnonzero(choice.open & (asked == radius))
                wider = replace(problem, collision_radius=radius)
                asks = replace(self._scenario, problem=wider)
                plans = self._planner.plan([replace(asks, initial=estimate[k]) for k in which])
                self._spent(node, which, plans)
                if self._back_off is not None and radius == problem.collision_radius:
                    safe = np.array([plan.status == SOLVED for plan in plans])
                    seeds, required = list(compress(plans, safe)), self._planner.requirements
                    further = with_back_off(seeds, self._back_off, required)
                    self._spent(node, which[safe], further)
                    choice.offer(which[safe], further, radius, self._back_off)
                left = choice.open[which]
                choice.offer(which[left], list(compress(plans, left)), radius)

    def _spent(self, node: int, which: Int[Array, "k"], plans: Sequence[Plan]) -> None:
        """Count the time that plans took."""
        for k, plan in zip(which, plans, strict=True):
            stages = ("plan", "certificate")
            self.seconds[k, node] += sum(plan.timing.get(stage, 0.0) for stage in stages)

    def _end(self, estimate: Float[Array, "K n 6"]) -> None:
        """Choose the last controls: the nearest to the goal, or the planned ones if safer."""
        whole = self._scenario.problem
        problem = whole.starting_at(whole.intervals - 1)
        A, _ = problem.dynamics.step(problem.time_step)
        miss = self._scenario.goal - np.matvec(A, estimate)
        required = self._planner.requirements
        planned = Choice(problem, estimate, self._ahead, required)
        nearest = np.matvec(last_control(whole), miss)[:, :, None]
        homing = Choice(problem, estimate, nearest, required)
        # Where both are unsafe, the one that keeps craft further apart
        homes = homing.separation > problem.collision_radius
        homes |= homing.separation >= planned.separation
        self._ahead = np.where(homes[:, None, None, None], homing.controls, planned.controls)
        flown = np.where(homes, homing.separation, planned.separation)
        self.unsafe += flown <= problem.collision_radius


def _asked(problem: Problem, apart: EachTrial) -> Iterator[EachTrial]:
    """Separations to ask for in turn, m, of each trial: r_col, or what craft have; then less."""
    radius = problem.collision_radius
    grains = np.floor((np.minimum(apart, 2 * radius) - 2 * TOLERANCE) / (GRAIN * radius))
    least = np.minimum(radius, radius * (grains * GRAIN))
    yield least
    for share in LESS:
        yield least * (1 - share)


def apart_at(states: Float[Array, "K n 6"]) -> EachTrial:
    """Least distance of any pair, m; infinite without a pair."""
    i, j = pairs(states.shape[1])
    return norm(states[:, i, :3] - states[:, j, :3]).min(axis=1, initial=np.inf)


class Choice:
    """The choice of the plan that is flown, of several for each of K trials.

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
        requirements: Requirements,
        allowance: float = np.inf,
    ) -> None:
        """Begin with the controls under way, m/s², corrected for the goal, for what is left.

        The allowance, m/s², is fuel beyond theirs that a back-off may cost.
        """
        self._problem, self._estimate, self._requirements = problem, estimate, requirements
        self.controls = self._within_limit(under_way)
        self._most = _fuel(self.controls) + allowance
        self.separation = self._separation(slice(None), self.controls)
        self.open = np.ones(len(estimate), dtype=bool)
        self._to_goal = np.abs(under_way).max(axis=(1, 2, 3)) <= problem.most_control

    def offer(
        self,
        which: Int[Array, "k"],
        plans: Sequence[Plan],
        radius: float,
        back_off: BackOff | None = None,
    ) -> None:
        """Close trials whose new plan, or the one under way, is safe: the cheaper of both.

        Where neither is, the one remains that keeps craft further apart; but one that misses the
        goal does not replace one that meets it. Plans are for ``which`` trials, all open, and were
        asked for separation by a radius, m; with a back-off only those are safe that keep it, too,
        and do not cost too much, as where all craft must turn round for it.
        """
        if not plans:
            return
        controls = self._within_limit(np.stack([plan.controls for plan in plans]))
        separation = self._separation(which, controls)
        to_goal = np.array([_is_at_goal(plan, self._problem) for plan in plans])
        safe = to_goal & (separation > radius)
        kept = self._to_goal[which] & (self.separation[which] > radius)
        further = (separation > self.separation[which]) & (to_goal | ~self._to_goal[which])
        if back_off is not None:
            worth = _fuel(controls) <= self._most[which]
            safe &= worth & self._keeps(back_off, which, controls)
            kept &= self._keeps(back_off, which, self.controls[which])
            further[:] = False  # which is for the plan without a back-off
        cheaper = _fuel(controls) < _fuel(self.controls[which])
        better = np.where(safe & kept, cheaper, np.where(safe | kept, safe, further))
        taken = which[better]
        self.controls[taken], self.separation[taken] = controls[better], separation[better]
        self._to_goal[taken] = to_goal[better]
        self.open[which] = ~(safe | kept)

    def safe(self, radius: float) -> Bool[Array, "K"]:
        """Whether what is flown meets the goal and keeps further apart than a radius, m."""
        return self._to_goal & (self.separation > radius)

    def _within_limit(self, controls: SomeControls) -> SomeControls:
        limit = self._problem.max_acceleration
        return np.array(controls) if limit is None else np.clip(controls, -limit, limit)

    def _keeps(
        self, back_off: BackOff, which: Int[Array, "k"], controls: SomeControls
    ) -> Bool[Array, "k"]:
        """Whether trials keep a back-off besides, on some controls."""
        trials, n, intervals, _ = controls.shape
        initial, flat = self._estimate[which].reshape(-1, 6), controls.reshape(-1, intervals, 3)
        flown = Trajectory(flat, _nodes(initial, flat, self._problem))
        swarms, asked = side_by_side((n,) * trials), self._requirements
        return keeps_back_off(flown, self._problem, asked, back_off, swarms)

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
        drifting = least_after_loss(states, flat, self._problem, orbits, swarms)
        return np.minimum(bounds, [one.bound for one in drifting])


def _nodes(
    initial: Float[Array, "N 6"], controls: Float[Array, "N intervals 3"], problem: Problem
) -> Float[Array, "N T 6"]:
    """Node states that controls lead to, also over a single interval."""
    if controls.shape[1] == problem.intervals:
        return fly(initial, controls, problem)
    A, B = problem.dynamics.step(problem.time_step)
    return np.stack([initial, np.matvec(A, initial) + np.matvec(B, controls[:, 0])], axis=1)


def _is_at_goal(plan: Plan, problem: Problem) -> bool:
    """Whether a plan, safe or not, meets the goal and keeps to the thrust limit."""
    missed = plan.certificate.goal_error, plan.certificate.goal_velocity_error
    within = float(np.abs(plan.controls).max()) <= problem.most_control
    return within and missed[0] <= POSITION_TOLERANCE and missed[1] <= VELOCITY_TOLERANCE


def _fuel(controls: SomeControls) -> EachTrial:
    return np.abs(controls).sum(axis=(1, 2, 3))
