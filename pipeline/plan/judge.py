"""From controls to a plan: flown, certified and judged, whichever planner they come from."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from time import perf_counter

import numpy as np

from pipeline.errors import InputError
from pipeline.orbit.arrays import Controls
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import dynamics_defect, fly, with_coasts
from pipeline.plan.certificate import Certificate, certify
from pipeline.plan.plan import SOLVED, UNSAFE, UNSOLVED, Plan
from pipeline.plan.requirements import AT_ALL_TIMES, Requirements
from pipeline.scenario import Scenario, shared_problem

POSITION_TOLERANCE = 1e-6  # largest miss of a position that counts as rounding, m
VELOCITY_TOLERANCE = 1e-9  # largest miss of a velocity that counts as rounding, m/s


@dataclass(frozen=True, eq=False)
class Made:
    """A planner's controls for a scenario, before they are flown and judged."""

    controls: Controls  # m/s²
    fuel_lower_bound: float  # sum of the decoupled optima, m/s²
    proof: str = ""  # of that bound, in words
    convex_solves: int = 0  # joint convex programs that it took
    timing: Mapping[str, float] = field(default_factory=dict)  # seconds by stage


def planned_all(
    planner: str,
    scenarios: Sequence[Scenario],
    made: Sequence[Made],
    requirements: Requirements = AT_ALL_TIMES,
) -> list[Plan]:
    """The plans of a planner's controls for scenarios of one problem, with their status."""
    if not scenarios:
        return []
    started = perf_counter()
    problem = shared_problem(scenarios)
    controls = with_coasts(np.concatenate([one.controls for one in made]), problem)
    states = fly(np.concatenate([s.initial for s in scenarios]), controls, problem)
    bounds = [(one.fuel_lower_bound, one.proof) for one in made]
    certificates = certify(scenarios, states, controls, bounds, requirements)
    each = (perf_counter() - started) / len(scenarios)
    ends = np.cumsum([s.n for s in scenarios])[:-1]
    flown, burned = np.split(states, ends), np.split(controls, ends)
    plans = []
    every = zip(scenarios, made, flown, burned, certificates, strict=True)
    for scenario, one, theirs, burns, certificate in every:
        status, message = judge(certificate, burns, problem, requirements)
        plans.append(
            Plan(
                scenario,
                planner,
                status,
                theirs,
                burns,
                certificate,
                one.convex_solves,
                {**one.timing, "certificate": each},
                message,
                separation=requirements.separation,
            )
        )
    return plans


def planned(
    planner: str, scenario: Scenario, made: Made, requirements: Requirements = AT_ALL_TIMES
) -> Plan:
    """The plan of one scenario, as in ``planned_all``."""
    return planned_all(planner, [scenario], [made], requirements)[0]


def judge(
    certificate: Certificate,
    controls: Controls,
    problem: Problem,
    requirements: Requirements = AT_ALL_TIMES,
) -> tuple[str, str]:
    """Status of a plan by its certificate and controls (m/s²), and why it is not SOLVED."""
    wrong = violations(certificate, controls, problem, requirements)
    if "goal" in wrong:
        return UNSOLVED, wrong["goal"]
    return (UNSAFE if wrong else SOLVED), "; ".join(wrong.values())


def violations(
    certificate: Certificate,
    controls: Controls,
    problem: Problem,
    requirements: Requirements = AT_ALL_TIMES,
) -> dict[str, str]:
    """What a plan does not satisfy, in words: goal, thrust, separation, passive safety and risk.

    The one judgement of a plan; NaN satisfies nothing.
    """
    found = {
        "goal": _missed(certificate),
        "thrust": _too_strong(controls, problem),
        "separation": _too_close(certificate, problem, requirements),
        "passive safety": _too_close_drifting(certificate, problem),
        "risk": _too_risky(certificate, problem),
    }
    return {what: text for what, text in found.items() if text}


def is_safe(
    certificate: Certificate, problem: Problem, requirements: Requirements = AT_ALL_TIMES
) -> bool:
    """Whether no pair comes within the collision radius: at any time, or at the nodes only."""
    if certificate.min_separation_bound is None or requirements.at_nodes:
        return certificate.node_collisions == 0
    return certificate.min_separation_bound > problem.collision_radius


def check_states(plan: Plan) -> None:
    """Refuse a plan whose states start elsewhere or break the dynamics with an InputError."""
    defect = dynamics_defect(plan.states, plan.controls, plan.scenario.problem)[..., :3]
    start = (plan.states[:, 0] - plan.scenario.initial)[:, :3]
    off = max(float(np.abs(defect).max()), float(np.abs(start).max()))
    if not off <= POSITION_TOLERANCE:
        raise InputError(
            f"the plan's states are up to {off:.3g} m off those that its controls lead to; "
            "expected a plan as it was made: plan again."
        )


def _missed(certificate: Certificate) -> str:
    position, velocity = certificate.goal_error, certificate.goal_velocity_error
    if position <= POSITION_TOLERANCE and velocity <= VELOCITY_TOLERANCE:
        return ""
    return f"misses its goal by {position:.3g} m and {velocity:.3g} m/s"


def _too_strong(controls: Controls, problem: Problem) -> str:
    limit, used = problem.max_acceleration, float(np.abs(controls).max())
    if limit is None or used <= problem.most_control:
        return ""
    return f"uses {used:.6g} m/s² where max_acceleration is {limit:g} m/s²"


def _too_close(certificate: Certificate, problem: Problem, requirements: Requirements) -> str:
    if is_safe(certificate, problem, requirements):
        return ""
    pair = " and ".join(map(str, certificate.min_separation_pair or ()))
    return (
        f"craft {pair} come within {certificate.min_separation:.6g} m of each other at "
        f"{certificate.min_separation_time:.6g} s; collision_radius is "
        f"{problem.collision_radius:g} m"
    )


def _too_close_drifting(certificate: Certificate, problem: Problem) -> str:
    found, radius = certificate.passive_safety, problem.collision_radius
    if found is None or found.pair is None or found.min_separation_bound is None:
        return ""
    if found.min_separation_bound > radius:
        return ""
    (i, j), last = found.pair, problem.nodes - 1
    whence = "its goal" if found.node == last else f"node {found.node}, should it lose thrust there"
    return (
        f"craft {i}, adrift from {whence}, comes within {found.min_separation:.6g} m of craft {j} "
        f"at {found.time:.6g} s; collision_radius is {radius:g} m"
    )


def _too_risky(certificate: Certificate, problem: Problem) -> str:
    risk = certificate.risk
    if risk is None or risk.kept:
        return ""
    return (
        f"the risk that a pair comes within {problem.collision_radius:g} m is bounded by "
        f"{risk.bound:.3g}, asked for was {risk.asked:g}"
    )
