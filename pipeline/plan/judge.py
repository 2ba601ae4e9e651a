"""From a planner's controls to a plan: propagation, certificate and status, for all planners."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter

import numpy as np

from pipeline.errors import InputError
from pipeline.orbit.arrays import Controls, CraftMask, States
from pipeline.orbit.nonlinear import NonlinearFlight
from pipeline.orbit.problem import Problem
from pipeline.orbit.thrust_cost import exceeded_limits
from pipeline.orbit.transfer import dynamics_defect, fly, with_coasts
from pipeline.plan.certificate import Certificate, PassiveSafety, certify, side_by_side
from pipeline.plan.plan import SOLVED, UNSAFE, UNSOLVED, Plan
from pipeline.plan.requirements import AT_ALL_TIMES, Requirements
from pipeline.scenario import Scenario, shared_problem

# Violations of thrust limits, in words
EXCEEDS = {
    "max_acceleration": "uses more than its max_acceleration",
    "max_acceleration_norm": "uses more than its max_acceleration_norm",
    "delta_v": "burns more than its delta_v",
    "no_burn": "burns in a stretch of no_burn",
    "min_delta_v": "has a burn smaller than min_delta_v",
}
POSITION_TOLERANCE = 1e-6  # largest miss of a position that counts as rounding, m
VELOCITY_TOLERANCE = 1e-9  # largest miss of a velocity that counts as rounding, m/s
COMPUTABLE = 1e12  # largest distance of craft from the origin, m; there rounding is 0.1 mm


@dataclass(frozen=True, eq=False)
class Draft:
    """A planner's controls for a scenario, before propagation and certificate."""

    controls: Controls  # m/s²
    fuel_lower_bound: float  # sum of the decoupled optima, m/s²
    proof: str = ""  # of that bound, in words
    convex_solves: int = 0  # joint convex programs that it took
    timing: Mapping[str, float] = field(default_factory=dict)  # seconds by stage
    least_share: float = 0.0  # lower bound on the largest share, for a fair objective


def certified_plans(
    planner: str,
    scenarios: Sequence[Scenario],
    drafts: Sequence[Draft],
    requirements: Requirements = AT_ALL_TIMES,
    *,
    as_flown: bool = False,
) -> list[Plan]:
    """The plans of a planner's controls for scenarios of one problem, with their status.

    ``as_flown``, motion is nonlinear about the problem's reference orbit; else it is linear, and
    craft that their controls lead beyond COMPUTABLE coast instead, and miss their goals.
    """
    if not scenarios:
        return []
    started, problem = perf_counter(), shared_problem(scenarios)
    controls = np.concatenate([one.controls for one in drafts])
    flights = []
    if as_flown:
        both = zip(scenarios, drafts, strict=True)
        flights = [NonlinearFlight(s.initial, one.controls, problem) for s, one in both]
        states = np.concatenate([flight.states for flight in flights])
    else:
        initial = np.concatenate([s.initial for s in scenarios])
        controls = _with_coasts(controls, scenarios)
        states = fly(initial, controls, problem)
        lost = ~is_computable(states, controls, problem)
        if lost.any():  # arithmetic has no meaning there
            controls[lost] = 0.0
            states = fly(initial, controls, problem)
    bounds = [(one.fuel_lower_bound, one.proof) for one in drafts]
    shares = [one.least_share for one in drafts]
    certificates = certify(scenarios, states, controls, bounds, requirements, flights, shares)
    each = (perf_counter() - started) / len(scenarios)
    swarms = side_by_side(scenarios)
    parts = swarms.split(states), swarms.split(controls), certificates
    plans = []
    for scenario, one, flown, burned, certificate in zip(scenarios, drafts, *parts, strict=True):
        plan = Plan(
            scenario=scenario,
            planner=planner,
            status=SOLVED,
            states=flown,
            controls=burned,
            certificate=certificate,
            convex_solves=one.convex_solves,
            timing={**one.timing, "certificate": each},
            separation=requirements.separation,
            as_flown=as_flown,
        )
        plans.append(with_status(plan))
    return plans


def is_computable(states: States, controls: Controls, problem: Problem) -> CraftMask:
    """Which craft stay within COMPUTABLE, at nodes and, by the size of controls, between them."""
    at_nodes = np.abs(states[..., :3]).max(axis=(1, 2))
    between = np.abs(controls).max(axis=(1, 2)) * problem.time_step**2
    return np.asarray((at_nodes <= COMPUTABLE) & (between <= COMPUTABLE))


def _with_coasts(controls: Controls, scenarios: Sequence[Scenario]) -> Controls:
    """The controls with exact zeros where only rounding is left, by ``with_coasts``.

    That keeps goals but not waypoints: craft with waypoints, whose controls are polished already,
    are left out.
    """
    found = with_coasts(controls, shared_problem(scenarios))
    for swarm, craft in zip(scenarios, side_by_side(scenarios).slices, strict=True):
        if passing := [craft.start + one.craft for one in swarm.waypoints]:
            found[passing] = controls[passing]
    return found


def certified_plan(
    planner: str,
    scenario: Scenario,
    draft: Draft,
    requirements: Requirements = AT_ALL_TIMES,
    *,
    as_flown: bool = False,
) -> Plan:
    """The plan of one scenario, as in ``certified_plans``."""
    return certified_plans(planner, [scenario], [draft], requirements, as_flown=as_flown)[0]


def with_status(plan: Plan) -> Plan:
    """The plan with the status that its certificate and controls give, and the reason for it."""
    wrong = violations(plan)
    if "goal" in wrong:
        return replace(plan, status=UNSOLVED, message=wrong["goal"])
    return replace(plan, status=UNSAFE if wrong else SOLVED, message="; ".join(wrong.values()))


def violations(plan: Plan) -> dict[str, str]:
    """Violated requirements of a plan by name, in words; NaN violates any."""
    wrong, found, problem = {}, plan.certificate, plan.scenario.problem
    radius, limit, limits = problem.collision_radius, problem.max_acceleration, plan.scenario.limits
    used = np.abs(plan.controls).max()
    misses = {
        "goal": ("its goal", found.goal_error, found.goal_velocity_error),
        "waypoints": ("a waypoint", found.waypoint_error, found.waypoint_velocity_error),
    }
    for name, (what, position, velocity) in misses.items():
        position, velocity = position or 0.0, velocity or 0.0
        if not (position <= POSITION_TOLERANCE and velocity <= VELOCITY_TOLERANCE):
            wrong[name] = f"misses {what} by {position:.3g} m and {velocity:.3g} m/s"
    if limits is not None:
        exceeded = exceeded_limits(plan.controls, limits, problem).items()
        first = {name: int(craft.argmax()) for name, craft in exceeded if craft.any()}
        if first:
            faults = (f"craft {craft} {EXCEEDS[name]}" for name, craft in first.items())
            wrong["thrust"] = ", and ".join(faults)
    elif limit is not None and not used <= problem.most_control:
        wrong["thrust"] = f"uses {used:.6g} m/s² where max_acceleration is {limit:g} m/s²"
    if not is_safe(found, problem, plan.requirements):
        wrong["separation"] = _too_close(plan)
    inside = found.corridor
    if inside and not inside.min_margin_bound > 0:
        k = inside.corridor
        wrong["corridor"] = (
            f"craft {inside.craft} is {-inside.min_margin:.6g} m outside corridors[{k}], "
            f"{plan.scenario.corridors[k].inside} at {inside.time:.6g} s"
        )
    drift = found.passive_safety
    if drift and not is_passively_safe(drift, radius):
        wrong["passive safety"] = _too_close_adrift(drift, problem)
    if found.risk and not found.risk.kept:
        wrong["risk"] = (
            f"the risk that a pair comes within {radius:g} m is bounded by {found.risk.bound:.3g}, "
            f"asked for was {found.risk.asked:g}"
        )
    return wrong


def _too_close(plan: Plan) -> str:
    found, radius = plan.certificate, plan.scenario.problem.collision_radius
    counted = ""  # what comes closest may do so between nodes, where it does not count
    if plan.requirements.at_nodes:
        counted = f"pairs too close at nodes: {found.node_collisions}; at any time, "
    if found.clearance is not None and found.clearance.min_clearance_bound <= 0:
        return counted + found.clearance.said(f"craft {found.clearance.craft}")
    pair = " and ".join(map(str, found.min_separation_pair or ()))
    return (
        f"{counted}craft {pair} come within {found.min_separation:.6g} m of each other at "
        f"{found.min_separation_time:.6g} s; collision_radius is {radius:g} m"
    )


def _too_close_adrift(drift: PassiveSafety, problem: Problem) -> str:
    node = drift.node if drift.clearance is None else drift.clearance.node
    given = f"node {node}, should it lose thrust there"
    whence = f", adrift from {'its goal' if node == problem.nodes - 1 else given},"
    if drift.clearance is not None:
        return drift.clearance.said(f"craft {drift.clearance.craft}{whence}")
    i, j = drift.pair or (0, 0)
    return (
        f"craft {i}{whence} comes within {drift.min_separation:.6g} m of craft {j} at "
        f"{drift.time:.6g} s; collision_radius is {problem.collision_radius:g} m"
    )


def is_safe(
    certificate: Certificate, problem: Problem, requirements: Requirements = AT_ALL_TIMES
) -> bool:
    """Whether all pairs stay apart by the collision radius, or by their sizes where these differ.

    At all times, or at the nodes only, as required.
    """
    clear = certificate.clearance
    if requirements.at_nodes or (clear is None and certificate.min_separation_bound is None):
        return certificate.node_collisions == 0
    if clear is not None:
        return clear.min_clearance_bound > 0
    return (certificate.min_separation_bound or 0.0) > problem.collision_radius


def is_passively_safe(drift: PassiveSafety, radius: float) -> bool:
    """Whether all pairs stay apart, by the collision radius or sizes, after a loss of thrust."""
    if drift.clearance is not None:
        return drift.clearance.min_clearance_bound > 0
    return drift.pair is None or (drift.min_separation_bound or 0.0) > radius


def check_states(plan: Plan) -> None:
    """Refuse a plan with wrong initial states, or that break the dynamics, with an InputError."""
    problem, initial = plan.scenario.problem, plan.scenario.initial
    if plan.as_flown:
        defect = plan.states - NonlinearFlight(initial, plan.controls, problem).states
    else:
        defect = dynamics_defect(plan.states, plan.controls, problem)
    start = plan.states[:, 0] - initial
    off = max(float(np.abs(one[..., :3]).max()) for one in (defect, start))
    if not off <= POSITION_TOLERANCE:
        over = "" if plan.as_flown else " over one interval"
        raise InputError(
            f"the plan's states are up to {off:.3g} m off those that its controls lead to"
            f"{over}; expected a plan as it was made: plan again."
        )
