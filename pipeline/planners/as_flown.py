"""Plans made for the nonlinear flight about a reference orbit, by any planner.

The planner plans in the linear time-varying model about that orbit. Its controls are flown in all
terms of gravity, J2 and drag; what is missed at the goal is of second order in the size of the
swarm, and small changes of the burns make up for it, in two or three steps of Newton's method. So
coasts stay coasts, and the active constraints of the linear programs stay active.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from pipeline.errors import InputError
from pipeline.expert.decoupled import decoupled_optima
from pipeline.orbit.arrays import Controls, Formation
from pipeline.orbit.decoupled import least_fuel
from pipeline.orbit.nonlinear import ends_in_world
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.orbit.transfer import COAST, fly, state_weight, transfer_maps
from pipeline.plan import INFEASIBLE, SOLVED, UNSAFE, UNSOLVED, Made, Plan, Requirements, planned
from pipeline.planners.planner import Planner
from pipeline.scenario import Scenario

CORRECTIONS = 8  # steps at most; each leaves about the square of what was missed
MET = np.repeat([1e-7, 1e-10], 3)  # miss of a goal that no further step is worth, m and m/s
LIMIT_SHARE = 1 - 1e-3  # of the thrust limit that is left to the planner; corrections have the rest
WIDER = 1.5  # times what was missing that a planner is asked to add to the separation
TRIES = 4  # separations that are asked for at most

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
        asked = [self._about(one) for one in scenarios]
        return [
            self._flown(scenario, plan)
            for scenario, plan in zip(asked, self._plans(asked), strict=True)
        ]

    def _about(self, scenario: Scenario) -> Scenario:
        orbit = self.orbit or scenario.problem.orbit
        if orbit is None:
            raise InputError(
                "the scenario has no reference orbit; expected one to plan as flown: name "
                "conditions, or give the scenario an orbit."
            )
        return replace(scenario, problem=scenario.problem.about(orbit))

    def _plans(self, scenarios: Sequence[Scenario], wider: float = 0.0) -> list[Plan]:
        """Linear plans with so much more separation, m, and a little less thrust."""
        problem = scenarios[0].problem
        limit, radius = problem.max_acceleration, problem.collision_radius
        limit = None if limit is None else limit * LIMIT_SHARE
        narrower = replace(problem, max_acceleration=limit, collision_radius=radius + wider)
        return self.planner.plan([replace(one, problem=narrower) for one in scenarios])

    def _flown(self, scenario: Scenario, linear: Plan) -> Plan:
        """The plan as flown, planned again with more separation where craft come too close."""
        started, wider, solves = perf_counter(), 0.0, 0
        for _ in range(TRIES):
            asked = replace(scenario, goal=linear.scenario.goal)
            plan, solves = (
                _corrected(asked, linear, self.requirements),
                solves + linear.convex_solves,
            )
            if plan.status != UNSAFE or linear.status != SOLVED:
                break
            wider += WIDER * _missing(plan)
            (linear,) = self._plans([scenario], wider)
        spent = perf_counter() - started
        timing = {**plan.timing, "plan": plan.timing.get("plan", 0.0) + spent}
        return replace(plan, convex_solves=solves, timing=timing)


def _missing(plan: Plan) -> float:
    """By how much craft come too close in a flight, also adrift, m."""
    found, radius = plan.certificate, plan.scenario.problem.collision_radius
    drift = found.passive_safety
    bounds = (found.min_separation_bound, None if drift is None else drift.min_separation_bound)
    return max(radius - bound for bound in bounds if bound is not None) + 1e-3


def _corrected(scenario: Scenario, linear: Plan, requirements: Requirements) -> Plan:
    """The plan of a linear plan's controls, corrected until their flight meets the goals."""
    problem, initial, goal = scenario.problem, scenario.initial, scenario.goal
    controls, end = linear.controls, ends_in_world(initial, linear.controls, problem)
    for _ in range(CORRECTIONS):
        if (np.abs(goal - end) <= MET).all():
            break
        controls = _changed(controls, goal - end, problem)
        end = ends_in_world(initial, controls, problem)
    made = _made(scenario, controls, end, linear)
    plan = planned(linear.planner, scenario, made, requirements, as_flown=True)
    plan = replace(plan, assignment=linear.assignment)
    if linear.status == SOLVED or plan.status == SOLVED:
        return plan
    why = f"about this orbit the plan is {linear.status}: {linear.message}"
    status = UNSOLVED if linear.status in (INFEASIBLE, UNSOLVED) else plan.status
    return replace(plan, status=status, message=why)


def _made(scenario: Scenario, controls: Controls, end: Formation, linear: Plan) -> Made:
    """Controls with the bound of the linear programs about the flight, with such an end."""
    problem, initial, found = scenario.problem, scenario.initial, linear.certificate
    bound, proof = found.fuel_lower_bound, found.fuel_lower_bound_proof
    if linear.assignment is None:
        defect = end - fly(initial, controls, problem)[:, -1]
        bound, proof = decoupled_optima(initial, scenario.goal - defect, problem).bound()
    timing = {"plan": linear.timing.get("plan", 0.0)}
    return Made(controls, bound, PROOF.format(proof), linear.convex_solves, timing)


def _changed(controls: Controls, miss: Formation, problem: Problem) -> Controls:
    """Controls that bring about a small change of the final state, m and m/s, to first order.

    By least squares in the burns that are there and not at the limit; where those cannot, by least
    fuel.
    """
    size, limit = np.abs(controls), problem.max_acceleration
    free = size > COAST * np.maximum(size.max(axis=(1, 2), keepdims=True), problem.evasive_control)
    if limit is not None:
        free &= size < limit * LIMIT_SHARE**2
    weight = state_weight(problem)
    columns = (weight[:, None] * transfer_maps(problem).reach[-1]) * free.reshape(len(free), 1, -1)
    wanted = weight * miss
    added = np.matvec(np.linalg.pinv(columns, rcond=1e-6), wanted)
    left = np.abs(wanted - np.matvec(columns, added)).max(axis=1)
    unable = left > 1e-3 * np.abs(wanted).max(axis=1)
    if unable.any() and (optima := least_fuel(miss[unable], problem)) is not None:
        added[unable] = optima.controls.reshape(len(optima.controls), -1)
    return controls + added.reshape(controls.shape)
