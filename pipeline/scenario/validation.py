"""Validation of a scenario by rules: each fault with its size, or that there is none."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from math import ceil, floor, log10

import numpy as np

from pipeline.errors import InputError, check_kind
from pipeline.orbit.approaches import SwarmPartition, close_approaches, side_by_side
from pipeline.orbit.arrays import AnyState, Formation
from pipeline.orbit.decoupled import least_limits
from pipeline.orbit.dynamics import ModelError, model_error
from pipeline.orbit.participants import Participants, at_the_end
from pipeline.orbit.problem import Problem
from pipeline.orbit.rings import energy_mismatch, secular_drift
from pipeline.orbit.separation import least_separations
from pipeline.orbit.thrust import Limits
from pipeline.orbit.transfer import free_drift
from pipeline.scenario.scenario import Scenario
from pipeline.scenario.thrust_needs import MARGIN, most_strained, needs_of, shortfalls
from pipeline.scenario.waypoint import closest_pair

FASTER = 1e-3  # m/s; change of vy for the derivative of the drift
ENERGY_TOLERANCE = 1e-5  # of |ẏ + 2e x|, m/s: about 0.2 m of drift an orbit
APART, MATCHED, INSIDE = "craft apart", "energy-matched", "inside corridors"
PASSIVE, REACHABLE, LINEAR = "passively safe", "within reach", "linear model"  # the rules
WAYPOINTS = "waypoints apart"
# What to do where craft drift and are meant to
DRIFTING = (
    'say "ends": "any" where craft are meant to drift, or allow it for a plan (--allow-drift, in '
    "Python allow_drift=True)"
)


@dataclass(frozen=True)
class Case:
    """One fault."""

    craft: tuple[int, ...]  # whose it is
    text: str  # what is wrong, and by how much
    numbers: Mapping[str, float] = field(default_factory=dict)  # what the text says, in SI units


@dataclass(frozen=True)
class Diagnostic:
    """Outcome of a rule at one end, or for the transfer."""

    rule: str  # what was looked at
    end: str  # "initial", "goal" or "transfer"
    text: str  # what was found, in words
    cases: tuple[Case, ...] = ()  # faults, worst first; none where all is well
    cure: str = ""  # what to do about them

    @property
    def fine(self) -> bool:
        """Whether nothing is wrong."""
        return not self.cases

    def __str__(self) -> str:
        lines = [f"{self.end}, {self.rule}: {'fine' if self.fine else 'WRONG'}: {self.text}"]
        lines += [f"    {case.text}" for case in self.cases]
        return "\n".join(lines + [f"    to mend it, {self.cure}"] * bool(self.cure))


def diagnostics(scenario: Scenario) -> list[Diagnostic]:
    """The outcome of every rule: all that is wrong with a scenario, and what is fine."""
    check_kind("scenario", scenario, Scenario)
    rules = (partial(_apart, scenario), _matched, partial(_passive, scenario))
    found = [rule(*end) for end in _ends(scenario) for rule in rules]
    if scenario.ends == "any":
        found = [_meant(one) for one in found]
    inside = [_inside(scenario)] if scenario.corridors else []
    return [*found, *inside, *_waypoints(scenario), _reachable(scenario), _linear(scenario)]


def _inside(scenario: Scenario) -> Diagnostic:
    """Whether craft are inside their corridors at both ends, where they have to be."""
    cases = tuple(
        Case(
            (craft,),
            f"{end}[{craft}] is {-margin:.6g} m outside corridors[{corridor}], "
            f"{scenario.corridors[corridor].inside}",
            {"margin": margin},
        )
        for end, craft, corridor, margin in sorted(scenario.outside(), key=lambda one: one[3])
    )
    if not cases:
        return Diagnostic(INSIDE, "transfer", "both ends are inside of their corridors")
    text = f"ends outside of corridors that count then: {len(cases)}"
    cure = "move them, widen the corridor or let it begin later or end earlier"
    return Diagnostic(INSIDE, "transfer", text, cases, cure)


def _meant(found: Diagnostic) -> Diagnostic:
    """The outcome without faults where craft are meant to drift."""
    if found.rule != MATCHED or found.fine:
        return found
    most = max(abs(case.numbers["drift_per_orbit"]) for case in found.cases)
    return Diagnostic(
        MATCHED, found.end, f"craft drift, as they may, by up to {most:.4g} m an orbit"
    )


def _ends(scenario: Scenario) -> Iterator[tuple[str, Formation, Problem]]:
    """Name and states of both ends, and the problem with its reference where it is then."""
    problem = scenario.problem
    yield "initial", scenario.initial, problem
    yield "goal", scenario.goal, problem.starting_at(problem.intervals)


def check(scenario: Scenario, *, allow_drift: bool = False) -> None:
    """Refuse formations that no transfer can start from or end in safely.

    InputError where a pair is within the collision radius at either end or, unless ``allow_drift``
    or the scenario's ends are any, a state is not energy-matched (Eq. 3).
    """
    check_kind("scenario", scenario, Scenario)
    allow_drift = allow_drift or scenario.ends == "any"
    for end, states, problem in _ends(scenario):
        close = _apart(scenario, end, states, problem)
        for case in close.cases:
            wanted = f"collision_radius, {problem.collision_radius:g} m"
            if scenario.sized:
                wanted = f"their sizes: {scenario.wanted(*case.craft)}"
            raise InputError(
                f"{case.text}; expected every pair further apart than {wanted}: {close.cure}."
            )
        for case in () if allow_drift else _matched(end, states, problem).cases:
            raise InputError(
                f"{case.text}; expected 0 within {_tolerance(problem)} (energy matching): "
                f"set vy to {case.numbers['vy_wanted']:.9g}, or {DRIFTING}."
            )


def drifts(scenario: Scenario) -> bool:
    """Whether a craft drifts at either end by more than energy matching allows."""
    return not all(_matched(*end).fine for end in _ends(scenario))


def _tolerance(problem: Problem) -> str:
    circle = problem.orbit is None
    return f"{ENERGY_TOLERANCE:g} m/s" if circle else f"{_most_drift(problem):.2g} m"


def _most_drift(problem: Problem) -> float:
    """Along-track drift in an orbit that goes with the tolerance, m."""
    return 6 * np.pi / problem.mean_motion * ENERGY_TOLERANCE


def _beside(scenario: Scenario, end: str, problem: Problem) -> SwarmPartition:
    """Craft and obstacles as they are at an end, for motion from there on."""
    if not scenario.sized:
        return side_by_side((scenario.n,))
    obstacles = scenario.obstacles
    if end == "goal":
        obstacles = tuple(at_the_end(obstacles, scenario.problem))
    problem = replace(problem, collision_radius=scenario.problem.collision_radius)
    return Participants(problem, [scenario.radii], [obstacles])


def _within(scenario: Scenario) -> str:
    """The distance within which a pair is too close, in words."""
    radius = scenario.problem.collision_radius
    return "what their sizes ask for" if scenario.sized else f"collision_radius, {radius:g} m"


def _smaller(scenario: Scenario) -> str:
    """What would allow participants to be so close, in words."""
    return "make them smaller" if scenario.sized else "lower collision_radius"


def _apart(scenario: Scenario, end: str, states: Formation, problem: Problem) -> Diagnostic:
    """Whether every pair is further apart than the collision radius at this end."""
    swarms = _beside(scenario, end, problem)
    there, (i, j) = swarms.beside(states[:, None], slice(0, 1))[..., :3], swarms.pairs
    distance = np.linalg.norm(there[i, 0] - there[j, 0], axis=1)
    apart = swarms.apart(there, there, i, j)
    close = np.flatnonzero(apart <= problem.collision_radius)
    cases = tuple(
        Case(
            (int(i[k]), int(j[k])),
            f"{_at(scenario, end, int(i[k]), int(j[k]))} are {distance[k]:.6g} m apart",
            {"distance": float(distance[k])},
        )
        for k in close[distance[close].argsort(kind="stable")]
    )
    if cases:
        text = f"pairs within {_within(scenario)}: {len(cases)}"
        return Diagnostic(APART, end, text, cases, f"move one of them or {_smaller(scenario)}")
    if len(distance) == 0:
        return Diagnostic(APART, end, "one craft alone")
    k = int(apart.argmin())
    text = f"the closest, {scenario.named(int(i[k]), int(j[k]))}, are {distance[k]:.4g} m apart"
    return Diagnostic(APART, end, text)


def _at(scenario: Scenario, end: str, i: int, j: int) -> str:
    """Two participants at an end, in words."""
    other = f"{end}[{j}]" if j < scenario.n else scenario.obstacles[j - scenario.n].name
    return f"{end}[{i}] and {other}"


def _matched(end: str, states: Formation, problem: Problem) -> Diagnostic:
    """Whether Eq. 3 holds, so that no craft drifts along-track.

    A craft that drifts does so by -3 (ẏ + 2e x), over an orbit by -6π/e times the mismatch.
    """
    if problem.orbit is not None:
        return _bounded(end, states, problem)
    e = problem.mean_motion
    mismatch = energy_mismatch(states, e)
    off = np.flatnonzero(np.abs(mismatch) > ENERGY_TOLERANCE)
    drift, wanted = -6 * np.pi / e * mismatch, 0.0 - 2 * e * states[:, 0]
    columns = {"mismatch": mismatch, "drift_per_orbit": drift, "vy_wanted": wanted}
    cases = tuple(
        Case(
            (int(k),),
            f"{end}[{k}] drifts {drift[k]:+.4g} m along-track an orbit: vy + 2·mean_motion·x is "
            f"{mismatch[k]:.3g} m/s, and 0 with a vy of {wanted[k]:.9g}",
            {name: float(column[k]) for name, column in columns.items()},
        )
        for k in off[np.abs(mismatch[off]).argsort(kind="stable")[::-1]]
    )
    if cases:
        text = f"craft that drift along-track: {len(cases)}"
        cure = f"give them that vy, or {DRIFTING}"
        return Diagnostic(MATCHED, end, text, cases, cure)
    text = f"no craft drifts by more than {np.abs(drift).max():.3f} m an orbit"
    return Diagnostic(MATCHED, end, text)


def _bounded(end: str, states: Formation, problem: Problem) -> Diagnostic:
    """Whether craft do not drift along-track about a reference orbit, by Kepler and J2."""
    faster = states + FASTER * np.eye(6)[4]
    drift, more = np.split(secular_drift(np.concatenate([states, faster]), problem), 2)
    wanted = states[:, 4] - FASTER * drift / (more - drift)
    cases = tuple(
        Case(
            (int(k),),
            f"{end}[{k}] drifts {drift[k]:+.4g} m along-track an orbit, and not with a vy of "
            f"{wanted[k]:.9g}",
            {"drift_per_orbit": float(drift[k]), "vy_wanted": float(wanted[k])},
        )
        for k in np.abs(drift).argsort(kind="stable")[::-1]
        if np.abs(drift[k]) > _most_drift(problem)
    )
    text = f"no craft drifts along-track by more than {np.abs(drift).max():.3f} m an orbit"
    if not cases:
        return Diagnostic(MATCHED, end, text)
    text = f"craft that drift by more than {_most_drift(problem):.2g} m an orbit: {len(cases)}"
    cure = f"give them that vy, or {DRIFTING}"
    return Diagnostic(MATCHED, end, text, cases, cure)


def _passive(scenario: Scenario, end: str, states: Formation, problem: Problem) -> Diagnostic:
    """Whether every pair stays further apart than the collision radius in an orbit of drift."""
    drift, radius = free_drift(states, problem), problem.collision_radius
    swarms = _beside(scenario, end, drift[2])
    found = close_approaches(*drift, within=radius, swarms=swarms)
    time = found.times(drift[2])
    # Of the passes of each pair the closest, and of those that are equally close the first.
    order = np.lexsort((time, np.round(found.distance, 3), found.second, found.first))
    both = np.stack([found.first, found.second])[:, order]
    order = order[np.unique(both, axis=1, return_index=True)[1]]
    orbit = 2 * np.pi / problem.mean_motion
    cases = tuple(
        Case(
            (int(found.first[k]), int(found.second[k])),
            f"{_at(scenario, end, int(found.first[k]), int(found.second[k]))} come "
            f"{_near(scenario, float(found.distance[k]))} at {time[k]:.0f} s, "
            f"{time[k] / orbit:.2f} orbits",
            {"distance": float(found.distance[k]), "time": float(time[k])},
        )
        for k in order[found.distance[order].argsort(kind="stable")]
    )
    if cases:
        text = f"pairs within {_within(scenario)}, in an orbit of free drift: {len(cases)}"
        return Diagnostic(PASSIVE, end, text, cases, f"change orbits or {_smaller(scenario)}")
    (least,) = least_separations(*drift, swarms)
    if least.pair is None:
        return Diagnostic(PASSIVE, end, "one craft alone")
    i, j = least.pair
    near = f"{least.distance:.4g} m"
    if scenario.sized:
        near = f"{least.distance - radius:.4g} m further apart than their sizes ask for,"
    text = (
        f"in an orbit of free drift no pair is closer than {scenario.named(i, j)}, "
        f"{near} at {least.time:.0f} s"
    )
    return Diagnostic(PASSIVE, end, text)


def _near(scenario: Scenario, distance: float) -> str:
    """How close a pair comes, in words."""
    if scenario.sized:
        return f"{scenario.problem.collision_radius - distance:.4g} m too close"
    return f"within {distance:.4g} m"


def _reachable(scenario: Scenario) -> Diagnostic:
    """Whether every craft on its own can make its transfer within the thrust limit."""
    if scenario.limits is not None:
        return _reachable_within(scenario, scenario.limits)
    limit = scenario.problem.max_acceleration
    least = least_limits(scenario.initial, scenario.goal, scenario.problem)
    most = int(least.argmax())
    if limit is None and np.isfinite(least).all():
        text = f"no max_acceleration; craft {most} needs the most, {least[most]:.4g} m/s²"
        return Diagnostic(REACHABLE, "transfer", text)
    limit = np.inf if limit is None else limit
    short = np.flatnonzero((least > limit) | np.isinf(least))
    worst = short[least[short].argsort(kind="stable")[::-1]].tolist()
    cases = tuple(_out_of_reach(k, float(least[k]), limit) for k in worst)
    if cases:
        given = f"max_acceleration, {limit:g} m/s²," if np.isfinite(limit) else "any thrust"
        text = f"craft that {given} is too little for: {len(cases)}"
        cure = "give more time by time_step or nodes"
        if np.isfinite(least[short]).any():
            cure = f"raise max_acceleration, or {cure}"
        return Diagnostic(REACHABLE, "transfer", text, cases, cure)
    text = f"craft {most} needs the most thrust, {least[most] / limit:.0%} of max_acceleration"
    return Diagnostic(REACHABLE, "transfer", text)


def _reachable_within(scenario: Scenario, limits: Limits) -> Diagnostic:
    """Whether each craft alone can reach its goal within all its thrust and Δv limits."""
    needs = needs_of(scenario, limits)
    found = list(shortfalls(scenario, limits, needs))
    if not found:
        return Diagnostic(REACHABLE, "transfer", most_strained(limits, needs))
    cases = tuple(Case((one.craft,), one.text, one.numbers) for one in found)
    text = f"craft that thrust or Δv is too little for: {len({one.craft for one in found})}"
    cure = "; or ".join(dict.fromkeys(one.cure for one in found))
    return Diagnostic(REACHABLE, "transfer", text, cases, cure)


def _out_of_reach(k: int, least: float, limit: float) -> Case:
    """The fault of a craft that needs a higher thrust limit, rounded up to four digits."""
    if not np.isfinite(least):
        return Case((k,), f"craft {k} reaches its goal with no thrust, however large")
    unit = 10.0 ** (floor(log10(least)) - 3)
    enough = ceil(least / unit * (1 + MARGIN)) * unit
    times = f"{least / limit:.4g} times max_acceleration"
    text = f"craft {k} needs at least {enough:.4g} m/s², {times}"
    return Case((k,), text, {"least_limit": least * (1 + MARGIN)})


def _waypoints(scenario: Scenario) -> Iterator[Diagnostic]:
    """Whether craft that must pass places at one time are apart there."""
    closest = closest_pair(scenario.waypoints, scenario.problem, scenario.radii)
    if closest is None:
        return
    distance, i, j, time = closest
    text = f"craft {i} and {j} must be {distance:.4g} m apart at {time:g} s, the closest of all"
    if distance > scenario.radii[[i, j]].sum():
        yield Diagnostic(WAYPOINTS, "transfer", text)
        return
    case = Case((i, j), f"that is within {_within(scenario)}", {"distance": distance})
    cure = "move one of them, or give them other times"
    yield Diagnostic(WAYPOINTS, "transfer", text, (case,), cure)


def linear_error(states: AnyState, problem: Problem) -> ModelError:
    """Estimated error of the linear model for a transfer between or through such states, m."""
    found = model_error(states, problem.dynamics.fastest, problem.duration)
    # About a reference orbit J2 is in the linear model, where there is any.
    return found if problem.orbit is None else replace(found, oblateness=0.0)


def _linear(scenario: Scenario) -> Diagnostic:
    """Whether the linear model is off by less than the collision radius."""
    problem = scenario.problem
    ends = np.concatenate([scenario.initial, scenario.goal])
    found = linear_error(ends, problem)
    earth = "about an oblate Earth" if problem.orbit is None else "outside the linear model"
    off = f"{earth} craft end some {found.total:.2g} m off their goals"
    if found.total <= problem.collision_radius:
        return Diagnostic(LINEAR, "transfer", off)
    turns = problem.mean_motion * problem.duration / (2 * np.pi)
    text = (
        f"{found.curvature:.2g} m since craft are up to {found.reach:.3g} m from the origin, "
        f"{found.oblateness:.2g} m by J2 over {turns:.3g} orbits"
    )
    cure = "plan with --world; or stay nearer to the origin, or take less time"
    cases = (Case((), text, vars(found)),)
    return Diagnostic(LINEAR, "transfer", f"{off}: more than collision_radius", cases, cure)
