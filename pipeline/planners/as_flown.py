"""Plans made for the nonlinear flight about a reference orbit, by any planner.

The planner plans in the linear time-varying model about that orbit. Its controls are flown in all
terms of gravity, J2 and drag; what is missed at the goal is of second order in the size of the
swarm, and small changes of the burns make up for it, in two or three steps of Newton's method. So
coasts stay coasts, and the active constraints of the linear programs stay active. Where much is
missed, as by differential drag, and where craft come too close, it plans again with that in view.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import TypeVar

import numpy as np
from jaxtyping import Bool, Float

from pipeline.arrays import Array
from pipeline.errors import InputError
from pipeline.expert.decoupled import decoupled_optima
from pipeline.orbit.approaches import pairs
from pipeline.orbit.arrays import Controls, Formation, Marked
from pipeline.orbit.bezier import norm
from pipeline.orbit.decoupled import least_fuel
from pipeline.orbit.nonlinear import ends_in_world
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.orbit.thrust import Limits, Thrust
from pipeline.orbit.transfer import COAST, fly, state_weight, transfer_maps
from pipeline.plan import INFEASIBLE, SOLVED, UNSAFE, UNSOLVED, Made, Plan, Requirements, planned
from pipeline.planners.goal_assignment import GoalAssignment
from pipeline.planners.planner import Planner
from pipeline.scenario import Scenario
from pipeline.scenario.spacecraft import Spacecraft

CORRECTIONS = 8  # steps at most; each leaves about the square of what was missed
MET = np.repeat([1e-7, 1e-10], 3)  # miss of a goal that no further step is worth, m and m/s
LIMIT_SHARE = 1 - 1e-3  # of the thrust limit that is left to the planner; corrections have the rest
WIDER = 1.5  # times what was missing that a planner is asked to add to the separation
DEAR = 1e-3  # fuel, as a share of the bound, that corrections may cost before it is planned again
TRIES = 4  # plans that are asked for at most

PROOF = "{}, about the flight, to first order"


@dataclass(frozen=True)
class AsFlown:
    """A planner whose plans meet their goals, and keep apart, in the nonlinear flight."""

    planner: Planner
    orbit: ReferenceOrbit | None = None  # or that of each scenario

    def __post_init__(self) -> None:
        """Refuse what is proven in linear motion alone."""
        if self.planner.requirements.risk is not None:
            raise InputError(
                "a risk is asked for of a plan as flown, where it is not proven; expected one of "
                "the two: leave --world out, and fly the plan for what it is worth there."
            )

    @property
    def name(self) -> str:
        """The planner's."""
        return self.planner.name

    @property
    def requirements(self) -> Requirements:
        """The planner's."""
        return self.planner.requirements

    def plan(self, scenarios: Sequence[Scenario]) -> list[Plan]:
        """One plan for each scenario, about the reference orbit."""
        if not scenarios:
            return []
        asked = [self._about(one) for one in scenarios]
        plans = self.planner.plan([_eased(one) for one in asked])
        return [self._flown(one, plan) for one, plan in zip(asked, plans, strict=True)]

    def _about(self, scenario: Scenario) -> Scenario:
        if scenario.waypoints:
            raise InputError(
                "the scenario has waypoints, which are met in linear motion alone; expected none "
                "in a plan as flown: leave --world out, or the waypoints."
            )
        orbit = self.orbit or scenario.problem.orbit
        if orbit is None:
            raise InputError(
                "the scenario has no reference orbit; expected one to plan as flown: name "
                "conditions, or give the scenario an orbit."
            )
        asked = self.requirements
        if scenario.unlike and (asked.at_nodes or asked.passive_safety is not None):
            raise InputError(
                "craft have radii of their own, or there are obstacles, and the plan is asked for "
                "as flown; expected separation at all times and no passive safety with these: "
                "leave --world out, or those."
            )
        if scenario.corridors:
            raise InputError(
                "the scenario has corridors, and its plan is asked for as flown, where that is not "
                "proven; expected one of the two: leave --world out."
            )
        return replace(scenario, problem=scenario.problem.about(orbit))

    def _flown(self, scenario: Scenario, linear: Plan) -> Plan:
        """The plan as flown, planned again where craft come too close, or burn too much."""
        started, planning, wider = perf_counter(), linear.timing.get("plan", 0.0), 0.0
        dear, solves = linear.certificate.optimality_gap + DEAR, linear.convex_solves
        best = plan = _corrected(scenario, linear, self.requirements)
        for tried in range(TRIES - 1):
            is_dear = tried == 0 and plan.certificate.optimality_gap > dear
            if linear.status != SOLVED or not (plan.status == UNSAFE or is_dear):
                break
            wider += WIDER * _missing(plan)
            linear = self._again(plan, linear, wider)
            solves += linear.convex_solves
            if linear.status == SOLVED:
                plan = _corrected(scenario, linear, self.requirements)
                best = min(best, plan, key=_rank)
        spent = perf_counter() - started - best.timing["certificate"]
        timing = {**best.timing, "plan": planning + spent}
        return replace(best, convex_solves=solves, timing=timing)

    def _again(self, plan: Plan, linear: Plan, wider: float) -> Plan:
        """The linear plan with so much more separation, m, that leads to its goals in the flight.

        As far as what linear motion leaves out is what it was, and that way is open to it. Who goes
        where stays as it is.
        """
        scenario, planner = plan.scenario, self.planner
        left_out = _left_out(scenario, plan.controls, plan.states[:, -1])
        if isinstance(planner, GoalAssignment):
            planner = planner.planner
        solves = 0
        for goal in (scenario.goal - left_out, scenario.goal):
            (found,) = planner.plan([_eased(replace(scenario, goal=goal), wider)])
            solves += found.convex_solves
            if found.status == SOLVED:
                break
        kept = {name: getattr(linear, name) for name in ("scenario", "certificate", "assignment")}
        return replace(found, convex_solves=solves, **kept)


def _eased(scenario: Scenario, wider: float = 0.0) -> Scenario:
    """The scenario with so much more separation, m, and a little less thrust."""
    scenario = scenario.wider(wider)
    problem = scenario.problem
    limit = None if problem.max_acceleration is None else problem.max_acceleration * LIMIT_SHARE
    eased = replace(problem, max_acceleration=limit, thrust=_less(problem.thrust))
    return replace(scenario, problem=eased, craft=tuple(map(_less, scenario.craft)))


Limited = TypeVar("Limited", Thrust, Spacecraft)


def _less(given: Limited) -> Limited:
    """The same with a little less of every limit, and larger burns where there is a least."""
    share = {
        "max_acceleration": LIMIT_SHARE,
        "max_acceleration_norm": LIMIT_SHARE,
        "delta_v": LIMIT_SHARE,
        "min_delta_v": 1 / LIMIT_SHARE,
    }
    values = {name: getattr(given, name, None) for name in share}
    eased = {name: share[name] * one for name, one in values.items() if one is not None}
    return replace(given, **eased)


def _rank(plan: Plan) -> tuple[bool, float]:
    return plan.status != SOLVED, plan.certificate.fuel


def _left_out(scenario: Scenario, controls: Controls, end: Formation) -> Formation:
    """By how much a flight of controls ends elsewhere than linear motion, m and m/s."""
    return end - fly(scenario.initial, controls, scenario.problem)[:, -1]


def _missing(plan: Plan) -> float:
    """Shortfall of the least separation in a flight, m; 0 where the plan fails otherwise."""
    found, radius = plan.certificate, plan.scenario.problem.collision_radius
    least, drift = found.min_separation_bound, found.passive_safety
    if plan.requirements.at_nodes:
        i, j = pairs(plan.scenario.n)
        least = norm(plan.states[i, :, :3] - plan.states[j, :, :3]).min(initial=np.inf)
    if found.clearance is not None:
        least = radius + found.clearance.min_clearance_bound
    bounds = [least, None if drift is None else drift.min_separation_bound]
    close = [float(radius - one) for one in bounds if one is not None and one <= radius]
    return max(close) + 1e-3 if close else 0.0


def _corrected(scenario: Scenario, linear: Plan, requirements: Requirements) -> Plan:
    """The plan of a linear plan's controls, corrected until their flight meets the goals."""
    scenario = replace(scenario, goal=linear.scenario.goal)  # as they are assigned
    problem, initial, goal = scenario.problem, scenario.initial, scenario.goal
    controls, end = linear.controls, ends_in_world(initial, linear.controls, problem)
    for _ in range(CORRECTIONS):
        if (np.abs(goal - end) <= MET).all():
            break
        controls = _changed(controls, goal - end, problem, scenario.limits)
        end = ends_in_world(initial, controls, problem)
    made = _made(scenario, controls, end, linear)
    plan = planned(linear.planner, scenario, made, requirements, as_flown=True)
    plan = replace(plan, assignment=linear.assignment)
    if linear.status not in (INFEASIBLE, UNSOLVED) or plan.status == SOLVED:
        return plan
    why = f"about this orbit the plan is {linear.status}: {linear.message}"
    return replace(plan, status=UNSOLVED, message=why)


def _made(scenario: Scenario, controls: Controls, end: Formation, linear: Plan) -> Made:
    """Controls with the bound of the linear programs about the flight, with such an end."""
    problem, initial, found = scenario.problem, scenario.initial, linear.certificate
    goal = scenario.goal - _left_out(scenario, controls, end)
    optima = decoupled_optima(initial, goal, problem, scenario.limits)
    bound, proof = optima.bound()
    if linear.assignment is not None:  # the bound of all assignments changes as this one's
        eased = _eased(scenario)
        linear_optima = decoupled_optima(initial, scenario.goal, eased.problem, eased.limits)
        change = bound - linear_optima.bound()[0]
        bound, proof = found.fuel_lower_bound + change, found.fuel_lower_bound_proof
    timing = {"plan": linear.timing.get("plan", 0.0)}
    least = 0.0
    if problem.thrust.objective == "fair" and scenario.limits is not None:
        least = optima.least_share(scenario.limits, problem.time_step)
    proven = bound, PROOF.format(proof)
    return Made(controls, *proven, linear.convex_solves, timing, least_share=least)


def _changed(
    controls: Controls, miss: Formation, problem: Problem, limits: Limits | None
) -> Controls:
    """Controls that bring about a small change of the final state, m and m/s, to first order.

    By least squares in the burns that are there and not at the limit; where those cannot, by least
    fuel, or, with limits of each craft, in all burns that may be.
    """
    size, limit = np.abs(controls), problem.max_acceleration
    free = size > COAST * np.maximum(size.max(axis=(1, 2), keepdims=True), problem.evasive_control)
    if limits is not None:
        free &= limits.burns & _below(controls, limits)
    elif limit is not None:
        free &= size < limit * LIMIT_SHARE**2
    added, unable = _least_change(free, miss, problem)
    if unable.any() and limits is not None:
        added[unable] = _least_change(limits.burns[unable], miss[unable], problem)[0]
    elif unable.any() and (optima := least_fuel(miss[unable], problem)) is not None:
        added[unable] = optima.controls.reshape(len(optima.controls), -1)
    return controls + added.reshape(controls.shape)


def _below(controls: Controls, limits: Limits) -> Bool[Array, "n intervals 3"]:
    """Components of controls that are at no limit, so that they may grow a little."""
    most = LIMIT_SHARE**2 * np.stack([limits.component, limits.norm])[..., None, None]
    return (np.abs(controls) < most[0]) & (norm(controls)[..., None] < most[1])


def _least_change(
    free: Bool[Array, "n intervals 3"], miss: Formation, problem: Problem
) -> tuple[Float[Array, "n m"], Marked]:
    """Least squares of what is added to free components, and of which craft that is too little."""
    weight = state_weight(problem)
    columns = (weight[:, None] * transfer_maps(problem).reach[-1]) * free.reshape(len(free), 1, -1)
    wanted = weight * miss
    added = np.matvec(np.linalg.pinv(columns, rcond=1e-6), wanted)
    added *= free.reshape(added.shape)  # where it is zero but for rounding
    left = np.abs(wanted - np.matvec(columns, added)).max(axis=1)
    return added, left > 1e-3 * np.abs(wanted).max(axis=1)
