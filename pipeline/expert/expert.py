"""The expert: plans for scenarios, from optional seeds, that satisfy all requirements.

Where a risk limit is required, pairs are kept some standard deviations of their separation apart
(chance constraints), and a few searches find how many.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from pipeline.arrays import Array, Float
from pipeline.expert.conflicts import BackOff
from pipeline.expert.nominal import nominal_plans
from pipeline.expert.seeds import checked_seed
from pipeline.expert.settings import Settings
from pipeline.orbit.arrays import Controls
from pipeline.orbit.risk import CollisionRisk, collision_risk
from pipeline.orbit.transfer import project_to_flyable
from pipeline.plan.certificate import Risk
from pipeline.plan.judge import Draft, certified_plan
from pipeline.plan.plan import INFEASIBLE, SOLVED, UNSOLVED, Plan
from pipeline.plan.requirements import AT_ALL_TIMES, Requirements, RiskLimit, refuse_risk
from pipeline.scenario import Scenario

TRIES = 8  # searches at most, each with another number of standard deviations
# Ratio of the risk at the ends to the limit from which no search is made: plans change it by a
# factor of two at most.
HOPELESS = 10.0
ENOUGH = 0.5  # share of the limit on risk from which on a plan is not needlessly safe
SATURATION = 0.1  # share of it that is reserved for corrections beyond the thrust limit
AIM = 0.75  # share of it that the next number of standard deviations aims at


def solve(
    scenario: Scenario,
    seed: Float[Array, "_ T 6"] | None = None,
    settings: Settings | None = None,
    requirements: Requirements = AT_ALL_TIMES,
) -> Plan:
    """The expert's plan for a scenario; arguments and errors are as in ``solve_many``."""
    return solve_many([scenario], None if seed is None else [seed], settings, requirements)[0]


def solve_many(
    scenarios: Sequence[Scenario],
    seeds: Sequence[Float[Array, "_ T 6"] | None] | None = None,
    settings: Settings | None = None,
    requirements: Requirements = AT_ALL_TIMES,
) -> list[Plan]:
    """The expert's plans for scenarios of one problem, whose sizes may differ.

    Seeds are node states, m and m/s, about which the first cuts of a scenario are linearized
    instead of its decoupled optima; they need not be safe or obey the dynamics. InputError for
    a seed of another shape or with values that are not finite.
    """
    settings = settings or Settings()
    controls = None if seeds is None else [*map(_flyable, scenarios, seeds)]
    plans = nominal_plans(scenarios, controls, settings, requirements)
    return [within_risk(plan, requirements, settings) for plan in plans]


def _flyable(scenario: Scenario, seed: Float[Array, "_ T 6"] | None) -> Controls | None:
    """Controls of the trajectory nearest to a seed, m/s²."""
    if seed is None:
        return None
    states = checked_seed(scenario, seed)
    return project_to_flyable(states, scenario.initial, scenario.goal, scenario.problem)


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A plan, the standard deviations that were required of it, and the risk of flying it."""

    plan: Plan
    sigmas: float
    risk: CollisionRisk


def within_risk(plan: Plan, requirements: Requirements, settings: Settings | None = None) -> Plan:
    """The plan itself where it keeps the risk limit, or else the cheapest safer plan that does.

    Every pair is kept the same number of standard deviations of its separation apart. As such pairs
    collide with a probability proportional to the tail of the normal distribution, a few searches
    find the number. Each is seeded with the plan before.

    The plan given, of any planner, satisfies the requirements for flight without errors, or is not
    SOLVED. The certificate of the plan returned has the risk. It is UNSOLVED where all bounds are
    above the limit: then it has the least risk, and its message says which craft cause it. Where
    the ends of the plan given have many times the limit, no other is sought.
    """
    limit = requirements.risk
    if limit is None:
        return plan
    refuse_risk([plan.scenario], closed_loop=limit.closed_loop)
    if plan.status == INFEASIBLE:
        return plan
    started, settings = perf_counter(), settings or Settings()
    problem = plan.scenario.problem
    back_off = BackOff(limit.uncertainty(problem), 0.0, limit.closed_loop)
    candidates = [_with_risk(plan, back_off)]
    if plan.status == SOLVED and candidates[0].risk.total > limit.asked:
        candidates.extend(_safer_candidates(candidates[0], limit, settings, requirements.nominal))
    best = min(candidates, key=lambda one: _preference(one, limit.asked))
    fuel_without = plan.certificate.fuel if plan.status == SOLVED else None
    claim = replace(
        Risk.asked_for(limit, problem).of(best.risk, problem),
        sigmas=best.sigmas,
        fuel_without=fuel_without,
    )
    seconds = perf_counter() - started
    same = best.plan is plan or plan.planner.endswith(best.plan.planner)
    found = replace(
        best.plan,
        planner=plan.planner if same else f"{plan.planner} + {best.plan.planner}",
        certificate=replace(best.plan.certificate, risk=claim),
        convex_solves=sum(one.plan.convex_solves for one in candidates),
        timing={**plan.timing, "risk": seconds, "plan": plan.timing.get("plan", 0.0) + seconds},
    )
    if claim.kept or plan.status != SOLVED:
        return found
    return replace(found, status=UNSOLVED, message=_too_risky(best, limit.asked))


def _safer_candidates(
    first: _Candidate, limit: RiskLimit, settings: Settings, requirements: Requirements
) -> Iterator[_Candidate]:
    """Search for the number k of standard deviations, until the risk is good enough.

    The risk is modelled as that at the ends, which no plan changes much, plus a multiple of the
    normal tail Q(k); k is bracketed by the largest number known to be too small and the least known
    to suffice. Where the ends have many times the limit nothing is searched.
    """
    from scipy.special import ndtr  # slow to import, and only a risk needs it

    risk_limit, uncertainty = limit.asked, limit.uncertainty(first.plan.scenario.problem)
    if first.risk.at_ends.sum() > HOPELESS * risk_limit:
        return
    pairs = max(1, int((first.risk.of_pair > risk_limit / max(1, len(first.risk.of_pair))).sum()))
    sigmas, too_few, enough, plan = _tail(AIM * risk_limit / pairs), 0.0, np.inf, first.plan
    if first.risk.total - first.risk.saturation <= risk_limit:
        sigmas = 0.0
    for _ in range(TRIES):
        back_off = BackOff(uncertainty, sigmas, limit.closed_loop)
        scenario = _leaving_room(plan, back_off, risk_limit)
        (found,) = nominal_plans([scenario], [plan.controls], settings, requirements, back_off)
        found = _within_limit(found, first.plan, requirements)
        candidate = _with_risk(found, back_off)
        yield candidate
        risk = candidate.risk.total
        if found.status != SOLVED:
            enough = sigmas  # no plan: a smaller number follows
            sigmas = (too_few + enough) / 2
            continue
        ends = float(candidate.risk.at_ends.sum())
        if ENOUGH * risk_limit <= risk <= risk_limit or ends >= risk_limit:
            return
        too_few, enough = (sigmas, enough) if risk > risk_limit else (too_few, sigmas)
        factor = max(risk - ends, 0.0) / ndtr(-sigmas)
        following = _tail(AIM * (risk_limit - ends) / factor) if factor > 0 else 0.0
        if not too_few < following < enough:
            following = (too_few + enough) / 2 if np.isfinite(enough) else 1.1 * too_few
        sigmas, plan = following, found


def _leaving_room(plan: Plan, back_off: BackOff, risk_limit: float) -> Scenario:
    """The scenario with thrust reserved for corrections at each node, where the limit suffices.

    So corrections exceed the limit only with a small share of the risk.
    """
    scenario, limit = plan.scenario, plan.scenario.problem.max_acceleration
    if limit is None or not back_off.closed_loop:
        return scenario
    spread = back_off.dispersion(plan.controls, scenario.problem)
    largest = float(spread.correction_sigma.max())
    left = limit - _tail(SATURATION * risk_limit / plan.controls.size) * largest
    if left <= 0:
        return scenario
    return replace(scenario, problem=replace(scenario.problem, max_acceleration=left))


def _within_limit(made: Plan, plan: Plan, requirements: Requirements) -> Plan:
    """Restate a plan of a scenario with less thrust for another plan's scenario, with its bound."""
    if made.scenario is plan.scenario:
        return made
    if made.status != SOLVED:
        return replace(made, scenario=plan.scenario, status=UNSOLVED)
    bound = plan.certificate.fuel_lower_bound, plan.certificate.fuel_lower_bound_proof
    found = Draft(made.controls, *bound, made.convex_solves, made.timing)
    return certified_plan(made.planner, plan.scenario, found, requirements)


def _tail(probability: float) -> float:
    """Standard deviations, at least 0, that a normal variable exceeds with a probability."""
    from scipy.special import ndtri  # slow to import, and only a risk needs it

    return max(0.0, -float(ndtri(min(probability, 0.5))))


def _with_risk(plan: Plan, back_off: BackOff) -> _Candidate:
    problem = plan.scenario.problem
    spread = back_off.dispersion(plan.controls, problem)
    risk = collision_risk(plan.states, plan.controls, problem, spread)
    return _Candidate(plan, back_off.sigmas, risk)


def _preference(candidate: _Candidate, risk_limit: float) -> tuple[bool, float]:
    """Sort key: plans within the risk limit first, by fuel, then the others, by risk."""
    kept = candidate.plan.status == SOLVED and candidate.risk.total <= risk_limit
    return not kept, candidate.plan.certificate.fuel if kept else candidate.risk.total


def _too_risky(candidate: _Candidate, risk_limit: float) -> str:
    """Why the risk limit is not kept: the pair that adds most, and whether the ends alone do."""
    scenario, risk = candidate.plan.scenario, candidate.risk
    if risk.saturation > risk_limit:
        return (
            f"corrections at each node ask for more than max_acceleration with a probability of up "
            f"to {risk.saturation:.3g}, asked for was a risk of {risk_limit:g}"
        )
    radius, worst = scenario.problem.collision_radius, int(risk.of_pair.argmax())
    text = (
        f"the risk that a pair comes within {radius:g} m is bounded by {risk.total:.3g}, asked for "
        f"was {risk_limit:g}; craft {risk.first[worst]} and {risk.second[worst]} add "
        f"{risk.of_pair[worst]:.3g}"
    )
    if risk.at_ends.sum() <= risk_limit:
        return text
    worst = int(risk.at_ends.argmax())
    i, j = int(risk.first[worst]), int(risk.second[worst])
    ends = {"start": scenario.initial, "goal": scenario.goal}
    distances = {name: float(np.linalg.norm(s[i, :3] - s[j, :3])) for name, s in ends.items()}
    closest = min(distances, key=lambda name: distances[name])
    return (
        f"{text}, and the ends alone have {risk.at_ends.sum():.3g}: craft {i} and {j} are "
        f"{distances[closest]:.4g} m apart at the {closest}"
    )
