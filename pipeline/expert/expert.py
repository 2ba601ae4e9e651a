"""The expert: a scenario, and perhaps a seed, in; a plan with its certificate out."""

from dataclasses import replace
from time import perf_counter

from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.expert.cuts import NO_CUTS
from pipeline.expert.own import OwnOptima, own_optima
from pipeline.expert.scp import Found, Search
from pipeline.expert.seeds import Seed, checked_seed
from pipeline.expert.settings import Settings
from pipeline.expert.starts import best_of_starts
from pipeline.orbit.transfer import project_to_flyable
from pipeline.plan import INFEASIBLE, SOLVED, UNSOLVED, Plan, planned
from pipeline.scenario import Scenario


def solve(scenario: Scenario, seed: Seed | None = None, settings: Settings | None = None) -> Plan:
    """The expert's plan for a scenario.

    Args:
        scenario: what the swarm is to do.
        seed: node states (n, T, 6) to aim the first cuts from, m and m/s; they need neither be
            safe nor obey the dynamics. Without one the own optima are aimed from.
        settings: how to work.

    Raises:
        InputError: for a seed of another shape or with values that are not finite.
    """
    settings = settings or Settings()
    started = perf_counter()
    seed_controls = None if seed is None else _seed_controls(scenario, seed)
    own = own_optima(scenario.initial, scenario.goal, scenario.problem)
    searched = perf_counter()
    found = _search(scenario, own, seed_controls, settings)
    done = perf_counter()
    timing = {"own_optima": searched - started, "search": done - searched, "plan": done - started}
    plan = planned(
        "expert",
        scenario,
        found.controls,
        float(own.lower_bound.sum()),
        at_nodes=settings.separation == "nodes",
        convex_solves=found.convex_solves,
        timing=timing,
    )
    if own.impossible.any():
        k = int(own.impossible.argmax())
        reason = f"craft {k} cannot reach its goal within max_acceleration, which is proven"
        return replace(plan, status=INFEASIBLE, message=reason)
    if plan.status != SOLVED:
        tried = f"no safe plan after {found.convex_solves} convex solves"
        reasons = [tried, *filter(None, (found.obstacle, plan.message))]
        return replace(plan, status=UNSOLVED, message=": ".join(reasons))
    return plan


def _seed_controls(scenario: Scenario, seed: Seed) -> Float[Array, "n intervals 3"]:
    states = checked_seed(scenario, seed)
    return project_to_flyable(states, scenario.initial, scenario.goal, scenario.problem)


def _search(
    scenario: Scenario,
    own: OwnOptima,
    seed_controls: Float[Array, "n intervals 3"] | None,
    settings: Settings,
) -> Found:
    if not own.feasible.all():
        k = int(own.feasible.argmin())
        obstacle = f"the convex solver found no transfer of craft {k} on its own"
        return Found(own.controls, 0, NO_CUTS, obstacle=obstacle)
    best = Search(scenario, own, seed_controls, settings).run()
    return best_of_starts(scenario, own, best, settings)
