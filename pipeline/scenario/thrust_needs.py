"""Least thrust and Δv that each craft needs, and where its limits are too low."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import floor, log10

import numpy as np

from pipeline.orbit.arrays import OfCraft
from pipeline.orbit.decoupled import least_cost, least_limits_within
from pipeline.orbit.problem import Problem
from pipeline.orbit.thrust import ALONG_AXES, NORM, Limits
from pipeline.scenario.arrivals import arrivals_of
from pipeline.scenario.scenario import Scenario
from pipeline.scenario.waypoint import of_craft

MARGIN = 1e-6  # share of a need that is left to rounding
TIME = "give more time by time_step or nodes"


@dataclass(frozen=True)
class Shortfall:
    """A limit of one craft that is too low."""

    craft: int
    text: str  # what, and by how much
    cure: str
    numbers: dict[str, float]


@dataclass(frozen=True)
class Needs:
    """Least limits and Δv with which each craft can make its transfer; infinite if none can."""

    limit: OfCraft  # of the limit on components or thrusters, m/s²
    norm: OfCraft  # of the limit on the norm
    delta_v: OfCraft  # of what they may burn, m/s


def needs_of(scenario: Scenario, limits: Limits) -> Needs:
    """Least limits and least Δv of each craft on its own: without others, and impulse bits.

    By its waypoints that have times; others are left out.
    """
    problem, timed = scenario.problem, [one for one in scenario.waypoints if one.time is not None]
    passed = {
        craft: [(node, one) for one in some if (node := one.node(problem)) is not None]
        for craft, some in of_craft(timed).items()
    }
    at = arrivals_of(scenario.initial, scenario.goal, problem, passed)
    reach, open_ = at.reach * at.asked[..., None], np.asarray(limits.burns.any(axis=2))
    limit = least_limits_within(at.miss, reach, open_, problem)
    norm = limit
    if not isinstance(problem.thrust.model, str):  # no component is larger than the norm
        norm = least_limits_within(at.miss, reach, open_, replace(problem, thrust=ALONG_AXES))
    delta_v = np.zeros(scenario.n)
    for k in np.flatnonzero(np.isfinite(limits.delta_v) & np.isfinite(limit)):
        most = float(limits.component[k])
        least = least_cost(at.miss[k], reach[k], open_[k], most, problem)
        delta_v[k] = least * problem.time_step
    return Needs(limit, norm, delta_v)


def shortfalls(scenario: Scenario, limits: Limits, needs: Needs) -> Iterator[Shortfall]:
    """The limits of craft that are too low: the first of each craft."""
    problem = scenario.problem
    for k in range(scenario.n):
        if np.isinf(needs.limit[k]):
            yield _no_way(k, limits, scenario)
            continue
        moves = needs.limit[k] > 0
        if moves and (found := _no_burn_large_enough(k, limits, problem)):
            yield found
        for name, need, most, unit in (
            ("max_acceleration", needs.limit[k], limits.component[k], "m/s²"),
            ("max_acceleration_norm", needs.norm[k], limits.norm[k], "m/s²"),
            ("delta_v", needs.delta_v[k], limits.delta_v[k], "m/s"),
        ):
            if need > most * (1 + MARGIN):
                text = f"craft {k} needs at least {down(need)} {unit} and has {most:g} {unit}, its"
                numbers = {f"least_{name}": float(need)}
                yield Shortfall(k, f"{text} {name}", f"raise {name}, or {TIME}", numbers)
                break


def _no_way(k: int, limits: Limits, scenario: Scenario) -> Shortfall:
    """The shortfall of a craft that reaches its goal with no thrust, however large."""
    may, problem = int(limits.burns[k].any(axis=1).sum()), scenario.problem
    way = " by its waypoints" if k in of_craft(scenario.waypoints) else ""
    if may == problem.intervals:
        text = f"craft {k} reaches its goal{way} with no thrust, however large"
        return Shortfall(k, text, TIME, {})
    text = (
        f"craft {k} may burn in {may} of {problem.intervals} intervals, too few to reach its "
        f"goal{way} with any thrust"
    )
    cure = f"leave more time to burn by no_burn, or {TIME}"
    return Shortfall(k, text, cure, {"may_burn": float(may)})


def _no_burn_large_enough(k: int, limits: Limits, problem: Problem) -> Shortfall | None:
    """The shortfall of a craft that can make no burn as large as the smallest impulse bit."""
    thrust, most = problem.thrust, [limits.component[k], limits.norm[k]]
    if thrust.min_delta_v is None:
        return None
    if thrust.model == NORM:
        most[0] *= np.sqrt(3)  # along all three axes
    burn = problem.time_step * float(min(most))
    burn = min(burn, float(limits.delta_v[k]))
    if burn >= thrust.min_delta_v * (1 - MARGIN):
        return None
    text = (
        f"craft {k} must burn, and can make no burn of more than {burn:.4g} m/s, less than "
        f"min_delta_v, {thrust.min_delta_v:g} m/s"
    )
    return Shortfall(
        k, text, "lower min_delta_v, or raise the limits of thrust", {"most_delta_v": burn}
    )


def most_strained(limits: Limits, needs: Needs) -> str:
    """For each kind of limit, the craft that needs the largest share of it, in words."""
    said = []
    for name, need, most in (
        ("max_acceleration", needs.limit, limits.component),
        ("max_acceleration_norm", needs.norm, limits.norm),
        ("delta_v", needs.delta_v, limits.delta_v),
    ):
        share = np.where(np.isfinite(most), need / most, 0.0)
        if np.isfinite(most).any():
            k = int(share.argmax())
            said.append(f"craft {k} needs at least {share[k]:.0%} of its {name}")
    if not said:
        k = int(needs.limit.argmax())
        return f"no limit of thrust; craft {k} needs the most, {needs.limit[k]:.4g} m/s²"
    return "; ".join(said)


def down(value: float) -> str:
    """The value rounded down to four digits."""
    unit = 10.0 ** (floor(log10(value)) - 3)
    return f"{floor(value / unit * (1 - MARGIN)) * unit:.4g}"
