"""A plan as read from a file, flown, certified and judged anew: no claim of it is believed."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import nan
from typing import Any

import numpy as np

from pipeline.errors import InputError
from pipeline.orbit.approaches import TOLERANCE
from pipeline.orbit.problem import Problem
from pipeline.orbit.risk import FAR
from pipeline.plan.certificate import Certificate
from pipeline.plan.judge import POSITION_TOLERANCE, Made, planned, violations
from pipeline.plan.plan import SOLVED, Plan
from pipeline.plan.requirements import refuse_risk
from pipeline.scenario.scenario import FURTHEST

RELATIVE = 1e-6  # share by which a claimed cost may differ from the one found anew
SAME = 1e-2  # share by which a claimed risk may be below ours: its quadrature is so exact
# Least distances that may not be claimed larger than they are found, nor may the bounds below them
DISTANCES = (
    *("min_separation", "passive_safety.min_separation", "clearance.min_clearance"),
    *("corridor.min_margin", "passive_safety.clearance.min_clearance"),
)

FalseClaim = tuple[str, float, float, str]
"""Name of a field, the value that a file claims, the value found anew, and the unit."""


@dataclass(frozen=True, eq=False)
class Rechecked:
    """A plan as found anew from its controls, and what is wrong with it."""

    plan: Plan  # found anew, but for the lower bound on the fuel and its proof
    safe: bool  # whether craft stay apart and inside corridors, as far as asked or claimed
    faults: tuple[str, ...]  # what is wrong with it, in sentences; empty where it is solved


def recheck(claimed: Plan) -> Rechecked:
    """Fly a plan's controls from its scenario's initial states and certify the outcome.

    InputError for controls too large for numbers, and for claims that no planner can be asked for.
    """
    problem, said = claimed.scenario.problem, claimed.certificate
    most = float(np.abs(claimed.controls).max())
    if not most * problem.duration**2 <= FURTHEST:  # arithmetic has no meaning there
        raise InputError(
            f"the controls reach {most:.3g} m/s², which leads beyond "
            f"{FURTHEST:g} m; expected the accelerations of a relative transfer, in m/s²."
        )
    bound = said.fuel_lower_bound, said.fuel_lower_bound_proof
    share = said.largest_share.bound if said.largest_share else 0.0
    made = Made(claimed.controls, *bound, claimed.convex_solves, least_share=share)
    asked = claimed.scenario, made, claimed.requirements
    flown = planned(claimed.planner, *asked, as_flown=claimed.as_flown)
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
    unsafe = violations(flown).keys() & {"separation", "passive safety", "corridor"}
    if said.risk is not None:
        refuse_risk([claimed.scenario], closed_loop=said.risk.feedback is not None)
        # By the errors that the file says.
        found = replace(found, risk=said.risk.judge(flown.states, flown.controls, problem))
    if said.smallest_burn and found.smallest_burn:  # what the planner says of a plan without it
        without = said.smallest_burn.fuel_without
        found = replace(found, smallest_burn=replace(found.smallest_burn, fuel_without=without))
    faults += [
        f"The file claims {name} {theirs:.6g}{unit.removesuffix(' at most')}, its controls give "
        f"{ours:.6g}{unit}"
        for name, theirs, ours, unit in _false_claims(said, found, problem)
    ]
    plan = replace(flown, certificate=found, timing=claimed.timing, message=claimed.message)
    return Rechecked(plan, not unsafe, tuple(fault.rstrip(".") + "." for fault in faults))


def _false_claims(said: Certificate, found: Certificate, problem: Problem) -> Iterator[FalseClaim]:
    """Fields claimed larger than the controls give, or NaN, with both values and the unit."""
    yield from _false_spending(said, found)
    yield from _false_separations(said, found)
    yield from _false_of_thrust(said, found)
    if not said.fuel_lower_bound <= found.fuel * (1 + RELATIVE) + problem.negligible_fuel:
        yield "fuel_lower_bound", said.fuel_lower_bound, found.fuel, " m/s² at most"
    if said.risk and found.risk and not found.risk.bound <= said.risk.bound * (1 + SAME) + FAR:
        yield "risk.bound", said.risk.bound, found.risk.bound, ""


def _false_spending(said: Certificate, found: Certificate) -> Iterator[FalseClaim]:
    """Fuel, Δv of the swarm and of each craft, and the count of collisions at nodes."""
    for name, unit in (("fuel", " m/s²"), ("delta_v", " m/s"), ("node_collisions", "")):
        theirs, ours = getattr(said, name), getattr(found, name)
        if not abs(theirs - ours) <= RELATIVE * abs(ours):
            yield name, theirs, ours, unit
    for name in ("craft_delta_v", "craft_delta_v_2norm", "craft_delta_v_thrusters"):
        both = zip(getattr(said, name), getattr(found, name), strict=False)
        for k, (theirs, ours) in enumerate(both):
            if not abs(theirs - ours) <= RELATIVE * found.delta_v:
                yield f"{name}[{k}]", theirs, ours, " m/s"
                break


def _false_separations(said: Certificate, found: Certificate) -> Iterator[FalseClaim]:
    """The least separations, in flight and after a loss of thrust, and the bounds below them."""
    for name in (part for least in DISTANCES for part in (least, f"{least}_bound")):
        both: tuple[Any, Any] = said, found
        for part in name.split("."):
            both = getattr(both[0], part, None), getattr(both[1], part, None)
        theirs, ours = both
        if theirs is not None and ours is not None and not theirs <= ours + 2 * TOLERANCE:
            yield name, theirs, ours, " m"


def _false_of_thrust(said: Certificate, found: Certificate) -> Iterator[FalseClaim]:
    """The largest share that a craft burns and no plan is below, and the smallest burn."""
    if (share := found.largest_share) is not None:
        theirs = said.largest_share
        if theirs is None or not abs(theirs.share - share.share) <= RELATIVE * share.share:
            yield "largest_share.share", theirs.share if theirs else nan, share.share, ""
        elif theirs.craft != share.craft:
            yield "largest_share.craft", theirs.craft, share.craft, ""
        elif not theirs.bound <= share.share * (1 + RELATIVE):
            yield "largest_share.bound", theirs.bound, share.share, " at most"
    if (burn := found.smallest_burn) is not None:
        claim, least = said.smallest_burn, burn.least or 0.0
        if claim is None or not abs((claim.least or 0.0) - least) <= RELATIVE * least:
            yield "smallest_burn.least", claim.least or 0.0 if claim else nan, least, " m/s"
        elif claim.asked != burn.asked:
            yield "smallest_burn.asked", claim.asked, burn.asked, " m/s"
