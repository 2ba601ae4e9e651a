"""How time, memory and quality of the expert's plans grow with the number of craft.

    python -m benchmarks.growth --page docs/yardstick.md

Scenarios of rings, one at a time with its certificate, on one core; times are CPU times. From 30
craft on the rings grow with n, so that neighbours stay as far apart. Each size has a process of its
own, which ends after a given CPU time; memory is that of the whole process, packages included.
Times are also given in units of the time that Clarabel takes for the decoupled optimum of one
craft, the mean of that before and after each plan, so that tables of different machines can be
compared.
"""

import math
import resource
from collections.abc import Mapping
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from time import thread_time
from timeit import repeat
from typing import Annotated

import numpy as np
import pandas as pd
import typer

from benchmarks.tables import PageOption, limited_process, update_page, use_one_core
from pipeline.expert import solve, solvers
from pipeline.expert.conic_decoupled import minimum_fuel_by_cones
from pipeline.orbit.problem import Problem
from pipeline.plan.plan import SOLVED
from pipeline.scenario import Scenario, draw
from pipeline.scenario.spacecraft import limits_of
from pipeline.scenario.state_constraints import state_constraints

MARK = "<!-- made by python -m benchmarks.growth -->"
SEED = 2022
SIZES = {10: 100, 30: 50, 100: 20, 300: 6, 1000: 3, 3000: 1, 10_000: 1}  # scenarios by craft
PATIENCE = 600.0  # CPU time that a size has, drawing included, s


def grown(n: int, count: int) -> Mapping[str, object]:
    """A row of the table: ``count`` scenarios of n craft, planned one by one."""
    # Else long programs run in a thread of their own, whose time thread_time does not count.
    solvers.LONG = math.inf
    scenarios = [draw("rings", SEED, n, index, Problem()) for index in range(count)]
    solve(draw("rings", SEED, 2, 0, Problem()))  # what is imported or tabled once is not counted
    plans, seconds, units = [], [], [unit(scenarios[0])]
    for scenario in scenarios:
        started = thread_time()
        plans.append(solve(scenario))
        seconds.append(thread_time() - started)
        units.append(unit(scenario))
    gaps = [plan.certificate.optimality_gap for plan in plans]
    ratio = np.array(seconds) / np.mean([units[1:], units[:-1]], axis=0)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {
        "craft": n,
        "scenarios": count,
        "time, ms": f"{1e3 * np.median(seconds):.3g}",
        "units": f"{np.median(ratio):.3g}",
        "ms a craft": f"{1e3 * np.median(seconds) / n:.2g}",
        "memory, MiB": f"{peak:.0f}",
        "safe": f"{sum(plan.status == SOLVED for plan in plans)} of {count}",
        "gap": f"{100 * np.mean(gaps):.2g} %",
        "rounds": f"{np.mean([plan.convex_solves for plan in plans]):.3g}",
    }


def unit(scenario: Scenario) -> float:
    """Median CPU time, s, in which Clarabel finds the decoupled optimum of the first craft."""
    problem = scenario.problem
    at = state_constraints(scenario.initial[:1], scenario.goal[:1], problem, {})
    one = partial(minimum_fuel_by_cones, at, limits_of((), 1, problem), problem)
    return float(np.median(repeat(one, timer=thread_time, repeat=20, number=1)))


def row(n: int, count: int, patience: float) -> Mapping[str, object]:
    """The row of ``grown``, by a process of its own, or one that says that its time ran out."""
    with limited_process(patience) as pool:
        try:
            return pool.submit(grown, n, count).result()
        except BrokenProcessPool:
            return {"craft": n, "scenarios": count, "time, ms": f"no plan in {patience:g} s"}


def main(
    page: PageOption = None,
    most: Annotated[int, typer.Option(help="Craft of the largest swarm.")] = max(SIZES),
    patience: Annotated[float, typer.Option(min=1, help="CPU time of a size, s.")] = PATIENCE,
) -> None:
    """Run all and print the table."""
    use_one_core()
    rows = [row(n, count, patience) for n, count in SIZES.items() if n <= most]
    update_page(page, MARK, pd.DataFrame(rows).fillna("").to_markdown(index=False))


if __name__ == "__main__":
    typer.run(main)
