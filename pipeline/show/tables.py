"""The verdict and the tables of a plan's page, as text."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

from pipeline.figures.labels import MISSING, error, number
from pipeline.orbit.corridors import Corridor
from pipeline.orbit.reference import R_EARTH, radius_at
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.orbit.thrust import COMPONENTS, NORM, Windows
from pipeline.plan.certificate import Certificate, Clearance, CorridorMargin
from pipeline.plan.plan import SOLVED, WITHOUT_GAP, Plan
from pipeline.plan.recheck import Rechecked
from pipeline.scenario import Scenario
from pipeline.scenario.spacecraft import Spacecraft

TableRows = Iterator[tuple[str, str]]  # labels, and values with their units


@dataclass(frozen=True)
class Verdict:
    """The verdict at the top of a page."""

    good: bool  # whether the plan is safe and nothing is wrong with it
    headline: str  # the verdict in few words
    reasons: tuple[str, ...]  # in sentences


def verdict(shown: Rechecked, claimed_status: str) -> Verdict:
    """Whether a plan is safe; which craft come closest, when, and what is proven."""
    found, problem = shown.plan.certificate, shown.plan.scenario.problem
    reasons = list(shown.faults)
    at_nodes = shown.plan.requirements.at_nodes
    clear = found.clearance
    if clear is not None and shown.safe:
        if at_nodes:
            reasons.append("The plan was asked to keep craft apart at the nodes only.")
        other = clear.other if isinstance(clear.other, str) else f"craft {clear.other}"
        reasons.append(
            f"Craft {clear.craft} and {other} come closest by their sizes: at {clear.time:.1f} s "
            f"they are {clear.min_clearance:.4f} m further apart than their sizes ask for. Proven: "
            f"never by less than {_down(clear.min_clearance_bound)} m."
        )
    elif found.min_separation_pair and found.min_separation_bound is not None and shown.safe:
        i, j = found.min_separation_pair
        if at_nodes:
            reasons.append(
                "The plan was asked to keep craft apart at the nodes only: there no pair is within "
                "r_col."
            )
        reasons.append(
            f"Craft {i} and {j} come closest, {found.min_separation:.4f} m at "
            f"{found.min_separation_time:.1f} s. Proven: no two craft are ever closer than "
            f"{_down(found.min_separation_bound)} m; r_col is {problem.collision_radius:g} m."
        )
    headline = "Unsafe" if not shown.safe else "Safe at the nodes" if at_nodes else "Safe"
    if shown.safe and shown.faults:
        headline = "Not as claimed" if claimed_status == SOLVED else claimed_status.capitalize()
    elif shown.safe and found.min_separation_pair is None and clear is None:
        headline, reasons = "Reaches its goal", ["There is no other craft to stay clear of."]
    if shown.safe and (inside := found.corridor) is not None:
        reasons.append(
            f"Craft {inside.craft} comes closest to a side of its corridor: at {inside.time:.1f} s "
            f"it is {inside.min_margin:.4f} m inside of it. Proven: never by less than "
            f"{_down(inside.min_margin_bound)} m."
        )
    return Verdict(shown.safe and not shown.faults, headline, tuple(reasons))


def certificate_rows(plan: Plan, status: str) -> TableRows:
    """The certificate."""
    found, thrust = plan.certificate, plan.scenario.problem.thrust
    fuel = f"Fuel, {thrust.total}" + " (Eq. 4)" * (thrust.model == COMPONENTS)
    gap = f"at most {100 * found.optimality_gap:z.2f} %"
    if WITHOUT_GAP & {status, plan.status}:
        gap = MISSING
    elif not math.isfinite(found.optimality_gap):
        gap = "unknown: the bound is no more than rounding"
    elif found.optimality_gap < 0:
        gap = "none: all plans that are as required burn more"
    yield "It holds for", _motion(plan)
    yield fuel, f"{found.fuel:.6g} m/s²"
    yield "Δv of all craft, fuel times time step", f"{found.delta_v:.6g} m/s"
    yield "Lower bound on fuel (from the file)", f"{found.fuel_lower_bound:.6g} m/s²"
    yield "Gap to that bound", gap
    yield "How the bound is proven", found.fuel_lower_bound_proof or MISSING
    yield from _thrust_rows(found)
    yield from _separation_rows(found)
    yield from _clearance_rows("Least clearance by sizes", found.clearance)
    yield from _corridor_rows(found.corridor)
    yield from _risk_rows(found)
    yield from _passive_safety_rows(found)
    yield "Goal missed by, position", f"{error(found.goal_error)} m"
    yield "Goal missed by, velocity", f"{error(found.goal_velocity_error)} m/s"
    if found.waypoint_error is not None:
        yield "Waypoints missed by, position", f"{error(found.waypoint_error)} m"
    if found.waypoint_velocity_error is not None:
        yield "Waypoints missed by, velocity", f"{error(found.waypoint_velocity_error)} m/s"
    yield "Dynamics violated by, at most", f"{error(found.dynamics_error)} m"


def _motion(plan: Plan) -> str:
    if plan.as_flown:
        return "nonlinear motion about the reference orbit"
    circle = plan.scenario.problem.orbit is None
    return "linear motion about a circle" if circle else "linear motion about the reference orbit"


def motion(plan: Plan) -> str:
    """The motion drawn, as text; for a plan as flown, linear motion between the flight's nodes."""
    if plan.scenario.problem.orbit is None:
        return "the exact solution of the Clohessy-Wiltshire equations"
    start = ", from where the flight has craft at each node," * plan.as_flown
    return f"the solution of the linear equations about the reference orbit{start}"


def _thrust_rows(found: Certificate) -> TableRows:
    """The largest share of its Δv that a craft burns, and the smallest burn, if asked for."""
    if (share := found.largest_share) is not None:
        most = f"{share.share:.3%}, of craft {share.craft}"
        yield "Largest share of its Δv that a craft burns", most
        yield "In no plan is it less than, by the file", f"{share.bound:.3%}"
    if (burn := found.smallest_burn) is not None:
        least = "no burn" if burn.least is None else f"{1e3 * burn.least:.6g} mm/s"
        yield "Smallest burn", f"{least}; asked for {1e3 * burn.asked:g} mm/s"
        bare = MISSING if burn.fuel_without is None else f"{burn.fuel_without:.6g} m/s²"
        yield "Fuel without a smallest burn, by the file", bare


def _separation_rows(found: Certificate) -> TableRows:
    if found.min_separation_pair is None or found.min_separation_bound is None:
        yield "Least separation", "one craft, no pair"
        return
    i, j = found.min_separation_pair
    yield "Least separation at any time", f"{found.min_separation:.4f} m"
    yield "Between", f"craft {i} and {j}"
    yield "When", f"{found.min_separation_time:.1f} s"
    yield "Proven: no pair is ever closer than", f"{_down(found.min_separation_bound)} m"
    yield "Pairs and nodes within r_col (Eq. 5)", str(found.node_collisions)


def _clearance_rows(label: str, clear: Clearance | None) -> TableRows:
    """The least distance of participants beyond what their sizes ask for, where these differ."""
    if clear is not None:
        other = clear.other if isinstance(clear.other, str) else f"craft {clear.other}"
        lost = "" if clear.node is None else f", adrift from node {clear.node},"
        yield label, f"{clear.min_clearance:.4f} m"
        yield "Between", f"craft {clear.craft}{lost} and {other}, at {clear.time:.1f} s"
        yield "Proven: never less than", f"{_down(clear.min_clearance_bound)} m"


def _corridor_rows(inside: CorridorMargin | None) -> TableRows:
    if inside is not None:
        yield "Least distance inside of a corridor", f"{inside.min_margin:.4f} m"
        yield "Of", f"craft {inside.craft} in corridor {inside.corridor}, at {inside.time:.1f} s"
        yield "Proven: never less than", f"{_down(inside.min_margin_bound)} m"


def _risk_rows(found: Certificate) -> TableRows:
    """The risk, if it was limited, and the errors that it refers to."""
    risk = found.risk
    if risk is None:
        return
    errors = risk.uncertainty
    sigmas = (
        f"position {errors.position:g} m, velocity {errors.velocity:.3g} m/s, thrust "
        f"{errors.magnitude:.3g} in size and {errors.direction:g} rad"
    )
    if errors.position_bias or errors.velocity_bias:
        sigmas += f"; biases {errors.position_bias:g} m, {errors.velocity_bias:.3g} m/s"
    if errors.magnitude_fixed or errors.direction_fixed:
        fixed = max(errors.magnitude_fixed, errors.direction_fixed)
        sigmas += f"; {fixed:.3g} m/s of any burn"
    without = MISSING if risk.fuel_without is None else f"{risk.fuel_without:.6g} m/s²"
    feedback, how = risk.feedback, "in open loop" if risk.feedback is None else "with feedback"
    yield f"Risk of a pair within r_col {how}, at most", f"{risk.bound:.3g}"
    if feedback is not None:
        yield "Part of it: corrections beyond the thrust limit", f"{feedback.saturation:.3g}"
        yield "Mean Δv of corrections, Σ‖u‖₁Δt", f"{feedback.delta_v:.6g} m/s"
    yield "Asked for", f"{risk.asked:g}"
    yield "Standard deviations of errors", sigmas
    yield "Fuel without a limit on risk", without


def _passive_safety_rows(found: Certificate) -> TableRows:
    drifting = found.passive_safety
    if drifting is None:
        return
    if drifting.pair is not None and drifting.min_separation_bound is not None:
        (i, j), orbits = drifting.pair, f"{drifting.orbits:g} orbit{'s' * (drifting.orbits != 1)}"
        least = f"{drifting.min_separation:.4f} m"
        yield f"Least separation after a loss of thrust, {orbits}", least
        yield "Between", f"craft {i}, adrift from node {drifting.node}, and {j}"
        yield "When", f"{drifting.time:.1f} s"
        bound = _down(drifting.min_separation_bound)
        yield "Proven: no craft adrift is ever closer than", f"{bound} m"
    yield from _clearance_rows("Least clearance after a loss of thrust", drifting.clearance)


def scenario_rows(scenario: Scenario) -> TableRows:
    """The scenario."""
    problem = scenario.problem
    steps = f"{problem.intervals} intervals of {problem.time_step:g} s"
    limit = _milli(problem.max_acceleration, "mm/s²", "none")
    eccentricity = 0.0 if problem.orbit is None else problem.orbit.eccentricity
    altitude = radius_at(problem.mean_motion) * (1 - eccentricity) - R_EARTH
    lowest = "at perigee " if eccentricity else ""
    about = f", {lowest}{number(altitude / 1000)} km above the Earth" if altitude > 0 else ""
    yield "Craft", str(scenario.n)
    yield "Transfer", f"{problem.duration:g} s in {steps}"
    yield "Collision radius r_col", f"{problem.collision_radius:g} m"
    yield "Limit on each component of thrust", limit
    yield from _limit_rows(scenario)
    yield "Mean motion of the reference orbit", f"{problem.mean_motion:.6g} rad/s"
    yield "Its period", f"{2 * math.pi / problem.mean_motion / 60:.1f} min{about}"
    yield from _orbit_rows(problem.orbit)
    if scenario.sized:
        yield "Radii of craft", f"{', '.join(f'{one:g}' for one in scenario.radii)} m"
    for obstacle in scenario.obstacles:
        yield "Keep clear of", f"{obstacle}, {'held' if obstacle.hold else 'drifts'}"
    for k, one in enumerate(scenario.corridors):
        yield f"Corridor {k}", _corridor(one)


def _corridor(one: Corridor) -> str:
    who = f"craft {', '.join(map(str, one.craft))}" if one.craft else "all craft"
    return f"{one.inside}, {who}, {one.begin:g} to {one.end:g} s"


def _limit_rows(scenario: Scenario) -> TableRows:
    """What the scenario says of thrust beyond a limit on its components."""
    thrust, kind = scenario.problem.thrust, ""
    if thrust.model != COMPONENTS:
        kind = "one that is pointed" if thrust.model == NORM else f"{len(thrust.model)} directions"
    fair = thrust.objective == "fair"
    rows = [
        ("Thrusters", kind),
        ("Limit on the norm of thrust", _milli(thrust.max_acceleration_norm, "mm/s²")),
        ("Minimum impulse bit", _milli(thrust.min_delta_v, "mm/s")),
        ("No craft burns", _windows(thrust.no_burn)),
        ("Minimized", "the largest share that a craft burns of its Δv" if fair else ""),
        *((f"Craft {k} of its own", _own(one)) for k, one in enumerate(scenario.craft)),
    ]
    yield from (row for row in rows if row[1])


def _milli(value: float | None, unit: str, other: str = "") -> str:
    """A value in thousandths of its SI unit, or another text where there is none."""
    return other if value is None else f"{1000 * value:g} {unit}"


def _own(craft: Spacecraft) -> str:
    limits = (
        (craft.max_acceleration, 1e3, "mm/s² a component"),
        (craft.max_acceleration_norm, 1e3, "mm/s² in norm"),
        (craft.delta_v, 1.0, "m/s in all"),
    )
    said = [f"{scale * one:g} {unit}" for one, scale, unit in limits if one is not None]
    return "; ".join(said + [f"no burns {_windows(craft.no_burn)}"] * bool(craft.no_burn))


def _windows(no_burn: Windows) -> str:
    return ", ".join(f"{begin:g} to {end:g} s" for begin, end in no_burn)


def _orbit_rows(orbit: ReferenceOrbit | None) -> TableRows:
    if orbit is not None:
        shape = f"{orbit.eccentricity:g}, {orbit.inclination_deg:g}°"
        yield "Osculating eccentricity and inclination", shape
        drag = "" if orbit.ballistic is None else f", drag of {orbit.ballistic:g} m²/kg"
        yield "Forces", f"{'an oblate Earth (J2)' if orbit.j2 else 'two bodies'}{drag}"


def planner_rows(plan: Plan, claimed_status: str) -> TableRows:
    """What the file says of the planner and its run."""
    yield "Planner", plan.planner
    yield "Status in the file", claimed_status
    yield "Joint convex programs", str(plan.convex_solves)
    if "plan" in plan.timing:
        yield "Time from scenario to controls", f"{number(1000 * plan.timing['plan'])} ms"


def _down(bound: float) -> str:
    """A proven bound with four decimals, never rounded up."""
    return f"{math.floor(bound * 1e4) / 1e4:.4f}"
