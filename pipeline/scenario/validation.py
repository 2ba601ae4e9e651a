"""Validation of a scenario by rules: each fault with its size, or that there is none."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from pipeline.errors import InputError, check_kind
from pipeline.orbit.approaches import close_approaches
from pipeline.orbit.arrays import Formation
from pipeline.orbit.dynamics import model_error
from pipeline.orbit.participants import Participants, at_the_end
from pipeline.orbit.partition import SwarmPartition, swarm_partition
from pipeline.orbit.problem import Problem
from pipeline.orbit.rings import energy_mismatch, secular_drift
from pipeline.orbit.separation import least_separations
from pipeline.orbit.transfer import free_drift
from pipeline.scenario.diagnostic import Case, Diagnostic, diagnostic_of
from pipeline.scenario.reach import reachable
from pipeline.scenario.scenario import Scenario
from pipeline.scenario.waypoint import closest_pair

VY_STEP = 1e-3  # m/s; change of vy for the derivative of the drift
ENERGY_TOLERANCE = 1e-5  # of |ẏ + 2e x|, m/s: about 0.2 m of drift an orbit
APART, MATCHED, INSIDE = "craft apart", "energy-matched", "inside corridors"
PASSIVE, LINEAR = "passively safe", "linear model"
WAYPOINTS = "waypoints apart"
# What to do where craft drift and are meant to
DRIFTING = (
    'say "ends": "any" where craft are meant to drift, or allow it for a plan (--allow-drift, in '
    "Python allow_drift=True)"
)


def diagnostics(scenario: Scenario) -> list[Diagnostic]:
    """The outcome of every rule: all that is wrong with a scenario, and what is fine."""
    check_kind("scenario", scenario, Scenario)
    matched = partial(_energy_matching, meant=scenario.ends == "any")
    rules = (partial(_separation, scenario), matched, partial(_passive_safety, scenario))
    found = [rule(*end) for end in _ends(scenario) for rule in rules]
    inside = [_inside_corridors(scenario)] if scenario.corridors else []
    on_the_way = [*_waypoint_separation(scenario), reachable(scenario), _linear_model(scenario)]
    return [*found, *inside, *on_the_way]


def _inside_corridors(scenario: Scenario) -> Diagnostic:
    """Whether craft are inside their corridors at both ends, where they have to be."""
    cases = [
        Case(
            (craft,),
            f"{end}[{craft}] is {-margin:.6g} m outside corridors[{corridor}], "
            f"{scenario.corridors[corridor].inside}",
            {"margin": margin},
        )
        for end, craft, corridor, margin in sorted(scenario.outside(), key=lambda one: one[3])
    ]
    wrong = "ends outside of corridors that count then"
    cure = "move them, widen the corridor or let it begin later or end earlier"
    fine = "both ends are inside of their corridors; plan proves whether craft can stay inside"
    return diagnostic_of(INSIDE, "transfer", cases, wrong, cure, fine)


def _ends(scenario: Scenario) -> Iterator[tuple[str, Formation, Problem]]:
    """Name and states of each end, and the problem with its reference orbit at that time."""
    problem = scenario.problem
    yield "initial", scenario.initial, problem
    yield "goal", scenario.goal, problem.starting_at(problem.intervals)


def check(scenario: Scenario, *, allow_drift: bool = False) -> None:
    """Refuse formations that no transfer can start from or end in safely.

    InputError where a pair is within the collision radius at either end or, unless ``allow_drift``
    or the scenario's ends are any, a state is not energy-matched (Eq. 3).
    """
    check_kind("scenario", scenario, Scenario)
    check_kind("allow_drift", allow_drift, bool)
    allow_drift = allow_drift or scenario.ends == "any"
    for end, states, problem in _ends(scenario):
        close = _separation(scenario, end, states, problem)
        for case in close.cases:
            required = _required_separation(scenario)
            if scenario.sized:
                required = f"their sizes: {scenario.required_separation(*case.craft)}"
            raise InputError(
                f"{case.text}; expected every pair further apart than {required}: {close.cure}."
            )
        for case in () if allow_drift else _energy_matching(end, states, problem).cases:
            within = f"{ENERGY_TOLERANCE:g} m/s"
            if problem.orbit is not None:
                within = f"{_drift_tolerance(problem):.2g} m"
            raise InputError(
                f"{case.text}; expected 0 within {within} (energy matching): "
                f"set vy to {case.numbers['vy_wanted']:.9g}, or {DRIFTING}."
            )


def drifts(scenario: Scenario) -> bool:
    """Whether a craft drifts at either end by more than energy matching allows."""
    return not all(_energy_matching(*end).fine for end in _ends(scenario))


def _drift_tolerance(problem: Problem) -> float:
    """Along-track drift in an orbit that goes with the tolerance, m."""
    return 6 * np.pi / problem.mean_motion * ENERGY_TOLERANCE


def _swarm_at(scenario: Scenario, end: str, problem: Problem) -> SwarmPartition:
    """Craft and obstacles as they are at an end, for motion from there on."""
    if not scenario.sized:
        return swarm_partition((scenario.n,))
    obstacles = scenario.obstacles
    if end == "goal":
        obstacles = tuple(at_the_end(obstacles, scenario.problem))
    problem = replace(problem, collision_radius=scenario.problem.collision_radius)
    return Participants(problem, [scenario.radii], [obstacles])


def _required_separation(scenario: Scenario) -> str:
    """The separation that pairs must exceed, in words."""
    radius = scenario.problem.collision_radius
    return "what their sizes ask for" if scenario.sized else f"collision_radius, {radius:g} m"


def _size_remedy(scenario: Scenario) -> str:
    """What to do to sizes where participants are too close, in words."""
    return "make them smaller" if scenario.sized else "lower collision_radius"


def _separation(scenario: Scenario, end: str, states: Formation, problem: Problem) -> Diagnostic:
    """Whether every pair is further apart than the collision radius at this end."""
    swarms = _swarm_at(scenario, end, problem)
    there, (i, j) = swarms.all_states(states[:, None], slice(0, 1))[..., :3], swarms.pairs
    distance = np.linalg.norm(there[i, 0] - there[j, 0], axis=1)
    separations = swarms.separations(there, there, i, j)
    close = np.flatnonzero(separations <= problem.collision_radius)
    cases = [
        Case(
            (int(i[k]), int(j[k])),
            f"{_pair_at(scenario, end, int(i[k]), int(j[k]))} are {distance[k]:.6g} m apart",
            {"distance": float(distance[k])},
        )
        for k in close[distance[close].argsort(kind="stable")]
    ]
    wrong = f"pairs within {_required_separation(scenario)}"
    cure = f"move one of them or {_size_remedy(scenario)}"
    fine = "one craft alone"
    if len(distance) > 0:
        k = int(separations.argmin())
        pair = scenario.named(int(i[k]), int(j[k]))
        fine = f"the closest, {pair}, are {distance[k]:.4g} m apart"
    return diagnostic_of(APART, end, cases, wrong, cure, fine)


def _pair_at(scenario: Scenario, end: str, i: int, j: int) -> str:
    """Two participants at an end, in words."""
    other = f"{end}[{j}]" if j < scenario.n else scenario.obstacles[j - scenario.n].name
    return f"{end}[{i}] and {other}"


def _energy_matching(
    end: str, states: Formation, problem: Problem, *, meant: bool = False
) -> Diagnostic:
    """Whether no craft drifts along-track: by Eq. 3, or about an orbit by its secular rates.

    By Eq. 3 a craft drifts at -3 (ẏ + 2e x), over an orbit by -6π/e times the mismatch ẏ + 2e x.
    Where drift is ``meant`` it is no fault.
    """
    e, columns = problem.mean_motion, {}
    if problem.orbit is None:
        mismatch = energy_mismatch(states, e)
        drift, vy = -6 * np.pi / e * mismatch, 0.0 - 2 * e * states[:, 0]
        columns = {"mismatch": mismatch}
        why = [f": vy + 2·mean_motion·x is {one:.3g} m/s, and 0" for one in mismatch]
    else:
        shifted = states + VY_STEP * np.eye(6)[4]
        drift, more = np.split(secular_drift(np.concatenate([states, shifted]), problem), 2)
        vy = states[:, 4] - VY_STEP * drift / (more - drift)
        why = [", and not"] * len(states)
    columns |= {"drift_per_orbit": drift, "vy_wanted": vy}
    size, allowed = np.abs(drift), _drift_tolerance(problem)
    if meant and size.max() > allowed:
        text = f"craft drift, as they may, by up to {size.max():.4g} m an orbit"
        return Diagnostic(MATCHED, end, text)
    cases = [
        Case(
            (int(k),),
            f"{end}[{k}] drifts {drift[k]:+.4g} m along-track an orbit{why[k]} with a vy of "
            f"{vy[k]:.9g}",
            {name: float(column[k]) for name, column in columns.items()},
        )
        for k in size.argsort(kind="stable")[::-1]
        if size[k] > allowed
    ]
    wrong = f"craft that drift along-track by more than {allowed:.2g} m an orbit"
    cure = f"give them that vy, or {DRIFTING}"
    fine = f"no craft drifts along-track by more than {size.max():.3f} m an orbit"
    return diagnostic_of(MATCHED, end, cases, wrong, cure, fine)


def _passive_safety(
    scenario: Scenario, end: str, states: Formation, problem: Problem
) -> Diagnostic:
    """Whether every pair stays further apart than the collision radius in an orbit of drift."""
    drift, radius = free_drift(states, problem), problem.collision_radius
    swarms = _swarm_at(scenario, end, drift[2])
    found = close_approaches(*drift, within=radius, swarms=swarms)
    time = found.times(drift[2])
    # Of the passes of each pair the closest, and of those that are equally close the first.
    order = np.lexsort((time, np.round(found.distance, 3), found.second, found.first))
    both = np.stack([found.first, found.second])[:, order]
    order = order[np.unique(both, axis=1, return_index=True)[1]]
    orbit = 2 * np.pi / problem.mean_motion
    cases = []
    for k in order[found.distance[order].argsort(kind="stable")].tolist():
        i, j, distance = int(found.first[k]), int(found.second[k]), float(found.distance[k])
        near = (
            f"{radius - distance:.4g} m too close" if scenario.sized else f"within {distance:.4g} m"
        )
        at = f"{time[k]:.0f} s, {time[k] / orbit:.2f} orbits"
        text = f"{_pair_at(scenario, end, i, j)} come {near} at {at}"
        cases.append(Case((i, j), text, {"distance": distance, "time": float(time[k])}))
    if cases:
        wrong = f"pairs within {_required_separation(scenario)}, in an orbit of free drift"
        cure = f"change orbits or {_size_remedy(scenario)}"
        return diagnostic_of(PASSIVE, end, cases, wrong, cure, "")
    (least,) = least_separations(*drift, swarms)
    if least.pair is None:
        return Diagnostic(PASSIVE, end, "one craft alone")
    near = f"{least.distance:.4g} m"
    if scenario.sized:
        near = f"{least.distance - radius:.4g} m further apart than their sizes ask for,"
    text = (
        f"in an orbit of free drift no pair is closer than {scenario.named(*least.pair)}, "
        f"{near} at {least.time:.0f} s"
    )
    return Diagnostic(PASSIVE, end, text)


def _waypoint_separation(scenario: Scenario) -> Iterator[Diagnostic]:
    """Whether craft that must pass places at one time are apart there."""
    closest = closest_pair(scenario.waypoints, scenario.problem, scenario.radii)
    if closest is None:
        return
    distance, i, j, time = closest
    text = f"craft {i} and {j} must be {distance:.4g} m apart at {time:g} s, the closest of all"
    if distance > scenario.radii[[i, j]].sum():
        yield Diagnostic(WAYPOINTS, "transfer", text)
        return
    case = Case((i, j), f"that is within {_required_separation(scenario)}", {"distance": distance})
    cure = "move one of them, or give them other times"
    yield Diagnostic(WAYPOINTS, "transfer", text, (case,), cure)


def _linear_model(scenario: Scenario) -> Diagnostic:
    """Whether the linear model is off by less than the collision radius."""
    problem = scenario.problem
    places = [scenario.initial, scenario.goal, *(one.state for one in scenario.waypoints)]
    found = model_error(np.vstack(places), problem.dynamics, problem.duration)
    earth = "about an oblate Earth" if problem.orbit is None else "outside the linear model"
    off = f"{earth} craft end some {found.total:.2g} m off their goals"
    if found.total <= problem.collision_radius:
        return Diagnostic(LINEAR, "transfer", off)
    turns = problem.mean_motion * problem.duration / (2 * np.pi)
    text = (
        f"{found.curvature:.2g} m since craft are up to {found.reach:.3g} m from the origin, "
        f"{found.oblateness:.2g} m by J2 over {turns:.3g} orbits"
    )
    nearer = "stay nearer to the origin, or take less time"
    cure = f"plan as flown (--world, in Python world=True), {nearer}"
    cases = (Case((), text, vars(found)),)
    return Diagnostic(LINEAR, "transfer", f"{off}: more than collision_radius", cases, cure)
