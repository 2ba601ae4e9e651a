"""Plans for flight without errors: the best result of SCP searches for each scenario."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from time import perf_counter

import numpy as np

from pipeline.expert.batch import Batch, in_batches
from pipeline.expert.clusters import cluster_labels
from pipeline.expert.conflicts import BackOff, Trajectory
from pipeline.expert.impulse_bit import without_small_burns
from pipeline.expert.incumbents import SearchResult
from pipeline.expert.scp import Search, SearchProblem, Seeds
from pipeline.expert.settings import Settings
from pipeline.orbit.approaches import PROVABLE
from pipeline.orbit.passive_safety import Ends, unavoidable_encounter
from pipeline.orbit.transfer import fly, has_one_plan
from pipeline.plan.certificate import gap_of
from pipeline.plan.judge import Draft, certified_plans
from pipeline.plan.plan import INFEASIBLE, SOLVED, UNSAFE, UNSOLVED, Plan
from pipeline.plan.requirements import Requirements
from pipeline.scenario import Scenario


def nominal_plans(
    scenarios: Sequence[Scenario],
    seeds: Seeds | None,
    settings: Settings,
    requirements: Requirements,
    back_off: BackOff | None = None,
) -> list[Plan]:
    """The expert's plans for scenarios of one problem, flown without errors.

    As in ``solve_many``, but without a limit on risk, and seeds are controls, m/s²; ``back_off`` is
    kept beyond the collision radius because of errors.
    """

    def planned(some: Sequence[int]) -> list[Plan]:
        part = [scenarios[k] for k in some], None if seeds is None else [seeds[k] for k in some]
        return _nominal_batch(*part, settings, requirements, back_off)

    return in_batches(scenarios, planned)


def _nominal_batch(
    scenarios: Sequence[Scenario],
    seeds: Seeds | None,
    settings: Settings,
    requirements: Requirements,
    back_off: BackOff | None,
) -> list[Plan]:
    """As ``nominal_plans``, for one batch."""
    batch, requirements = Batch(scenarios), requirements.nominal
    task = SearchProblem(batch, settings, requirements, back_off)
    started = perf_counter()
    _ = batch.optima  # computed here to be timed as a stage of its own
    searched = perf_counter()
    results = _search(task, seeds)
    done = perf_counter()
    for k, result in enumerate(results):
        if result.lower_bound is not None:
            batch.raise_bounds(k, result.lower_bound)
    stages = {"own_optima": searched - started, "search": done - searched, "plan": done - started}
    timing = {stage: seconds / len(scenarios) for stage, seconds in stages.items()}
    made = [
        Draft(
            *(result.controls, *batch.bound(k), result.convex_solves, timing),
            least_share=batch.least_share(k),
        )
        for k, result in enumerate(results)
    ]
    plans = certified_plans("expert", scenarios, made, requirements)
    return [_explained(*both) for both in zip(plans, results, strict=True)]


def with_back_off(
    plans: Sequence[Plan], back_off: BackOff, requirements: Requirements
) -> list[Plan]:
    """The expert's plans that also keep a back-off, seeded with safe plans of one problem.

    Where it finds none, a plan keeps the collision radius alone, or is not SOLVED.
    """
    scenarios, seeds = [plan.scenario for plan in plans], [plan.controls for plan in plans]
    return nominal_plans(scenarios, seeds, Settings(), requirements, back_off)


def _explained(plan: Plan, result: SearchResult) -> Plan:
    """The plan with its status and, where it is not SOLVED, the reason."""
    if (smallest := plan.certificate.smallest_burn) is not None:
        smallest = replace(smallest, fuel_without=result.fuel_without or plan.certificate.fuel)
        plan = replace(plan, certificate=replace(plan.certificate, smallest_burn=smallest))
    if result.infeasible:
        return replace(plan, status=INFEASIBLE, message=result.obstacle)
    if plan.status == UNSAFE and has_one_plan(plan.scenario.problem) and _collides(plan):
        reason = f"no other controls reach the goals, and with these {plan.message}"
        return replace(plan, status=INFEASIBLE, message=reason)
    if plan.status != SOLVED:
        tried = f"no safe plan after {result.convex_solves} convex solves"
        reasons = [tried, *filter(None, (result.obstacle, plan.message))]
        return replace(plan, status=UNSOLVED, message=": ".join(reasons))
    return plan


def _collides(plan: Plan) -> bool:
    """Whether craft provably violate separations, and do not merely lack a proof of safety."""
    found, radius = plan.certificate, plan.scenario.problem.collision_radius
    if plan.requirements.at_nodes:
        return found.node_collisions > 0
    drifting = None if found.passive_safety is None else found.passive_safety.min_separation
    if plan.scenario.unlike:
        adrift = None if found.passive_safety is None else found.passive_safety.clearance
        each = [one for one in (found.clearance, adrift) if one is not None]
        outside = found.corridor is not None and found.corridor.min_margin <= 0
        return outside or any(one.min_clearance <= 0 for one in each)
    return any(one is not None and one <= radius for one in (found.min_separation, drifting))


def _search(task: SearchProblem, seeds: Seeds | None) -> list[SearchResult]:
    """Search where every craft has a decoupled optimum and nothing proves that there is no plan."""
    results = _before_search(task)
    left = [k for k, result in enumerate(results) if not result.obstacle]
    if not left:
        return results
    part = task.part(left)
    found = Search(part, None if seeds is None else [seeds[k] for k in left]).run()
    settings, optima = task.settings, part.batch.optima
    if task.requirements.passive_safety is not None:
        # Coplanar craft first avoid each other in their plane, where there may be no way past one
        # that drifts; passing on other sides leads out of it.
        found = _from_further_starts(
            *(part, found, settings.passive_safety_starts),
            unsatisfactory=lambda _, result: not result.feasible,
            better=lambda _, best, other: other if other.feasible else best,
        )
    # The sides on which craft pass each other decide which local optimum a search ends in.
    batch = part.batch
    bounds = [batch.objective_of(optima.lower_bound[craft], craft) for craft in batch.craft]

    def too_expensive(k: int, result: SearchResult) -> bool:
        fuel = batch.objective(result.controls, batch.craft[k])
        return gap_of(fuel, bounds[k], batch.problem) > settings.gap_tolerance

    found = _from_further_starts(
        *(part, found, settings.starts - 1),
        unsatisfactory=too_expensive,
        better=lambda k, best, other: _better(part.part([k]), best, other),
    )
    if batch.problem.thrust.min_delta_v is not None:
        found = without_small_burns(part, found)
    for k, result in zip(left, found, strict=True):
        results[k] = result
    return results


def _before_search(task: SearchProblem) -> list[SearchResult]:
    """Decoupled optima of each scenario, with the reason why there is no plan or search, if any."""
    batch, orbits = task.batch, task.requirements.passive_safety
    optima = batch.optima
    parts = zip(
        batch.scenarios,
        batch.swarms.split(optima.controls),
        batch.swarms.split(optima.feasible),
        batch.infeasible(),
        strict=True,
    )
    results = []
    for scenario, controls, feasible, why in parts:
        if not why and not feasible.all():
            reason = f"the convex solver found no transfer of craft {feasible.argmin()} on its own"
            results.append(SearchResult(controls, obstacle=reason))
            continue
        if not why and orbits is not None:
            why = _unavoidable_encounter(scenario, orbits)
        results.append(SearchResult(controls, obstacle=why, infeasible=bool(why)))
    return results


def _unavoidable_encounter(scenario: Scenario, orbits: float) -> str:
    """Why no plan is passively safe, where the ends alone prove it; else an empty string."""
    ends = scenario.initial, scenario.goal, scenario.problem
    radii = scenario.radii if scenario.unlike else None
    found = unavoidable_encounter(Ends(*ends, orbits, radii, scenario.obstacles))
    if found is None or found.pair is None:
        return ""
    i, j = found.pair
    end = "its start" if found.node == 0 else "its goal"
    near = f"within {found.distance:.6g} m of"
    if scenario.sized:
        near = f"{scenario.problem.collision_radius - found.distance:.6g} m too close to"
    other = f"craft {j}, which drifts on from its goal,"
    if j >= scenario.n:
        other = scenario.obstacles[j - scenario.n].name
    return (
        f"craft {i}, adrift from {end}, comes {near} {other} at {found.time:.6g} s, whatever is "
        f"planned; {scenario.required_separation(i, j)}"
    )


def _from_further_starts(
    task: SearchProblem,
    first: Sequence[SearchResult],
    times: int,
    unsatisfactory: Callable[[int, SearchResult], bool],
    better: Callable[[int, SearchResult, SearchResult], SearchResult],
) -> list[SearchResult]:
    """Search unsatisfactory scenarios again from further starts, and keep the better results."""
    results = list(first)
    for start in range(1, times + 1):
        left = [k for k, result in enumerate(results) if unsatisfactory(k, result)]
        if not left:
            break
        for k, other in zip(left, Search(task.part(left), start=start).run(), strict=True):
            solves = results[k].convex_solves + other.convex_solves
            results[k] = replace(better(k, results[k], other), convex_solves=solves)
    return results


def _better(task: SearchProblem, best: SearchResult, other: SearchResult) -> SearchResult:
    """Combine the cheaper result of each cluster where that is safe; else the cheaper of both."""
    if not (best.feasible and other.feasible):
        return best if best.feasible else other
    (scenario,) = task.batch.scenarios
    both = np.concatenate([best.joined, other.joined])
    labels = cluster_labels(scenario.n, *both.T)
    saved = np.zeros(scenario.n)
    for label in np.unique(labels):
        craft = np.flatnonzero(labels == label)
        costs = [task.batch.objective(one.controls[craft], craft) for one in (best, other)]
        saved[label] = costs[0] - costs[1]
    cheaper = (saved > 0)[labels]
    controls = np.where(cheaper[:, None, None], other.controls, best.controls)
    flown = Trajectory(controls, fly(scenario.initial, controls, scenario.problem))
    radius = scenario.problem.collision_radius
    conflicts, _ = task.detection.conflicts(flown, radius + PROVABLE)
    if len(conflicts) == 0:
        return replace(best, controls=controls, joined=both)
    return other if saved.sum() > 0 else best
