"""The smallest impulse bit: plans with burns below it are searched again without these burns.

Where programs are linear, mixed-integer programs make each thrust zero or large enough. Where they
have cones, plans are made in turn, each without the smaller half of the burns that were too small
in the plan before, about which it is linearized.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pipeline.arrays import Array, Bool
from pipeline.expert.batch import Batch
from pipeline.expert.conic_decoupled import decoupled_program, polished
from pipeline.expert.incumbents import SearchResult
from pipeline.expert.scp import Search, SearchProblem
from pipeline.expert.subproblem import UnsolvableError
from pipeline.orbit.arrays import Controls
from pipeline.orbit.problem import Problem
from pipeline.orbit.thrust import Limits
from pipeline.orbit.thrust_cost import burn_sizes, craft_fuel, too_small

ROUNDS = 16  # plans at most


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
    if not too_small(result.controls, limits, batch.problem).any():
        return result
    has_cones = batch.problem.thrust.directions is None or np.isfinite(limits.norm).any()
    found = (_search_with_fewer_burns if has_cones else _search_by_integers)(task, result)
    if result.feasible:
        fuel = craft_fuel(result.controls, batch.problem.thrust, limits)
        found = replace(found, fuel_without=float(fuel.sum()))
    if not found.obstacle and too_small(found.controls, limits, batch.problem).any():
        why = f"not all burns reach {batch.problem.thrust.min_delta_v:g} m/s"
        found = replace(found, feasible=False, obstacle=why)
    return found


def _search_by_integers(task: SearchProblem, result: SearchResult) -> SearchResult:
    """Search with programs whose thrusts are zero or large enough."""
    from pipeline.expert.mixed_integer import by_integers  # by SciPy, slow to import

    batch, optima = task.batch, task.batch.optima
    assert batch.limits is not None
    assert batch.constraints is not None
    controls = optima.controls.copy()
    small = too_small(controls, batch.limits, batch.problem)
    for k in np.flatnonzero(small.any(axis=(1, 2))):
        craft = slice(k, k + 1)
        at = batch.constraints[craft]
        sub = decoupled_program(at, batch.limits[craft], batch.problem).sub
        try:
            alone = by_integers(sub).controls.reshape(1, -1, 3)
        except UnsolvableError as error:
            why = f"craft {k} alone: {error}"
            return replace(result, feasible=False, obstacle=why)
        controls[craft] = polished(alone, at, batch.limits[craft], batch.problem)
    start = Batch(batch.scenarios, batch.limits, batch.constraints)
    start.optima = replace(optima, controls=controls)
    search = replace(task, batch=start, whole_burns=True)
    (found,) = Search(search, [result.controls]).run()
    return replace(found, convex_solves=result.convex_solves + found.convex_solves)


def _search_with_fewer_burns(task: SearchProblem, result: SearchResult) -> SearchResult:
    """Search one scenario with ever fewer burns, until all are large enough or rounds end."""
    batch, solves = task.batch, result.convex_solves
    assert batch.limits is not None
    for _ in range(ROUNDS):
        dropped = smaller_half(result.controls, batch.limits, batch.problem)
        if not dropped.any():
            break
        limits = replace(batch.limits, burns=batch.limits.burns & ~dropped)
        batch = Batch(batch.scenarios, limits, batch.constraints)
        if not batch.optima.feasible.all():
            k = int(batch.optima.feasible.argmin())
            bit = batch.problem.thrust.min_delta_v
            why = f"no burns of craft {k} were found of at least {bit:g} m/s each"
            return replace(result, convex_solves=solves, feasible=False, obstacle=why)
        (result,) = Search(replace(task, batch=batch), [result.controls]).run()
        solves += result.convex_solves
    return replace(result, convex_solves=solves)


def smaller_half(
    controls: Controls, limits: Limits, problem: Problem
) -> Bool[Array, "n intervals 3"]:
    """The smaller half, and at least one, of the burns of each craft that are too small."""
    small = too_small(controls, limits, problem)
    size = burn_sizes(controls, limits, problem.thrust)
    dropped = np.zeros(controls.shape, dtype=bool)
    for k in np.flatnonzero(small.any(axis=(1, 2))):
        middle = np.quantile(size[k][small[k]], 0.5, method="higher")
        dropped[k] = small[k] & (size[k] <= middle)
    return dropped
