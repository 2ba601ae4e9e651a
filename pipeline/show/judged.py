"""A plan as read from a file, flown and certified anew: what a page shows is never a mere claim."""

from dataclasses import dataclass, replace

import numpy as np

from pipeline.errors import InputError
from pipeline.orbit.approaches import TOLERANCE
from pipeline.orbit.problem import Problem
from pipeline.orbit.risk import FAR, collision_risk
from pipeline.plan import (
    SOLVED,
    Certificate,
    Made,
    Plan,
    Risk,
    is_passively_safe,
    is_safe,
    planned,
)
from pipeline.plan.planned import POSITION_TOLERANCE
from pipeline.scenario import Scenario
from pipeline.scenario.scenario import FURTHEST

RELATIVE = 1e-6
"""Share by which a claimed cost may differ from the one found anew."""


SAME = 1e-2
"""Share by which a claimed risk may be below the one found anew: its quadrature is so exact."""


@dataclass(frozen=True, eq=False)
class Judged:
    """A plan as its controls fly it.

    Attributes:
        plan: states, certificate and status found anew from the scenario and the controls; the
            lower bound on the fuel and how it was proven are as the file has them.
        safe: whether no pair comes within r_col, at any time or at the nodes, whichever was asked,
            nor after a loss of thrust where that is claimed.
        faults: what is wrong with it, in sentences; empty where it is solved.
    """

    plan: Plan
    safe: bool
    faults: tuple[str, ...]


def judged(claimed: Plan, scenario: Scenario) -> Judged:
    """Fly a plan's controls from its scenario's initial states and certify what comes of it.

    Raises:
        InputError: where the controls lead nowhere that a number could say, or where passive
            safety is claimed for no length of a drift, or with separation at the nodes only.
    """
    said = claimed.certificate
    made = Made(claimed.controls, said.fuel_lower_bound, said.fuel_lower_bound_proof)
    _refuse_overflow(claimed, scenario)
    found = planned(claimed.planner, scenario, made, claimed.requirements)
    found = _with_risk(found, said.risk, scenario.problem)
    plan = replace(
        found, convex_solves=claimed.convex_solves, timing=claimed.timing, message=claimed.message
    )
    faults = [f"The plan is {claimed.status}: {claimed.message}"] * (claimed.status != SOLVED)
    if found.status != SOLVED and found.message != claimed.message:
        faults.append(found.message[0].upper() + found.message[1:])
    off = float(np.abs(claimed.states - found.states)[..., :3].max())
    if not off <= POSITION_TOLERANCE:
        faults.append(
            f"The file's states are up to {off:.3g} m from where its controls lead; shown is "
            "where they lead"
        )
    faults += _false_claims(said, found.certificate, scenario.problem)
    safe = is_safe(found.certificate, scenario.problem, claimed.requirements)
    safe &= is_passively_safe(found.certificate, scenario.problem)
    return Judged(plan, safe, tuple(fault.rstrip(".") + "." for fault in faults))


def _with_risk(plan: Plan, said: Risk | None, problem: Problem) -> Plan:
    """The plan with the risk of its controls, by the errors that the file says, where it does."""
    if said is None:
        return plan
    found = collision_risk(plan.states, plan.controls, problem, said.uncertainty)
    risk = replace(said, bound=found.total)
    return replace(plan, certificate=replace(plan.certificate, risk=risk))


def _refuse_overflow(claimed: Plan, scenario: Scenario) -> None:
    """Controls so large that arithmetic on them has no meaning."""
    problem = scenario.problem
    push = float(np.abs(claimed.controls).max()) * problem.duration**2
    if not push <= FURTHEST:
        raise InputError(
            f"the controls reach {np.abs(claimed.controls).max():.3g} m/s², which leads beyond "
            f"{FURTHEST:g} m; expected the accelerations of a relative transfer, in m/s²."
        )


def _false_claims(said: Certificate, found: Certificate, problem: Problem) -> list[str]:
    """Where a file's certificate says other than its controls give, or more; NaN is other."""
    wrong = []
    for name, unit in (("fuel", " m/s²"), ("delta_v", " m/s"), ("node_collisions", "")):
        theirs, ours = getattr(said, name), getattr(found, name)
        if not abs(theirs - ours) <= RELATIVE * abs(ours):
            wrong.append((name, theirs, ours, unit))
    for name in ("craft_delta_v", "craft_delta_v_2norm"):
        both = list(zip(getattr(said, name), getattr(found, name), strict=False))
        wrong += [
            (f"{name}[{k}]", theirs, ours, " m/s")
            for k, (theirs, ours) in enumerate(both)
            if not abs(theirs - ours) <= RELATIVE * found.delta_v
        ][:1]
    for name in ("min_separation", "min_separation_bound"):
        theirs, ours = getattr(said, name), getattr(found, name)
        if None not in (theirs, ours) and not theirs <= ours + 2 * TOLERANCE:
            wrong.append((name, theirs, ours, " m"))
    if said.passive_safety is not None and found.passive_safety is not None:
        for name in ("min_separation", "min_separation_bound"):
            theirs, ours = getattr(said.passive_safety, name), getattr(found.passive_safety, name)
            if None not in (theirs, ours) and not theirs <= ours + 2 * TOLERANCE:
                wrong.append((f"passive_safety.{name}", theirs, ours, " m"))
    if not said.fuel_lower_bound <= found.fuel * (1 + RELATIVE) + problem.negligible_fuel:
        wrong.append(("fuel_lower_bound", said.fuel_lower_bound, found.fuel, " m/s² at most"))
    if said.risk and found.risk and not found.risk.bound <= said.risk.bound * (1 + SAME) + FAR:
        wrong.append(("risk.bound", said.risk.bound, found.risk.bound, ""))
    return [
        f"The file claims {name} {theirs:.6g}{unit.removesuffix(' at most')}, its controls give "
        f"{ours:.6g}{unit}"
        for name, theirs, ours, unit in wrong
    ]
