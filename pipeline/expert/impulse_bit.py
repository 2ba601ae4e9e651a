"""Minimum impulse bit: plans with smaller burns are searched again, with these left out or raised.

For thrusters with fixed directions mixed-integer programs make each thrust zero or large enough.
For a pointed one plans are made in turn, each without the smaller half of the burns that were too
small in the plan before, about which it is linearized. Where that ends without a safe plan, they
are made once more, each with these burns raised: as large as the smallest, along their directions.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from pipeline.expert.batch import Batch, allowed_thrust
from pipeline.expert.conic_decoupled import decoupled_program, polished
from pipeline.expert.decoupled import INTEGERS, DecoupledOptima
from pipeline.expert.incumbents import SearchResult
from pipeline.expert.scp import Search, SearchProblem
from pipeline.expert.subproblem import UnsolvableError
from pipeline.orbit.arrays import Controls, norm
from pipeline.orbit.problem import LIMIT_ROUNDING, Problem
from pipeline.orbit.thrust import Limits
from pipeline.orbit.thrust_cost import burn_sizes, craft_fuel, too_small
from pipeline.orbit.transfer import has_one_plan

ROUNDS = 16  # plans at most
NEGLIGIBLE = 0.03  # share of the smallest burn up to which burns are dropped and never raised


def without_small_burns(task: SearchProblem, results: Sequence[SearchResult]) -> list[SearchResult]:
    """Results of searches, with those that have too small burns searched again."""
    return [
        result if result.obstacle else _searched_again(task.part([k]), result)
        for k, result in enumerate(results)
    ]


def _searched_again(task: SearchProblem, result: SearchResult) -> SearchResult:
    """The result of one scenario, searched again where a burn is too small."""
    batch, limits = task.batch, task.batch.limits
    assert limits is not None
    small = too_small(result.controls, limits, batch.problem).any(axis=(1, 2))
    if not small.any():
        return result
    if has_one_plan(batch.problem):
        bit = f"{batch.problem.thrust.min_delta_v:g} m/s"
        why = f"no other controls reach the goals, and with these craft {small.argmax()} has burns"
        return replace(result, feasible=False, obstacle=f"{why} below {bit}", infeasible=True)
    pointed = batch.problem.thrust.directions is None
    found = (_search_pointed if pointed else _search_by_integers)(task, result)
    if result.feasible:
        fuel = craft_fuel(result.controls, batch.problem.thrust, limits)
        found = replace(found, fuel_without=float(fuel.sum()))
    return found


def _search_by_integers(task: SearchProblem, result: SearchResult) -> SearchResult:
    """Search with programs whose thrusts are zero or large enough."""
    batch, bit = task.batch, task.batch.problem.thrust.min_delta_v
    try:
        optima = integer_optima(batch)
    except UnsolvableError as error:
        return replace(result, feasible=False, obstacle=str(error))
    if optima.impossible.any():
        given = f"by burns of at least {bit:g} m/s {allowed_thrust(batch.scenarios[0])}"
        who = f"craft {optima.impossible.argmax()}"
        why = f"{who} cannot reach its goal {given}, which is proven"
        return replace(result, feasible=False, obstacle=why, infeasible=True)
    start = Batch(batch.scenarios, batch.limits, batch.constraints)
    start.optima = optima
    search = replace(task, batch=start, whole_burns=True)
    (found,) = Search(search, [result.controls]).run()
    solves, bound = result.convex_solves + found.convex_solves, optima.lower_bound
    return _unless_small(replace(found, convex_solves=solves, lower_bound=bound), batch)


def integer_optima(batch: Batch) -> DecoupledOptima:
    """Decoupled optima with a minimum impulse bit, for thrusters with fixed directions.

    UnsolvableError where such burns of a craft are not found, nor proven to be impossible. Nothing
    is proven of a craft with waypoints at open times, of which these programs have one choice.
    """
    # By SciPy, slow to import
    from pipeline.expert.mixed_integer import by_integers, integer_infeasible

    optima, limits, constraints = batch.optima, batch.limits, batch.constraints
    assert limits is not None
    assert constraints is not None
    controls, bound = optima.controls.copy(), np.zeros(len(optima))
    impossible, fixed = np.zeros(len(optima), dtype=bool), np.isinf(batch.open_bound)
    small = too_small(controls, limits, batch.problem)
    for k in np.flatnonzero(small.any(axis=(1, 2))):
        craft = slice(k, k + 1)
        alone = constraints[craft], limits[craft], batch.problem
        sub = decoupled_program(*alone).sub
        try:
            found = by_integers(sub)
        except UnsolvableError as error:
            impossible[k] = fixed[k] and integer_infeasible(sub)
            if not impossible[k]:
                raise UnsolvableError(f"craft {k} alone: {error}") from error
            continue
        controls[craft], bound[k] = polished(found.controls.reshape(1, -1, 3), *alone), found.bound
    dear = bound * batch.problem.time_step > limits.delta_v * (1 + LIMIT_ROUNDING)
    return replace(optima.at_least(bound, impossible | dear & fixed, INTEGERS), controls=controls)


def _search_pointed(task: SearchProblem, result: SearchResult) -> SearchResult:
    """Search with small burns dropped or, where that ends without a safe plan, raised."""
    found = _search_in_rounds(task, result, without_smaller_half)
    if found.feasible:
        return found
    raised = _search_in_rounds(task, result, with_raised_burns)
    solves = found.convex_solves + raised.convex_solves - result.convex_solves
    return replace(raised if raised.feasible else found, convex_solves=solves)


def _search_in_rounds(
    task: SearchProblem,
    result: SearchResult,
    changed: Callable[[Controls, Limits, Problem], Limits],
) -> SearchResult:
    """Search one scenario by limits that each plan changes, until all burns are large enough."""
    batch, solves = task.batch, result.convex_solves
    assert batch.limits is not None
    bit = batch.problem.thrust.min_delta_v
    for _ in range(ROUNDS):
        if not too_small(result.controls, batch.limits, batch.problem).any():
            break
        limits = changed(result.controls, batch.limits, batch.problem)
        batch = Batch(batch.scenarios, limits, batch.constraints)
        if not batch.optima.feasible.all():
            k = int(batch.optima.feasible.argmin())
            why = f"no burns of craft {k} were found of at least {bit:g} m/s each"
            return replace(result, convex_solves=solves, feasible=False, obstacle=why)
        (result,) = Search(replace(task, batch=batch), [result.controls]).run()
        solves += result.convex_solves
    return _unless_small(replace(result, convex_solves=solves), task.batch)


def without_smaller_half(controls: Controls, limits: Limits, problem: Problem) -> Limits:
    """Limits without the smaller half, at least one, of each craft's burns that are too small."""
    small = too_small(controls, limits, problem)
    size = burn_sizes(controls, limits, problem)
    burns = limits.burns.copy()
    for k in np.flatnonzero(small.any(axis=(1, 2))):
        middle = np.quantile(size[k][small[k]], 0.5, method="higher")
        burns[k] &= ~small[k] | (size[k] > middle)
    return replace(limits, burns=burns)


def with_raised_burns(controls: Controls, limits: Limits, problem: Problem) -> Limits:
    """Limits that raise burns which are or were too small, and exclude negligible ones."""
    assert problem.thrust.min_delta_v is not None
    small, size = too_small(controls, limits, problem), norm(controls)[..., None]
    if limits.least is not None:
        small |= limits.least.any(axis=2, keepdims=True)
    negligible = small & (size < NEGLIGIBLE * problem.thrust.min_delta_v / problem.time_step)
    raised = small & ~negligible
    least = np.where(raised, controls / np.where(raised, size, 1.0), 0.0)
    return replace(limits, burns=limits.burns & ~negligible, least=least)


def _unless_small(found: SearchResult, batch: Batch) -> SearchResult:
    """The result, marked as not feasible where a burn is still too small."""
    assert batch.limits is not None
    if found.obstacle or not too_small(found.controls, batch.limits, batch.problem).any():
        return found
    why = f"not all burns reach {batch.problem.thrust.min_delta_v:g} m/s"
    return replace(found, feasible=False, obstacle=why)
