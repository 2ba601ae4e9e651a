"""Whether thrust and Δv suffice for the transfer of each craft on its own."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import ceil, floor, log10

import numpy as np

from pipeline.orbit.arrays import PerCraft
from pipeline.orbit.decoupled import craft_fuel_bound, minimum_limits, minimum_limits_at_nodes
from pipeline.orbit.problem import LIMIT_ROUNDING, Problem
from pipeline.orbit.thrust import ALONG_AXES, NORM, Limits
from pipeline.orbit.thrust_cost import dearest
from pipeline.scenario.diagnostic import Case, Diagnostic, diagnostic_of
from pipeline.scenario.scenario import Scenario
from pipeline.scenario.state_constraints import StateConstraints, timed_constraints
from pipeline.scenario.waypoint import of_craft

REACHABLE = "within reach"  # the rule
TIME = "give more time by time_step or nodes"

CaseAndCure = tuple[Case, str]  # a fault and its cure


@dataclass(frozen=True)
class Need:
    """The least limit of one kind with which each craft can make its transfer."""

    name: str
    unit: str
    needed: PerCraft  # infinite where no limit is enough
    limit: PerCraft  # that it has; infinite where there is none


def reachable(scenario: Scenario) -> Diagnostic:
    """Whether each craft can reach its goal within its limits of thrust and Δv."""
    limits = scenario.limits
    if limits is None:
        return _within_max_acceleration(scenario)
    at = timed_constraints(scenario)
    needs = _needs(scenario, limits, at)
    found = list(_faults(scenario, limits, needs, at))
    cases = [case for case, _ in found]
    cure = "; or ".join(dict.fromkeys(cure for _, cure in found))
    wrong = "limits of thrust or Δv that are too low"
    fine = "" if cases else _closest_to_limits(needs)
    return diagnostic_of(REACHABLE, "transfer", cases, wrong, cure, fine)


def _within_max_acceleration(scenario: Scenario) -> Diagnostic:
    """Whether each craft can reach its goal within max_acceleration, if that is given."""
    limit = scenario.problem.max_acceleration
    least = minimum_limits(scenario.initial, scenario.goal, scenario.problem)
    most = int(least.argmax())
    fine = f"no max_acceleration; craft {most} needs the most, {least[most]:.4g} m/s²"
    wrong = "craft that cannot reach their goal, however large their thrust"
    if limit is not None:
        share = least[most] / limit
        fine = f"craft {most} needs the most thrust, {share:.0%} of max_acceleration"
        wrong = f"craft that need more than max_acceleration, {limit:g} m/s²"
    limit = np.inf if limit is None else limit
    short = np.flatnonzero((least > limit * (1 + LIMIT_ROUNDING)) | np.isinf(least))
    cure = f"raise max_acceleration, or {TIME}" if np.isfinite(least[short]).any() else TIME
    worst = short[least[short].argsort(kind="stable")[::-1]].tolist()
    cases = [_too_little_thrust(k, float(least[k]), limit) for k in worst]
    return diagnostic_of(REACHABLE, "transfer", cases, wrong, cure, fine)


def _too_little_thrust(k: int, least: float, limit: float) -> Case:
    """The fault of a craft that needs a higher thrust limit, rounded up to four digits."""
    if not np.isfinite(least):
        return Case((k,), f"craft {k} cannot reach its goal, however large its thrust")
    unit = 10.0 ** (floor(log10(least)) - 3)
    enough = ceil(least / unit * (1 + LIMIT_ROUNDING)) * unit
    times = f"{least / limit:.4g} times max_acceleration"
    text = f"craft {k} needs at least {enough:.4g} m/s², {times}"
    return Case((k,), text, {"least_limit": least * (1 + LIMIT_ROUNDING)})


def _needs(scenario: Scenario, limits: Limits, at: StateConstraints) -> list[Need]:
    """Least limits and least Δv of each craft, without regard to other craft and impulse bits."""
    problem = scenario.problem
    reach, open_ = at.reach * at.constrained[..., None], np.asarray(limits.burns.any(axis=2))
    limit = minimum_limits_at_nodes(at.miss, reach, open_, problem)
    norm = limit
    if not isinstance(problem.thrust.model, str):  # no component is larger than the norm
        norm = minimum_limits_at_nodes(at.miss, reach, open_, replace(problem, thrust=ALONG_AXES))
    delta_v, within = np.zeros(scenario.n), limits.component * (1 + LIMIT_ROUNDING)
    # Of craft that arrive within their limit, which is given a bit wider so that there is a least
    for k in np.flatnonzero(np.isfinite(limits.delta_v) & np.isfinite(limit) & (limit <= within)):
        most = float(within[k]) * (1 + LIMIT_ROUNDING)
        least = craft_fuel_bound(at.miss[k], reach[k], open_[k], most, problem)
        delta_v[k] = least * problem.time_step
    return [
        Need("max_acceleration", "m/s²", limit, limits.component),
        Need("max_acceleration_norm", "m/s²", norm, limits.norm),
        Need("delta_v", "m/s", delta_v, limits.delta_v),
    ]


def _faults(
    scenario: Scenario, limits: Limits, needs: Sequence[Need], at: StateConstraints
) -> Iterator[CaseAndCure]:
    """The first limit of each craft that is too low, and smallest burns that no limit allows."""
    for k in range(scenario.n):
        limit = needs[0].needed[k]
        if np.isinf(limit):
            yield _unreachable(k, limits, scenario, at)
            continue
        if limit > 0 and (found := _burns_too_small(k, limits, scenario.problem)):
            yield found
        for need in needs:
            least, most, unit = float(need.needed[k]), need.limit[k], need.unit
            if least > most * (1 + LIMIT_ROUNDING):
                text = (
                    f"craft {k} needs at least {_down(least)} {unit} and has {most:g} {unit}, its "
                    f"{need.name}"
                )
                case = Case((k,), text, {f"least_{need.name}": least})
                yield case, f"raise {need.name}, or {TIME}"
                break


def _unreachable(k: int, limits: Limits, scenario: Scenario, at: StateConstraints) -> CaseAndCure:
    """The fault of a craft that cannot reach its goal, however large its thrust."""
    allowed, problem = int(limits.burns[k].any(axis=1).sum()), scenario.problem
    way = " by its waypoints" if k in of_craft(scenario.waypoints) else ""
    if allowed == problem.intervals:
        text = f"craft {k} cannot reach its goal{way}, however large its thrust"
        return Case((k,), text), TIME
    miss, drift = at.missed_by_drift(k)
    text = (
        f"craft {k} may burn in {allowed} of {problem.intervals} intervals, too few to reach its "
        f"goal{way} with any thrust; {drift}"
    )
    case = Case((k,), text, {"may_burn": float(allowed), "drift_miss": miss})
    return case, f"leave more time to burn by no_burn, or {TIME}"


def _burns_too_small(k: int, limits: Limits, problem: Problem) -> CaseAndCure | None:
    """Diagnosis of a craft whose thrust limits allow no burn of the minimum impulse bit."""
    thrust, most = problem.thrust, [limits.component[k], limits.norm[k]]
    if thrust.min_delta_v is None:
        return None
    if thrust.model == NORM:
        most[0] *= np.sqrt(3)  # along all three axes
    elif not isinstance(thrust.model, str):
        most[1] *= dearest(thrust.model)  # thrusts may cancel out in part
    burn = problem.time_step * float(min(most))
    burn = min(burn, float(limits.delta_v[k]))
    if burn >= thrust.min_delta_v * (1 - LIMIT_ROUNDING):
        return None
    text = (
        f"craft {k} must burn, and can make no burn of more than {burn:.4g} m/s, less than "
        f"min_delta_v, {thrust.min_delta_v:g} m/s"
    )
    case = Case((k,), text, {"most_delta_v": burn})
    return case, "lower min_delta_v, or raise the limits of thrust"


def _closest_to_limits(needs: Sequence[Need]) -> str:
    """For each kind of limit, the craft that needs the largest share of it, in words."""
    texts = []
    for need in needs:
        share = np.where(np.isfinite(need.limit), need.needed / need.limit, 0.0)
        if np.isfinite(need.limit).any():
            k = int(share.argmax())
            texts.append(f"craft {k} needs at least {share[k]:.0%} of its {need.name}")
    limit = needs[0].needed
    k = int(limit.argmax())
    none = f"no limit of thrust; craft {k} needs the most, {limit[k]:.4g} m/s²"
    return "; ".join(texts) or none


def _down(value: float) -> str:
    """The value rounded down to four digits."""
    unit = 10.0 ** (floor(log10(value)) - 3)
    return f"{floor(value / unit * (1 - LIMIT_ROUNDING)) * unit:.4g}"
