"""The expert's nominal plans: scenarios, and perhaps seeds, in; plans with certificates out."""

from collections.abc import Sequence
from dataclasses import replace
from time import perf_counter

import numpy as np
from jaxtyping import Bool, Float

from pipeline.arrays import Array
from pipeline.expert.batch import Batch
from pipeline.expert.losses import what_no_plan_can_help
from pipeline.expert.own import OwnOptima, own_optima
from pipeline.expert.refuted import refuted
from pipeline.expert.scp import Search
from pipeline.expert.seeds import Seed, checked_seed
from pipeline.expert.settings import Settings
from pipeline.expert.spread import Spread
from pipeline.expert.standing import Found
from pipeline.expert.starts import best_of_starts, until_settled
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import has_one_plan, project_to_flyable
from pipeline.plan import (
    INFEASIBLE,
    SOLVED,
    UNSAFE,
    UNSOLVED,
    Made,
    Plan,
    Requirements,
    planned_all,
)
from pipeline.scenario import Scenario


def nominal_plans(
    scenarios: Sequence[Scenario],
    seeds: Sequence[Float[Array, "_ T 6"] | None] | None,
    settings: Settings,
    requirements: Requirements,
    spread: Spread | None = None,
) -> list[Plan]:
    """The expert's plans for scenarios of one problem, flown without errors.

    Args:
        scenarios: what swarms are to do; sizes may differ.
        seeds: for each, as in ``solve``, or None.
        settings: how to work.
        requirements: what the plans must satisfy, of which a risk is not looked at here.
        spread: separation to ask for because craft err; without one, the collision radius alone.

    Raises:
        InputError: for a seed of another shape or with values that are not finite.
    """
    if not scenarios:
        return []
    batch, requirements = Batch(scenarios), requirements.nominal
    started = perf_counter()
    aims = None if seeds is None else [*map(_seed_controls, scenarios, seeds)]
    own = own_optima(batch.initial, batch.goal, batch.problem)
    searched = perf_counter()
    found = _search(batch, own, aims, settings, requirements, spread)
    done = perf_counter()
    stages = {"own_optima": searched - started, "search": done - searched, "plan": done - started}
    timing = {stage: seconds / len(scenarios) for stage, seconds in stages.items()}
    made = [
        Made(one.controls, *own.bound(craft), one.convex_solves, timing)
        for one, craft in zip(found, batch.craft, strict=True)
    ]
    plans = planned_all("expert", scenarios, made, requirements)
    told = zip(plans, found, strict=True)
    return [_explained(plan, one, batch.problem, requirements) for plan, one in told]


def _explained(plan: Plan, found: Found, problem: Problem, requirements: Requirements) -> Plan:
    """The plan with its status and the reason, where it is none to fly."""
    if found.hopeless:
        return replace(plan, status=INFEASIBLE, message=found.obstacle)
    if plan.status == UNSAFE and has_one_plan(problem) and _meet(plan, problem, requirements):
        reason = f"no other controls reach the goals, and with these {plan.message}"
        return replace(plan, status=INFEASIBLE, message=reason)
    if plan.status != SOLVED:
        tried = f"no safe plan after {found.convex_solves} convex solves"
        reasons = [tried, *filter(None, (found.obstacle, plan.message))]
        return replace(plan, status=UNSOLVED, message=": ".join(reasons))
    return plan


def _meet(plan: Plan, problem: Problem, requirements: Requirements) -> bool:
    """Whether craft do come within the collision radius, beyond what cannot be disproven."""
    found, radius = plan.certificate, problem.collision_radius
    if requirements.at_nodes:
        return found.node_collisions > 0
    adrift = None if found.passive_safety is None else found.passive_safety.min_separation
    return any(one is not None and one <= radius for one in (found.min_separation, adrift))


def _seed_controls(scenario: Scenario, seed: Seed | None) -> Float[Array, "n intervals 3"] | None:
    if seed is None:
        return None
    states = checked_seed(scenario, seed)
    return project_to_flyable(states, scenario.initial, scenario.goal, scenario.problem)


def _search(
    batch: Batch,
    own: OwnOptima,
    seeds: Sequence[Float[Array, "_ intervals 3"] | None] | None,
    settings: Settings,
    requirements: Requirements,
    spread: Spread | None,
) -> list[Found]:
    """Search where every craft has a transfer of its own; the others are what they are."""
    parts = zip(batch.split(own.controls), batch.split(own.feasible), strict=True)
    found = [
        replace(_alone(*part), obstacle=why, hopeless=True) if why else _alone(*part)
        for part, why in zip(parts, refuted(batch, own), strict=True)
    ]
    orbits = requirements.passive_safety
    if orbits is not None:
        found = [
            one if one.obstacle or not why else replace(one, obstacle=why, hopeless=True)
            for one, scenario in zip(found, batch.scenarios, strict=True)
            for why in [what_no_plan_can_help(scenario, orbits)]
        ]
    left = [k for k, one in enumerate(found) if not one.obstacle]
    if left:
        part, theirs = batch.part(left), own.of(np.isin(batch.swarms.label, left))
        aims = None if seeds is None else [seeds[k] for k in left]
        first = Search(part, theirs, settings, requirements, aims, spread=spread).run()
        if orbits is not None:
            first = until_settled(part, theirs, first, settings, requirements, spread)
        best = best_of_starts(part, theirs, first, settings, requirements, spread)
        for k, one in zip(left, best, strict=True):
            found[k] = one
    return found


def _alone(controls: Float[Array, "n intervals 3"], feasible: Bool[Array, "n"]) -> Found:
    """The own optima of a scenario, and the craft that has none."""
    if feasible.all():
        return Found(controls)
    k = int(feasible.argmin())
    return Found(controls, obstacle=f"the convex solver found no transfer of craft {k} on its own")
