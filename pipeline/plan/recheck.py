"""Check of a plan from a file: its controls are propagated and certified anew."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import nan
from typing import Any

import numpy as np

from pipeline.errors import InputError
from pipeline.orbit.approaches import TOLERANCE
from pipeline.orbit.problem import Problem
from pipeline.orbit.risk import FAR
from pipeline.orbit.transfer import fly
from pipeline.plan.certificate import Certificate
from pipeline.plan.judge import (
    COMPUTABLE,
    POSITION_TOLERANCE,
    Draft,
    certified_plan,
    is_computable,
    violations,
    with_status,
)
from pipeline.plan.plan import SOLVED, Plan
from pipeline.plan.requirements import refuse_risk

RELATIVE = 1e-6  # share by which a claimed cost may differ from the recomputed one
SAME_RISK = 1e-2  # share by which a claimed risk may be below ours: accuracy of the quadrature
# Claims that must equal the recomputed value, with their units
SAME = {
    "fuel": " m/s²",
    "delta_v": " m/s",
    "node_collisions": "",
    "largest_share.share": "",
    "largest_share.craft": "",
    "smallest_burn.least": " m/s",
    "smallest_burn.asked": " m/s",
}
# Claims of each craft, m/s, which may differ by a share of the Δv of all craft
OF_CRAFT = ("craft_delta_v", "craft_delta_v_2norm", "craft_delta_v_thrusters")
# Least distances that may not be claimed larger than recomputed, nor may their lower bounds
DISTANCES = (
    *("min_separation", "passive_safety.min_separation", "clearance.min_clearance"),
    *("corridor.min_margin", "passive_safety.clearance.min_clearance"),
)
BOUNDS = ("fuel_lower_bound", "largest_share.bound")  # of all plans that keep to goals and limits

FalseClaim = tuple[str, float, float, str]  # a field, value claimed, value found, and unit


@dataclass(frozen=True, eq=False)
class Rechecked:
    """A plan recomputed from its controls, and the faults of the one in the file."""

    plan: Plan  # recomputed, but for the lower bound on the fuel and its proof
    safe: bool  # whether craft stay apart and inside corridors, as far as asked or claimed
    faults: tuple[str, ...]  # in sentences; empty for a solved plan whose claims hold


def recheck(claimed: Plan) -> Rechecked:
    """Fly a plan's controls from its scenario's initial states and certify the outcome.

    InputError for controls too large to compute with, and for a risk that cannot be required.
    """
    problem, claims = claimed.scenario.problem, claimed.certificate
    with np.errstate(all="ignore"):
        there = fly(claimed.scenario.initial, claimed.controls, problem)
        fine = is_computable(there, claimed.controls, problem)
    if not fine.all():
        raise InputError(
            f"the controls reach {np.abs(claimed.controls).max():.3g} m/s², which leads beyond "
            f"{COMPUTABLE:g} m; expected the accelerations of a relative transfer, in m/s²."
        )
    bound = claims.fuel_lower_bound, claims.fuel_lower_bound_proof
    share = claims.largest_share.bound if claims.largest_share else 0.0
    draft = Draft(claimed.controls, *bound, claimed.convex_solves, least_share=share)
    scenario, requirements = claimed.scenario, claimed.requirements
    flown = certified_plan(
        claimed.planner, scenario, draft, requirements, as_flown=claimed.as_flown
    )
    if claims.risk is not None:
        refuse_risk([claimed.scenario], closed_loop=claims.risk.feedback is not None)
        # With the errors named in the file
        risk = claims.risk.judge(flown.states, flown.controls, problem)
        flown = with_status(replace(flown, certificate=replace(flown.certificate, risk=risk)))
    faults = [f"The plan is {claimed.status}: {claimed.message}"] * (claimed.status != SOLVED)
    if flown.status != SOLVED and flown.message != claimed.message:
        faults.append(flown.message[0].upper() + flown.message[1:])
    off = float(np.abs(claimed.states - flown.states)[..., :3].max())
    if not off <= POSITION_TOLERANCE:
        faults.append(
            f"The file's states are up to {off:.3g} m from where its controls lead; shown is "
            "where they lead"
        )
    found = flown.certificate
    wrong = violations(flown).keys()
    unsafe = wrong & {"separation", "passive safety", "corridor"}
    if claims.smallest_burn and found.smallest_burn:  # only the planner knows the plan without it
        without = claims.smallest_burn.fuel_without
        found = replace(found, smallest_burn=replace(found.smallest_burn, fuel_without=without))
    faults += [
        f"The file claims {name} {theirs:.6g}{unit.removesuffix(' at most')}, its controls give "
        f"{ours:.6g}{unit}"
        for name, theirs, ours, unit in _false_claims(claims, found, problem)
        # A plan that misses what bounds count may burn less than all that keep to it.
        if name not in BOUNDS or not wrong & {"goal", "waypoints", "thrust", "corridor"}
    ]
    plan = replace(flown, certificate=found, timing=claimed.timing, message=claimed.message)
    return Rechecked(plan, not unsafe, tuple(fault.rstrip(".") + "." for fault in faults))


def _false_claims(
    claims: Certificate, found: Certificate, problem: Problem
) -> Iterator[FalseClaim]:
    """Claims that the controls contradict, or NaN, with both values and the unit."""
    yield from _false_spending(claims, found)
    for name in (part for least in DISTANCES for part in (least, f"{least}_bound")):
        theirs, ours = (_field(one, name) for one in (claims, found))
        if theirs is not None and ours is not None and not theirs <= ours + 2 * TOLERANCE:
            yield name, theirs, ours, " m"
    if claims.largest_share and found.largest_share:
        bound, share = claims.largest_share.bound, found.largest_share.share
        if not bound <= share * (1 + RELATIVE):
            yield "largest_share.bound", bound, share, " at most"
    if not claims.fuel_lower_bound <= found.fuel * (1 + RELATIVE) + problem.negligible_fuel:
        yield "fuel_lower_bound", claims.fuel_lower_bound, found.fuel, " m/s² at most"
    if (
        claims.risk
        and found.risk
        and not found.risk.bound <= claims.risk.bound * (1 + SAME_RISK) + FAR
    ):
        yield "risk.bound", claims.risk.bound, found.risk.bound, ""


def _false_spending(claims: Certificate, found: Certificate) -> Iterator[FalseClaim]:
    """False claims on fuel and Δv of swarm and craft, and on collisions at nodes."""
    for name, unit in SAME.items():
        whole = name.partition(".")[0]
        if getattr(found, whole) is not None:
            # A claim that is missing is NaN, and the least of no burns 0.
            theirs = nan if getattr(claims, whole) is None else _field(claims, name) or 0.0
            ours = _field(found, name) or 0.0
            if not abs(theirs - ours) <= RELATIVE * abs(ours):
                yield name, theirs, ours, unit
    for name in OF_CRAFT:
        both = zip(getattr(claims, name), getattr(found, name), strict=False)
        for k, (theirs, ours) in enumerate(both):
            if not abs(theirs - ours) <= RELATIVE * found.delta_v:
                yield f"{name}[{k}]", theirs, ours, " m/s"
                break


def _field(certificate: Certificate, name: str) -> Any:
    """The field with a dotted name; None where a part of it is missing."""
    found: Any = certificate
    for part in name.split("."):
        found = getattr(found, part, None)
    return found
