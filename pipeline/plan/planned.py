"""From controls to a plan: flown, certified and judged, whichever planner they come from."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from time import perf_counter

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import fly, with_coasts
from pipeline.plan.certificate import Certificate, certify
from pipeline.plan.plan import SOLVED, UNSAFE, UNSOLVED, Plan
from pipeline.plan.requirements import AT_ALL_TIMES, Requirements
from pipeline.scenario import Scenario, shared_problem

POSITION_TOLERANCE = 1e-6
"""Largest miss of a position that counts as rounding, m."""

VELOCITY_TOLERANCE = 1e-9
"""Largest miss of a velocity that counts as rounding, m/s."""


@dataclass(frozen=True, eq=False)
class Made:
    """What a planner made of a scenario, before it is flown and judged.

    Attributes:
        controls: m/s².
        fuel_lower_bound: sum of the own optima, m/s².
        proof: of that bound, in words.
        convex_solves: joint convex programs that it took.
        timing: seconds by stage.
    """

    controls: Float[Array, "n intervals 3"]
    fuel_lower_bound: float
    proof: str = ""
    convex_solves: int = 0
    timing: Mapping[str, float] = field(default_factory=dict)


def planned_all(
    planner: str,
    scenarios: Sequence[Scenario],
    made: Sequence[Made],
    requirements: Requirements = AT_ALL_TIMES,
) -> list[Plan]:
    """The plans of scenarios of one problem; what a certificate proves decides a plan's status.

    Args:
        planner: name of the planner.
        scenarios: what was asked.
        made: what the planner made of each.
        requirements: what a plan must satisfy.
    """
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
    for one, theirs, burns, certificate in zip(made, flown, burned, certificates, strict=True):
        missed = _missed(certificate)
        fault = _fault(burns, certificate, problem, requirements)
        status = UNSOLVED if missed else UNSAFE if fault else SOLVED
        timing = {**one.timing, "certificate": each}
        plans.append(
            Plan(
                planner,
                status,
                theirs,
                burns,
                certificate,
                one.convex_solves,
                timing,
                missed or fault,
                separation=requirements.separation,
            )
        )
    return plans


def planned(
    planner: str,
    scenario: Scenario,
    made: Made,
    requirements: Requirements = AT_ALL_TIMES,
) -> Plan:
    """The plan of one scenario, as in ``planned_all``."""
    return planned_all(planner, [scenario], [made], requirements)[0]


def is_passively_safe(certificate: Certificate, problem: Problem) -> bool:
    """Whether no pair comes within the collision radius after a loss of thrust, if it was asked."""
    adrift = certificate.passive_safety
    if adrift is None or adrift.min_separation_bound is None:
        return True
    return adrift.min_separation_bound > problem.collision_radius


def is_safe(
    certificate: Certificate, problem: Problem, requirements: Requirements = AT_ALL_TIMES
) -> bool:
    """Whether no pair comes within the collision radius: at any time, or at the nodes only."""
    if certificate.min_separation_bound is None or requirements.at_nodes:
        return certificate.node_collisions == 0
    return certificate.min_separation_bound > problem.collision_radius


def _missed(certificate: Certificate) -> str:
    """By how much a plan misses its goal, or nothing; written so that what is no number misses."""
    position, velocity = certificate.goal_error, certificate.goal_velocity_error
    if position <= POSITION_TOLERANCE and velocity <= VELOCITY_TOLERANCE:
        return ""
    return f"misses its goal by {position:.3g} m and {velocity:.3g} m/s"


def _fault(
    controls: Float[Array, "n intervals 3"],
    certificate: Certificate,
    problem: Problem,
    requirements: Requirements,
) -> str:
    """What a plan does not satisfy, point by point, or nothing."""
    points = (
        _too_strong(controls, problem),
        _too_close(certificate, problem, requirements),
        _adrift(certificate, problem),
        _too_risky(certificate, problem),
    )
    return "; ".join(filter(None, points))


def _too_strong(controls: Float[Array, "n intervals 3"], problem: Problem) -> str:
    """By how much a plan breaks the thrust limit."""
    limit, used = problem.max_acceleration, float(np.abs(controls).max())
    if limit is None or used <= problem.most_control:
        return ""
    return f"uses {used:.6g} m/s² where max_acceleration is {limit:g} m/s²"


def _too_close(certificate: Certificate, problem: Problem, requirements: Requirements) -> str:
    """Who meets whom in flight."""
    if is_safe(certificate, problem, requirements):
        return ""
    pair = " and ".join(map(str, certificate.min_separation_pair or ()))
    return (
        f"craft {pair} come within {certificate.min_separation:.6g} m of each other at "
        f"{certificate.min_separation_time:.6g} s; collision_radius is "
        f"{problem.collision_radius:g} m"
    )


def _adrift(certificate: Certificate, problem: Problem) -> str:
    """Who meets whom after a loss of thrust."""
    found = certificate.passive_safety
    if is_passively_safe(certificate, problem) or found is None or found.pair is None:
        return ""
    (i, j), last = found.pair, problem.nodes - 1
    whence = "its goal" if found.node == last else f"node {found.node}, should it lose thrust there"
    return (
        f"craft {i}, adrift from {whence}, comes within {found.min_separation:.6g} m of craft {j} "
        f"at {found.time:.6g} s; collision_radius is {problem.collision_radius:g} m"
    )


def _too_risky(certificate: Certificate, problem: Problem) -> str:
    """What the risk is, where it is more than was asked for."""
    risk = certificate.risk
    if risk is None or risk.kept:
        return ""
    return (
        f"the risk that a pair comes within {problem.collision_radius:g} m is bounded by "
        f"{risk.bound:.3g}, asked for was {risk.asked:g}"
    )
