"""Receding-horizon guidance: at each node craft are replanned from their estimated states.

The goal does not change. Of two plans from the estimate, the planner's new one and the current one
corrected for the goal, the cheaper safe one is flown: so without errors a swarm burns no more than
its plan, in linear motion. Where neither is safe, passive safety is given up first; then the
planner is asked for less and less separation, and the plan that keeps craft furthest apart is
flown.

Two intervals before the end the goal determines all controls: six for six components of a state.
In the last one three are left, and the goal can only be met in part: the control minimizes
‖Δp‖² + ‖Δv/e‖², which is about the size of the relative orbit that results from the error.

Where the standard deviations of errors are known, estimates are filtered first, and in the last
interval pairs are kept apart. With a margin, plans keep a number of standard deviations of each
pair's separation, or as much of it as possible; where burns may be missed, also r_col from a craft
that misses one, until that can be corrected.

A craft that has lost its thrust is an obstacle to the others; it drifts from its estimated state.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import compress

import numpy as np

from pipeline.arrays import Array, Bool, Float, Int
from pipeline.expert import BackOff, Trajectory, with_back_off
from pipeline.flight.errors import Errors, Loss
from pipeline.flight.estimation import Filter
from pipeline.flight.last_interval import LastInterval, flown_interval
from pipeline.orbit.approaches import TOLERANCE
from pipeline.orbit.arrays import Controls, Indices, Values
from pipeline.orbit.feedback import last_control_map
from pipeline.orbit.participants import Obstacle
from pipeline.orbit.partition import SwarmPartition, swarm_partition
from pipeline.orbit.passive_safety import least_after_loss
from pipeline.orbit.problem import Problem
from pipeline.orbit.separation import least_separations, node_distances
from pipeline.orbit.transfer import fly, meet_goal
from pipeline.plan.judge import POSITION_TOLERANCE, VELOCITY_TOLERANCE
from pipeline.plan.plan import SOLVED, Plan
from pipeline.plan.requirements import Requirements
from pipeline.planners.planner import Planner, plans_of, requiring
from pipeline.scenario import Scenario

DETERMINED = 2  # intervals left in which the goal determines all controls; no planner is asked
# Share of r_col to which separations asked for are rounded down, so that many trials share one
GRAIN = 1 / 60
# Intervals from the start of a missed burn until it can be corrected: it is known after one, and
# at the beginning of the next no thruster moves a craft far
REACTION = 1.25
EVEN = 0.05  # difference in shortfall, m, up to which plans count as equally wide
LESS = (0.02, 0.1, 0.3)  # shares by which separation is lowered where no safe plan is found

RemainingControls = Float[Array, "K n left 3"]
EachTrial = Float[Array, "K"]
EachState = Float[Array, "K n 6"]

Margin = tuple[Requirements, BackOff]  # what plans must keep; a back-off beyond r_col


class ClosedLoop:
    """Guidance of K trials, each replanned at every node but the first."""

    def __init__(
        self,
        scenario: Scenario,
        controls: Controls,
        planner: Planner,
        loss: Loss,
        errors: Errors,
        back_off: BackOff | None = None,
    ) -> None:
        """Begin with a plan's controls, m/s²; keep a back-off, if given, that is not too expensive.

        Estimates are filtered by the errors. A loss of thrust is known at the next node, or as late
        as states are. After it neither a back-off is kept, which the expert cannot keep from
        obstacles, nor passive safety, which is for one loss.
        """
        trials, problem = len(loss.craft), scenario.problem
        self._scenario, self._planner, self._back_off = scenario, planner, back_off
        self._loss, self._lost = loss, np.full(trials, -1)  # craft known to have lost its thrust
        self._after = planner  # planner then, and where passive safety cannot be kept
        if planner.requirements.passive_safety is not None:
            self._after = requiring(planner, replace(planner.requirements, passive_safety=None))
        self._allowance = float(np.abs(controls).sum())
        self._ahead = np.broadcast_to(controls, (trials, *controls.shape))
        self._errors = errors
        self._filter = Filter(problem, errors.gaussian(problem.time_step))
        self._commanded: Float[Array, "K n 3"] | None = None
        # By trial, the nodes at which no known plan to the goal satisfies the requirements
        self.unsafe = np.zeros(trials, dtype=int)
        # Planning time by trial and node; NaN at the first and where no planner is asked
        self.seconds = np.full((trials, problem.intervals), np.nan)

    def __call__(self, node: int, estimate: EachState) -> Float[Array, "K n 3"]:
        """Controls, m/s², for the interval after a node, from the states estimated there."""
        problem = self._scenario.problem
        left = problem.intervals - node
        estimate = self._filter(node, estimate, self._commanded)
        if node > 0:
            self._lost = self._loss.by(node - self._loss.latency)
            self._ahead = self._ahead[:, :, 1:]
            if left == 1:
                self._end(estimate)
            else:
                rest = replace(problem.starting_at(node), nodes=left + 1)
                self._replan(estimate, rest)
        self._commanded = self._ahead[:, :, 0]
        return self._commanded

    def _replan(self, estimate: EachState, problem: Problem) -> None:
        """Choose the controls of the rest of the transfer, which is the given problem."""
        goal = np.broadcast_to(self._scenario.goal, estimate.shape)
        corrected = meet_goal(estimate, self._ahead, goal, problem)
        apart = node_distances(estimate[:, :, None]).min(axis=(1, 2), initial=np.inf)
        required, asked = self._planner.requirements, _separations_to_ask(problem, apart)
        choice = Choice(problem, estimate, corrected, required, self._lost, self._allowance)
        self._ahead = choice.controls
        if problem.intervals > DETERMINED:
            self.seconds[:, -problem.intervals] = 0.0  # of the node at which the rest begins
            relaxed = required.passive_safety is not None
            self._ask(choice, self._planner, asked[:1] if relaxed else asked)
            if relaxed and choice.open.any():  # rather in flight than after a loss of thrust
                least = self._after.requirements
                flown = Choice(problem, estimate, choice.controls, least, self._lost)
                flown.open &= choice.open
                self._ask(flown, self._after, asked)
                relaxing = choice.open[:, None, None, None]
                self._ahead = np.where(relaxing, flown.controls, choice.controls)
        self.unsafe += ~choice.safe(problem.collision_radius)

    def _ask(self, choice: "Choice", planner: Planner, separations: Sequence[EachTrial]) -> None:
        """Have a planner plan for each separation in turn, until all trials have a safe plan."""
        for asked in separations:
            for radius in np.unique(asked[choice.open & (asked > 0)]).tolist():
                wider = replace(choice.problem, collision_radius=radius)
                asks = replace(self._scenario, problem=wider)
                here = choice.open & (asked == radius)
                for some in (here & (self._lost < 0), here & (self._lost >= 0)):  # of one n each
                    which = np.flatnonzero(some)
                    starts = [replace(asks, initial=choice.estimate[k]) for k in which]
                    if some.any():
                        starts = list(map(without_craft, starts, self._lost[which].tolist()))
                        self._offer(choice, which, starts, planner)

    def _offer(
        self, choice: "Choice", which: Indices, starts: Sequence[Scenario], planner: Planner
    ) -> None:
        """Replan some trials and offer the plans; with a back-off where no craft is lost."""
        radius = starts[0].problem.collision_radius
        intact = self._lost[which[0]] < 0
        plans = plans_of(planner if intact else self._after, starts)
        self._add_seconds(which, plans)
        whole = radius == self._scenario.problem.collision_radius
        if self._back_off is not None and intact and whole:
            safe = np.array([plan.status == SOLVED for plan in plans])
            least = planner.requirements
            for required in asked_with_margin(least, choice.problem, self._errors):
                safe &= choice.open[which]
                seeds = list(compress(plans, safe))
                further = with_back_off(seeds, self._back_off, required)
                self._add_seconds(which[safe], further)
                choice.offer(which[safe], further, radius, (required, self._back_off))
        left = choice.open[which]
        choice.offer(which[left], list(compress(plans, left)), radius)

    def _add_seconds(self, which: Indices, plans: Sequence[Plan]) -> None:
        """Add the time that plans took to that of the node at which they begin."""
        for k, plan in zip(which, plans, strict=True):
            left = plan.controls.shape[1]
            stages = ("plan", "certificate")
            self.seconds[k, -left] += sum(plan.timing.get(stage, 0.0) for stage in stages)

    def _end(self, estimate: EachState) -> None:
        """Choose the last controls: those ending nearest the goal, or the planned ones if safer."""
        whole = self._scenario.problem
        problem = whole.starting_at(whole.intervals - 1)
        A, _ = problem.dynamics.step(problem.time_step)
        miss = self._scenario.goal - np.matvec(A, estimate)
        required = self._planner.requirements
        planned = Choice(problem, estimate, self._ahead, required, self._lost)
        nearest = np.matvec(last_control_map(whole), miss)
        if not required.at_nodes:
            last = LastInterval(
                problem=problem,
                estimate=estimate,
                covariance=self._filter.covariance.reshape(*estimate.shape, 6),
                goal=self._scenario.goal,
                uncertainty=self._filter.errors,
                sigmas=0.0 if self._back_off is None else self._back_off.sigmas,
                adrift=self._lost[:, None] == np.arange(estimate.shape[1]),
            )
            nearest = last.kept_apart(nearest)
        homing = Choice(problem, estimate, nearest[:, :, None], required, self._lost)
        # Where both are unsafe, the one that keeps craft further apart
        homes = homing.separation > problem.collision_radius
        homes |= homing.separation >= planned.separation
        self._ahead = np.where(homes[:, None, None, None], homing.controls, planned.controls)
        flown = np.where(homes, homing.separation, planned.separation)
        self.unsafe += flown <= problem.collision_radius


def asked_with_margin(
    requirements: Requirements, problem: Problem, errors: Errors
) -> list[Requirements]:
    """Requirements to plan for with a margin, in turn until there is a plan.

    Where burns may be missed, the first include passive safety until a missed one is corrected,
    unless separation counts at the nodes only.
    """
    orbits = REACTION * problem.time_step * problem.mean_motion / (2 * np.pi)
    enough = requirements.at_nodes or (requirements.passive_safety or 0.0) >= orbits
    if errors.missed == 0 or enough:
        return [requirements]
    return [replace(requirements, passive_safety=orbits), requirements]


def without_craft(scenario: Scenario, craft: int) -> Scenario:
    """The scenario without a craft, which becomes a drifting obstacle; unchanged for -1."""
    if craft < 0:
        return scenario
    state, radius = tuple(scenario.initial[craft].tolist()), scenario.problem.collision_radius / 2
    adrift = Obstacle(f"craft {craft}, adrift", state, radius)
    others = scenario.only([k for k in range(scenario.n) if k != craft])
    return replace(others, obstacles=(*scenario.obstacles, adrift))


def _separations_to_ask(problem: Problem, apart: EachTrial) -> list[EachTrial]:
    """Separations to plan for in turn, m, by trial: r_col or the present one if less; then less."""
    radius = problem.collision_radius
    grains = np.floor((np.minimum(apart, 2 * radius) - 2 * TOLERANCE) / (GRAIN * radius))
    least = np.minimum(radius, radius * (grains * GRAIN))
    return [least, *(least * (1 - share) for share in LESS)]


class Choice:
    """The choice between several plans for each of K trials."""

    def __init__(
        self,
        problem: Problem,
        estimate: EachState,
        under_way: RemainingControls,
        requirements: Requirements,
        lost: Int[Array, "K"],
        allowance: float = np.inf,
    ) -> None:
        """Begin with the current controls, m/s², corrected for the goal, over the rest.

        The problem is that of the intervals left, and the estimate has the states where it begins.
        ``lost`` is the craft of each trial without thrust, and so without controls; -1 for none.
        The allowance, m/s², is the additional fuel that a back-off may cost.
        """
        self.problem, self.estimate, self._requirements = problem, estimate, requirements
        self._lost, under_way = lost, np.array(under_way)
        adrift = lost >= 0
        under_way[adrift, lost[adrift]] = 0.0
        self.controls = self._within_limit(under_way)  # of the best plan so far, m/s²
        self._most = _fuel(self.controls) + allowance
        # Bound on the least separation with these, m: at the times, and after a loss, as required
        self.separation = self._separation(slice(None), self.controls)
        self.open = np.ones(len(estimate), dtype=bool)  # no plan yet is safe and meets the goal
        self._to_goal = np.abs(under_way).max(axis=(1, 2, 3)) <= problem.most_control

    def offer(
        self, which: Indices, plans: Sequence[Plan], radius: float, margin: Margin | None = None
    ) -> None:
        """Choose between a new and the current plan of each trial, and close it where one is safe.

        Of two safe ones the cheaper is taken. Where neither is safe, the one that keeps craft
        further apart remains; but one that misses the goal does not replace one that meets it.
        Plans are for the trials ``which``, all open, and for separation by a radius, m. With a
        margin, a plan must keep all of it or, where it has no other requirements than the choice,
        fall short by less than the other; and a new one must not cost too much.
        """
        if not plans:
            return
        each = [plan.controls for plan in plans]
        for k, lost in enumerate(self._lost[which].tolist()):
            if lost >= 0:  # it is none of the plan's craft
                each[k] = np.insert(each[k], lost, 0.0, axis=0)
        controls = self._within_limit(np.stack(each))
        separation = self._separation(which, controls)
        to_goal = np.array([_is_at_goal(plan, self.problem) for plan in plans])
        safe = to_goal & (separation > radius)
        kept = self._to_goal[which] & (self.separation[which] > radius)
        further = (separation > self.separation[which]) & (to_goal | ~self._to_goal[which])
        cheaper = _fuel(controls) < _fuel(self.controls[which])
        if margin is not None:
            safe &= _fuel(controls) <= self._most[which]
            short = self._shortfall(margin, which, controls)
            before = self._shortfall(margin, which, self.controls[which])
            alike = np.abs(short - before) <= EVEN
            cheaper = np.where(alike, cheaper, short < before)
            if margin[0] == self._requirements:  # the one under way only beside another
                kept &= safe | (before == 0)
            else:
                safe, kept = safe & (short == 0), kept & (before == 0)
            further[:] = False  # which is for the plan without a margin
        better = np.where(safe & kept, cheaper, np.where(safe | kept, safe, further))
        taken = which[better]
        self.controls[taken], self.separation[taken] = controls[better], separation[better]
        self._to_goal[taken] = to_goal[better]
        self.open[which] = ~(safe | kept)

    def safe(self, radius: float) -> Bool[Array, "K"]:
        """Whether the chosen plan meets the goal and keeps craft further apart than a radius, m."""
        return self._to_goal & (self.separation > radius)

    def _within_limit(self, controls: RemainingControls) -> RemainingControls:
        limit = self.problem.max_acceleration
        return np.array(controls) if limit is None else np.clip(controls, -limit, limit)

    def _shortfall(self, margin: Margin, which: Indices, controls: RemainingControls) -> Values:
        """Largest shortfall of a margin with some controls, by trial, m."""
        (flown, swarms), (required, back_off) = self._flown(which, controls), margin
        return back_off.shortfall(flown, self.problem, required, swarms)

    def _flown(
        self, which: Indices | slice, controls: RemainingControls
    ) -> tuple[Trajectory, SwarmPartition]:
        """Motion of the craft of trials from the estimate, and their partition into trials."""
        trials, n, intervals, _ = controls.shape
        initial, flat = self.estimate[which].reshape(-1, 6), controls.reshape(-1, intervals, 3)
        if intervals == self.problem.intervals:
            states = fly(initial, flat, self.problem)
        else:  # the last interval alone
            states = flown_interval(initial, flat[:, 0], self.problem)
        return Trajectory(flat, states), swarm_partition((n,) * trials)

    def _separation(self, which: Indices | slice, controls: RemainingControls) -> Values:
        (trials, n), (flown, swarms) = controls.shape[:2], self._flown(which, controls)
        states, flat = flown.states, flown.controls
        if self._requirements.at_nodes:
            each = states.reshape(trials, n, *states.shape[1:])
            return node_distances(each).min(axis=(1, 2), initial=np.inf)
        found = least_separations(states, flat, self.problem, swarms)
        bounds = np.array([one.bound for one in found])
        orbits = self._requirements.passive_safety
        if orbits is None or n == 1:
            return bounds
        drifting = least_after_loss(states, flat, self.problem, orbits, swarms)
        lost = self._lost[which] >= 0
        return np.where(lost, bounds, np.minimum(bounds, [one.bound for one in drifting]))


def _is_at_goal(plan: Plan, problem: Problem) -> bool:
    """Whether a plan, safe or not, meets the goal and keeps to the thrust limit."""
    missed = plan.certificate.goal_error, plan.certificate.goal_velocity_error
    within = float(np.abs(plan.controls).max()) <= problem.most_control
    return within and missed[0] <= POSITION_TOLERANCE and missed[1] <= VELOCITY_TOLERANCE


def _fuel(controls: RemainingControls) -> EachTrial:
    return np.abs(controls).sum(axis=(1, 2, 3))
