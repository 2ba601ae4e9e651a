"""Plans made for the nonlinear flight about a reference orbit, by any planner.

The planner plans in the linear time-varying model about that orbit, and its controls are flown
with the full equations of gravity, J2 and drag. The miss of goals and waypoints is of second order
in the size of the swarm; small changes of the burns correct it, in two or three steps of Newton's
method. So coasts stay coasts, and active constraints stay active. Where the miss is large, as by
differential drag, or craft come too close or leave a corridor, it plans again.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import TypeVar

import numpy as np

from pipeline.arrays import Array, Bool, Float
from pipeline.errors import InputError, ProlearnError
from pipeline.expert.batch import Batch, impossible_for_any_goals, impossible_states
from pipeline.expert.decoupled import INTEGERS, minimum_fuel
from pipeline.expert.impulse_bit import integer_optima
from pipeline.expert.subproblem import UnsolvableError
from pipeline.orbit.arrays import Controls, CraftMask, States, Values, norm
from pipeline.orbit.corridors import Corridor, Faces
from pipeline.orbit.nonlinear import NonlinearFlight
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.orbit.separation import node_distances
from pipeline.orbit.thrust import Limits, Thrust
from pipeline.orbit.thrust_cost import allocated_thrusts
from pipeline.orbit.transfer import COAST, fly
from pipeline.plan.certificate import Certificate, gap_of
from pipeline.plan.judge import POSITION_TOLERANCE, Draft, certified_plan
from pipeline.plan.plan import INFEASIBLE, SOLVED, UNSAFE, UNSOLVED, Plan
from pipeline.plan.requirements import Requirements
from pipeline.planners.goal_assignment import GoalAssignment, with_saving
from pipeline.planners.planner import Planner, PlannerWrapper, plans_of
from pipeline.scenario import Scenario
from pipeline.scenario.spacecraft import Spacecraft
from pipeline.scenario.state_constraints import StateConstraints, timed_constraints
from pipeline.scenario.waypoint import Waypoint, waypoint_nodes

MOST_CORRECTIONS = 8  # steps of Newton's method, which converges quadratically
GOAL_TOLERANCE = np.repeat([1e-7, 1e-10], 3)  # miss of a goal that is not corrected, m and m/s
LIMIT_SHARE = 1 - 1e-3  # of the thrust limit that is left to the planner; corrections have the rest
WIDENING = 1.5  # factor on a shortfall of separation or corridor margin, for the next plan
RISK_WIDENING = 0.05  # separation added where the risk is too large as flown, m
MOST_FUEL_ADDED = 1e-3  # by corrections, as a share of the bound; beyond it plans are made anew
SAMPLES = 24  # times of an arc at which its bound counts corridors, besides their begin and end
MOST_SAMPLES = 4_000  # of all arcs, for which memory is enough
MOST_PLANS = 4  # plans that are made at most, the first included
ABOUT_FLIGHT = "about the flight, to first order"  # how bounds are meant

Waypoints = tuple[Waypoint, ...]


@dataclass(frozen=True)
class AsFlown(PlannerWrapper):
    """A planner whose plans satisfy what is required in the nonlinear flight."""

    orbit: ReferenceOrbit | None = None  # None for that of each scenario

    def plan(self, scenarios: Sequence[Scenario]) -> list[Plan]:
        """One plan for each scenario, about the reference orbit."""
        if not scenarios:
            return []
        asked = [self._about(one) for one in scenarios]
        plans = _planned(self.planner, asked)
        return [self._flown(one, plan) for one, plan in zip(asked, plans, strict=True)]

    def _about(self, scenario: Scenario) -> Scenario:
        orbit = self.orbit or scenario.problem.orbit
        if orbit is None:
            raise InputError(
                "the scenario has no reference orbit; expected one to plan as flown: name "
                "conditions, or give the scenario an orbit."
            )
        if scenario.sized and self.requirements.at_nodes:
            raise InputError(
                "craft have radii of their own, or there are obstacles, and separation is asked "
                "for at the nodes only of a plan as flown; expected it at all times with these: "
                "leave world out, or those."
            )
        return replace(scenario, problem=scenario.problem.about(orbit))

    def _flown(self, scenario: Scenario, linear: Plan) -> Plan:
        """The plan as flown, planned again where it is not safe there, or burns too much."""
        started, planning, more = perf_counter(), linear.timing.get("plan", 0.0), np.zeros(2)
        solves = linear.convex_solves
        passed = _passed(linear)
        plan = _corrected(scenario, linear, self.requirements, passed)
        if linear.status == INFEASIBLE and (why := impossible_states(scenario)):
            assigned = isinstance(self.planner, GoalAssignment)  # other orders may be possible
            if not assigned or impossible_for_any_goals(replace(scenario, obstacles=())):
                plan = replace(plan, status=INFEASIBLE, message=why)
        best = plan
        for tried in range(MOST_PLANS - 1):
            is_dear = tried == 0 and _is_dear(plan, linear.certificate)
            if linear.status != SOLVED or not (plan.status == UNSAFE or is_dear):
                break
            more += WIDENING * np.array([_separation_shortfall(plan), _corridor_shortfall(plan)])
            linear = self._replanned(plan, linear, passed, more)
            solves += linear.convex_solves
            if linear.status == SOLVED:
                plan = _corrected(scenario, linear, self.requirements, passed)
                best = min(best, plan, key=_rank)
        best = _with_saving_in_flight(_with_bound_of_burns(best, linear), scenario)
        spent = perf_counter() - started - best.timing["certificate"]
        timing = {**best.timing, "plan": planning + spent}
        return replace(best, convex_solves=solves, timing=timing)

    def _replanned(self, plan: Plan, linear: Plan, passed: Waypoints, more: Values) -> Plan:
        """A new linear plan with more separation and margin, m, for goals shifted by the flight.

        For the goals themselves where none is found. Assignment and waypoint times are kept.
        """
        planner = self.planner
        if isinstance(planner, GoalAssignment):
            planner = planner.planner
        asked, solves = replace(plan.scenario, waypoints=passed), 0
        for one in (_shifted_to_linear(asked, plan.controls, plan.states), asked):
            (found,) = _planned(planner, [one.wider(*more.tolist())])
            solves += found.convex_solves
            if found.status == SOLVED:
                break
        kept = {name: getattr(linear, name) for name in ("scenario", "certificate", "assignment")}
        return replace(found, convex_solves=solves, **kept)


def _is_dear(plan: Plan, linear: Certificate) -> bool:
    """Whether corrections add much to the fuel of a linear plan, beside what bounds change."""
    found = plan.certificate
    if plan.scenario.corridors or linear.smallest_burn:  # on which bounds depend too much
        return found.fuel > linear.fuel * (1 + MOST_FUEL_ADDED)
    return found.optimality_gap > linear.optimality_gap + MOST_FUEL_ADDED


def _rank(plan: Plan) -> tuple[bool, bool, float]:
    """Sort key of plans: the best comes first."""
    return plan.status != SOLVED, not plan.as_flown, plan.certificate.fuel


def _passed(linear: Plan) -> Waypoints:
    """The waypoints at the times when a linear plan passes them; none if it misses one."""
    problem, waypoints = linear.scenario.problem, linear.scenario.waypoints
    if (linear.certificate.waypoint_error or 0.0) > POSITION_TOLERANCE:
        return ()
    found = waypoint_nodes(waypoints, linear.states, problem)
    both = [one for some in found.values() for one in some]
    return tuple(replace(one, time=node * problem.time_step) for node, one in both)


def _shifted_to_linear(scenario: Scenario, controls: Controls, states: States) -> Scenario:
    """The scenario with goals and waypoints less the deviation of a flight from linear motion."""
    problem = scenario.problem
    deviation = states - fly(scenario.initial, controls, problem)
    waypoints = []
    for one in scenario.waypoints:
        x, y, z, *velocity = (one.state - deviation[one.craft, one.node(problem)]).tolist()
        faster = None if one.velocity is None else tuple(velocity)
        waypoints.append(replace(one, position=(x, y, z), velocity=faster))
    return replace(scenario, goal=scenario.goal - deviation[:, -1], waypoints=tuple(waypoints))


def _faces_about(flight: NonlinearFlight, corridors: Sequence[Corridor]) -> Faces:
    """Faces of corridors at single times, less the deviation of a flight from linear motion."""
    n, problem = len(flight.initial), flight.problem
    faces, linear = Faces.of(corridors, n), fly(flight.initial, flight.controls, problem)
    each = max(1, min(SAMPLES * flight.arcs.shape[2], MOST_SAMPLES // problem.intervals))
    grid = np.linspace(0.0, problem.duration, each * problem.intervals + 1)
    times = np.unique(np.concatenate([grid, faces.begin, faces.end]))
    off = flight.from_linear_at(linear, times)
    row, at = np.nonzero((faces.begin[:, None] <= times) & (times <= faces.end[:, None]))
    faces, when = faces[row], times[at]
    offset = faces.offset - np.vecdot(faces.normal, off[faces.craft, at])
    return replace(faces, offset=offset, begin=when, end=when)


def _planned(planner: Planner, scenarios: Sequence[Scenario]) -> list[Plan]:
    """Linear plans within limits lowered for corrections or, where none is, the limits given."""
    lowered = [_with_lower_limits(one) for one in scenarios]
    plans = plans_of(planner, lowered)
    for k, (asked, less) in enumerate(zip(scenarios, lowered, strict=True)):
        limited = (asked.problem, asked.craft) != (less.problem, less.craft)
        if plans[k].status in (INFEASIBLE, UNSOLVED) and limited:
            (plans[k],) = plans_of(planner, [asked])
    return plans


def _with_lower_limits(scenario: Scenario) -> Scenario:
    problem = _lower_limits(scenario.problem)
    problem = replace(problem, thrust=_lower_limits(problem.thrust))
    return replace(scenario, problem=problem, craft=tuple(map(_lower_limits, scenario.craft)))


Limited = TypeVar("Limited", Problem, Thrust, Spacecraft)


def _lower_limits(given: Limited) -> Limited:
    """The same with slightly lower thrust limits, and a slightly larger smallest burn."""
    limits = "max_acceleration", "max_acceleration_norm", "delta_v"
    share = {**dict.fromkeys(limits, LIMIT_SHARE), "min_delta_v": 1 / LIMIT_SHARE}
    values = {name: getattr(given, name, None) for name in share}
    eased = {name: share[name] * one for name, one in values.items() if one is not None}
    return replace(given, **eased)


def _separation_shortfall(plan: Plan) -> float:
    """Shortfall of the least separation in a flight, m; 0 where there is none."""
    found, radius = plan.certificate, plan.scenario.problem.collision_radius
    least, drift = found.min_separation_bound, found.passive_safety
    if plan.requirements.at_nodes:
        least = node_distances(plan.states).min(initial=np.inf)
    both = [(least, found.clearance)]
    if drift is not None:
        both.append((drift.min_separation_bound, drift.clearance))
    bounds = [one if by is None else radius + by.min_clearance_bound for one, by in both]
    close = [float(radius - one) for one in bounds if one is not None and one <= radius]
    if found.risk is not None and not found.risk.kept:
        close.append(RISK_WIDENING)
    return max(close) + 1e-3 if close else 0.0


def _corridor_shortfall(plan: Plan) -> float:
    """How far a craft leaves its corridor in a flight, m; 0 where none does."""
    found = plan.certificate.corridor
    return 0.0 if found is None or found.min_margin_bound > 0 else 1e-3 - found.min_margin_bound


def _corrected(
    scenario: Scenario, linear: Plan, requirements: Requirements, passed: Waypoints
) -> Plan:
    """Correct a linear plan until its nonlinear flight meets the goals; UNSOLVED if it cannot."""
    scenario = replace(scenario, goal=linear.scenario.goal)  # as they are assigned
    timed = replace(scenario, waypoints=passed)
    try:
        controls, states = _differentially_corrected(timed, linear.controls)
        made = _draft(timed, controls, states, linear)
        plan = certified_plan(linear.planner, scenario, made, requirements, as_flown=True)
    except ProlearnError as error:
        why = f"as flown: {error}".removesuffix(".")
        chosen = linear.assignment and replace(linear.assignment, saving=None)
        return replace(linear, scenario=scenario, status=UNSOLVED, message=why, assignment=chosen)
    found, before = plan.certificate, linear.certificate
    if found.risk and before.risk:
        made_for = {name: getattr(before.risk, name) for name in ("sigmas", "fuel_without")}
        found = replace(found, risk=replace(found.risk, **made_for))
    if found.smallest_burn and before.smallest_burn:
        burn = replace(found.smallest_burn, fuel_without=before.smallest_burn.fuel_without)
        found = replace(found, smallest_burn=burn)
    plan = replace(plan, certificate=found, assignment=linear.assignment)
    if linear.status not in (INFEASIBLE, UNSOLVED) or plan.status == SOLVED:
        return plan
    why = f"about this orbit the plan is {linear.status}: {linear.message}"
    return replace(plan, status=UNSOLVED, message=why)


def _with_bound_of_burns(plan: Plan, linear: Plan) -> Plan:
    """A plan whose bound counts the smallest burn, as that of the linear plan does."""
    if not (plan.as_flown and linear.certificate.fuel_lower_bound_proof.startswith(INTEGERS)):
        return plan
    found, free = plan.certificate, replace(plan.scenario, corridors=())
    batch = Batch([_shifted_to_linear(free, plan.controls, plan.states)])
    try:
        batch.optima = integer_optima(batch)
    except UnsolvableError:
        return plan
    bound, proof = batch.bound(0)
    if bound <= found.fuel_lower_bound:
        return plan
    counting = replace(
        found,
        fuel_lower_bound=bound,
        optimality_gap=gap_of(found.fuel, bound, plan.scenario.problem),
        fuel_lower_bound_proof=f"{proof}, {ABOUT_FLIGHT}",
        largest_share=found.largest_share
        and replace(found.largest_share, bound=batch.least_share(0)),
    )
    return replace(plan, certificate=counting)


def _with_saving_in_flight(plan: Plan, asked: Scenario) -> Plan:
    """A plan whose bound for the given order of goals, and saving, are those of its flight."""
    if plan.assignment is None or not plan.as_flown:
        return plan
    # The bound for the given order changes by as much as that for the one that is flown
    given, flown = Batch([asked]), Batch([plan.scenario])
    change = plan.certificate.fuel_lower_bound - flown.bound(0)[0]
    bound = np.inf if given.optima.impossible.any() else given.bound(0)[0] + change
    return replace(plan, assignment=with_saving(plan.assignment, bound, plan))


def _differentially_corrected(scenario: Scenario, controls: Controls) -> tuple[Controls, States]:
    """Controls, and node states of their flight, corrected to meet goals and waypoints.

    Where that fails to reach POSITION_TOLERANCE, the controls with the least miss.
    """
    problem, at = scenario.problem, timed_constraints(scenario)
    tried: list[tuple[float, Controls, States]] = []  # with the miss over GOAL_TOLERANCE
    while len(tried) <= MOST_CORRECTIONS:
        try:
            states = NonlinearFlight(scenario.initial, controls, problem).states
        except ProlearnError:
            if not tried:
                raise
            break
        miss = at.residuals(states)
        off = float((np.abs(miss) / np.tile(GOAL_TOLERANCE, len(at.nodes))).max())
        tried.append((off, controls, states))
        if off <= 1:
            break
        controls = _corrected_controls(controls, miss, at, problem, scenario.limits)
    if tried[-1][0] > POSITION_TOLERANCE / GOAL_TOLERANCE[0]:
        tried.sort(key=lambda one: -one[0])
    return tried[-1][1:]


def _draft(scenario: Scenario, controls: Controls, states: States, linear: Plan) -> Draft:
    """The controls of a flight, with a fuel bound of linear programs about that flight."""
    # A goal that is met within tolerance is where the flight ends: to coast there takes no fuel.
    met = np.abs(states[:, -1] - scenario.goal) <= GOAL_TOLERANCE
    goal = np.where(met, states[:, -1], scenario.goal)
    free = replace(scenario, corridors=(), goal=goal)
    try:
        shifted = _shifted_to_linear(free, controls, states)
    except InputError as error:  # beyond the largest position of a scenario
        off = float(np.abs(states[:, -1] - scenario.goal)[:, :3].max())
        raise ProlearnError(f"craft end up to {off:.3g} m off their goals") from error
    batch = Batch([shifted], constraints=timed_constraints(shifted))
    if scenario.corridors:
        flight = NonlinearFlight(scenario.initial, controls, scenario.problem)
        batch.optima = batch.inside(_faces_about(flight, scenario.corridors), batch.optima)
    bound, proof = batch.bound(0)
    if linear.assignment is not None or scenario.waypoints != linear.scenario.waypoints:
        # The bound over all goals and times changes by as much as that for these
        given = replace(scenario, problem=linear.scenario.problem, craft=linear.scenario.craft)
        change = bound - Batch([given], constraints=timed_constraints(given)).bound(0)[0]
        certificate = linear.certificate
        bound, proof = certificate.fuel_lower_bound + change, certificate.fuel_lower_bound_proof
    least, timing = batch.least_share(0), {"plan": linear.timing.get("plan", 0.0)}
    proof = f"{proof}, {ABOUT_FLIGHT}"
    return Draft(controls, bound, proof, linear.convex_solves, timing, least)


def _corrected_controls(
    controls: Controls,
    miss: Float[Array, "n r"],
    at: StateConstraints,
    problem: Problem,
    limits: Limits | None,
) -> Controls:
    """Controls corrected, to first order, for a small miss of goals and waypoints, m and m/s.

    By least squares in the burns that are not at the limit, those of each thruster where thrusters
    have given directions; where those do not suffice, by least fuel or, with limits of each craft,
    in all intervals with burns allowed.
    """
    axes, size, limit = np.eye(3), np.abs(controls), problem.max_acceleration
    if limits is not None and not isinstance(problem.thrust.model, str):
        axes, size = np.array(problem.thrust.model), allocated_thrusts(controls, limits, problem)
    largest = size.max(axis=(1, 2), keepdims=True)
    free = size > COAST * np.maximum(largest, problem.evasive_control)
    if limits is not None:
        most = LIMIT_SHARE**2 * np.stack([limits.component, limits.norm])[..., None, None]
        may_burn = limits.burns.any(axis=2, keepdims=True)
        free &= may_burn & (size < most[0]) & (norm(controls)[..., None] < most[1])
    elif limit is not None:
        free &= size < limit * LIMIT_SHARE**2
    added, unable = _least_change(free, miss, at, axes)
    if unable.any() and limits is not None:
        added[unable] = _least_change(limits.burns[unable], miss[unable], at[unable], np.eye(3))[0]
    elif unable.any() and (optima := minimum_fuel(miss[unable], problem)) is not None:
        added[unable] = optima.controls
    return controls + added


def _least_change(
    free: Bool[Array, "n intervals k"],
    miss: Float[Array, "n r"],
    at: StateConstraints,
    axes: Float[Array, "k 3"],
) -> tuple[Controls, CraftMask]:
    """Minimum-norm control corrections for a miss, and a mask of the craft that keep some of it.

    Only free components change, along axes such as directions of thrusters.
    """
    along = at.reach.reshape(len(at.reach), -1, 3) @ axes.T
    columns = (at.weight[:, None] * along.reshape(len(along), -1)) * free.reshape(len(free), 1, -1)
    columns *= at.constrained[..., None]
    wanted = at.weight * miss
    added = np.matvec(np.linalg.pinv(columns, rcond=1e-6), wanted)
    added *= free.reshape(added.shape)  # where it is zero but for rounding
    left = np.abs(wanted - np.matvec(columns, added)).max(axis=1)
    unable = left > 1e-3 * np.abs(wanted).max(axis=1)
    return added.reshape(free.shape) @ axes, unable
